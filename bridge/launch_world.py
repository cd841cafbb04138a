"""Starts several robots in one world: one process with the physics, and for each robot the processes of its graph."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO

from bridge.graph_run import run_until_signal, wait_for
from bridge.launch import RESTARTS_MAX, Graph, actions_possible
from bridge.mujoco_world import SPACING, Place
from bridge.ros.bridged_world import SHARED
from bridge.ros.environment import graph_environment
from bridge.ros.layout import BRIDGE, node_parameters, process_specs
from bridge.ros.processes import (
    GraphProcess,
    Parameters,
    ProcessSpec,
    absolute_namespace,
    stop_all,
    write_parameters,
)
from models.errors import PoiseError

WORLD = ProcessSpec("bridge.nodes.mujoco_world", BRIDGE.nodes)
(BRIDGE_NODE,) = BRIDGE.nodes

SUPERVISOR_PRIORITY = 30
"""SCHED_FIFO priority of the supervisors in real time, below that of the ticks: those of several robots leave so little
of two processors that a supervisor would not hear the clock for half a second while other programs are busy."""

SLICE = 0.05
"""Time that each robot's graph is served before the next one's turn [s]."""


@dataclass(frozen=True, slots=True)
class Inhabitant:
    """One of several robots.

    Attributes:
        robot: Profile, by name or path.
        place: Where it begins; beside the others when None.
        parameters: By node, besides those of everybody.
    """

    robot: str
    place: Place | None = None
    parameters: Parameters | None = None


class WorldGraph:
    """Graphs of several robots in one world, each in a namespace of its own.

    A context manager, as ``Graph``. All processes are started and configured before the first node is activated, so
    that no robot stands while others still take the processor for their imports.

    Args:
        robots: The robots by namespace.
        lockstep: Whether the world waits for the command of each tick from every robot.
        merged: Whether estimator and controller of a robot share a process.
        actions: Whether to offer actions.
        domain_id: ROS domain; that of the environment when None.
        network: Whether other machines may join.
        parameters: Further parameters of everybody, by node.
        calibration: Folder with a folder for each robot's calibration files; one that is gone afterwards when None.
        log: File for the processes' output; this process's output when None.
        say: Takes one line about each event.

    Attributes:
        graphs: Graph of each robot, by its namespace without slashes around it.
        exit_codes: Exit code of each process, by robot and module, after leaving.

    Raises:
        PoiseError: There is no robot, a name is no namespace, or parameters are for unknown nodes.
    """

    def __init__(
        self,
        robots: Mapping[str, Inhabitant],
        *,
        lockstep: bool = False,
        merged: bool = True,
        actions: bool = False,
        domain_id: int | None = None,
        network: bool = False,
        parameters: Parameters | None = None,
        calibration: Path | None = None,
        log: Path | None = None,
        say: Callable[[str], object] = print,
    ) -> None:
        if not robots:
            raise PoiseError("no robot: give at least one, such as robot_1=g1")
        self.exit_codes: dict[str, int | None] = {}
        self._say, self._log = say, log
        self._output: IO[bytes] | None = None
        self._folder = tempfile.TemporaryDirectory(prefix="poise_world_")
        self._stack = ExitStack()
        folder = Path(self._folder.name)
        file, names = folder / "world.yaml", [absolute_namespace(name).strip("/") for name in robots]
        arguments = [*names, "--ros-args", "--params-file", str(file)]
        environment = graph_environment(domain_id=domain_id, network=network)
        self._world = GraphProcess(WORLD, {}, environment, arguments=arguments)
        self.graphs: dict[str, Graph] = {}
        bridges: dict[str, Mapping[str, object]] = {}
        specs = [spec for spec in process_specs(merged=merged, actions=actions) if spec is not BRIDGE]
        for number, (name, each) in enumerate(zip(names, robots.values(), strict=True)):
            own = _merged(parameters or {}, each.parameters or {})
            if not lockstep:
                own["supervisor"] = {"realtime.priority": SUPERVISOR_PRIORITY, **own.get("supervisor", {})}
            place = each.place or Place(y=SPACING * number)
            plant = {"seed": number, **own.pop(BRIDGE_NODE, {}), "place": [place.x, place.y, place.heading]}
            kept = (calibration or folder) / name
            kept.mkdir(parents=True, exist_ok=True)
            given = node_parameters([BRIDGE], each.robot, lockstep, kept, {BRIDGE_NODE: plant})
            bridges[f"/{name}/{BRIDGE_NODE}"] = given[BRIDGE_NODE]
            self.graphs[name] = Graph(
                each.robot,
                lockstep=lockstep,
                domain_id=domain_id,
                network=network,
                parameters=own,
                specs=specs,
                calibration=kept,
                log=log,
                namespace=name,
                say=_speaker(say, name),
                plant=self._world,
            )
        write_parameters(file, bridges)

    def __enter__(self) -> WorldGraph:
        try:
            if self._log is not None:
                self._log.parent.mkdir(parents=True, exist_ok=True)
                self._output = self._log.open("ab")
                self._world.output = self._output
            self._world.start()
            for graph in self.graphs.values():
                graph.open()
                self._stack.callback(graph.close)
            for step in (Graph.configure, Graph.activate):
                for graph in self.graphs.values():
                    step(graph)
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """End every process and leave ROS."""
        self._stack.close()
        self.exit_codes.update(stop_all([self._world]))
        for name, graph in self.graphs.items():
            self.exit_codes.update({f"{name}: {module}": code for module, code in graph.exit_codes.items()})
        if self._output is not None:
            self._output.close()
        self._folder.cleanup()

    @property
    def pids(self) -> dict[str, int]:
        """Process id by robot and module."""
        found = {f"{name}: {module}": pid for name, graph in self.graphs.items() for module, pid in graph.pids.items()}
        return {WORLD.module: self._world.pid, **found}

    def spin(self, duration: float) -> None:
        """Serve callbacks and watch over the processes for a time [s].

        Raises:
            PoiseError: A process has crashed too often or cannot be brought up again.
        """
        end = time.monotonic() + duration
        while (left := end - time.monotonic()) > 0.0:
            for graph in self.graphs.values():
                graph.spin(min(SLICE, left) / len(self.graphs))
            if self._world.exit_code is not None:
                self._restart()

    def wait_for(self, condition: Callable[[], bool], timeout: float, what: str) -> None:
        """Serve callbacks until a condition holds.

        Raises:
            PoiseError: It does not hold in time; ``what`` names it.
        """

        def state() -> str:
            return "; ".join(f"{name}: '{each.mode}', '{each.driver_state}'" for name, each in self.graphs.items())

        wait_for(self.spin, condition, timeout, what, state)

    def wait_standing(self, timeout: float = 60.0) -> None:
        """Wait until every robot stands on its own feet."""
        self.wait_for(lambda: all(graph.standing for graph in self.graphs.values()), timeout, "standing")

    def _restart(self) -> None:
        """Start the crashed world again and bring every robot's bridge up; their other nodes go on."""
        world = self._world
        code, world.restarts = world.exit_code, world.restarts + 1
        self._say(f"{WORLD.module} ended with code {code}: restart {world.restarts} of {RESTARTS_MAX}")
        if world.restarts > RESTARTS_MAX:
            raise PoiseError(f"{WORLD.module} crashed {world.restarts} times")
        world.start()
        for graph in self.graphs.values():
            graph.bring_up_plant()


def up_world(
    robots: Mapping[str, Inhabitant],
    *,
    lockstep: bool = False,
    duration: float | None = None,
    network: bool = False,
    merged: bool = True,
    actions: bool = False,
    parameters: Parameters | None = None,
    calibration: Path | None = None,
    log: Path | None = None,
    quiet: bool = False,
) -> int:
    """Run the graphs of several robots until SIGINT or SIGTERM, or for a time; arguments and result as ``up``."""

    def make(say: Callable[[str], object]) -> WorldGraph:
        return WorldGraph(
            robots,
            lockstep=lockstep,
            merged=merged,
            actions=actions_possible(actions, say),
            network=network,
            parameters=parameters,
            calibration=calibration,
            log=log,
            say=say,
        )

    return run_until_signal(make, ", ".join(robots), duration=duration, quiet=quiet)


def _merged(everybody: Parameters, own: Parameters) -> dict[str, dict[str, object]]:
    """Parameters by node; a robot's own go before everybody's, but for those that a world has once.

    Raises:
        PoiseError: A robot has one of those for itself.
    """
    alone = [name for name in own.get(BRIDGE_NODE, {}) if name in SHARED]
    if alone:
        raise PoiseError(f"{', '.join(alone)}: of the world, not of one robot")
    return {node: {**everybody.get(node, {}), **own.get(node, {})} for node in {**everybody, **own}}


def _speaker(say: Callable[[str], object], name: str) -> Callable[[str], object]:
    return lambda text: say(f"{name}: {text}")
