"""Starts several robots in one world: one physics process, and for each robot the processes of its graph."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from bridge.driver.world import SHARED
from bridge.launch.graph import STARTING, Graph, actions_possible, count_restart, own_motions
from bridge.launch.layout import BRIDGE, Processes, process_specs
from bridge.launch.parameters import RATED_NODES, Parameters, node_parameters, sensor_rate, write_parameters
from bridge.launch.run import run_until_signal, wait_for
from bridge.plants.world import SPACING, Place
from bridge.ros.environment import graph_environment
from bridge.ros.namespace import absolute_namespace
from bridge.ros.processes import GraphProcess, stop_all
from models.errors import ConfigError, PoiseError

(BRIDGE_NODE,) = BRIDGE.nodes

SLICE = 0.05  #: Time slice for the callbacks of one robot [s]; the robots take turns


@dataclass(frozen=True, slots=True)
class Inhabitant:
    """One of several robots: profile, start pose (beside the others when None), and additional parameters by node."""

    robot: str
    place: Place | None = None
    parameters: Parameters | None = None


class WorldGraph:
    """Graphs of several robots in one world, each in a namespace.

    A context manager. All processes are started and configured before the first node is activated. Otherwise imports
    of one robot would load the processor while another one already stands. Arguments are those of ``Graph``, but in
    ``lockstep`` the world waits for the command of each tick from every robot, ``parameters`` apply to all robots, and
    ``calibration`` has one folder for each robot.

    Attributes:
        graphs: Graph of each robot by namespace, without leading and trailing slashes.
        exit_codes: Exit code of each process, by robot and module, after leaving.

    Raises:
        PoiseError: No robots, an invalid namespace, or parameters for unknown nodes.
    """

    def __init__(
        self,
        robots: Mapping[str, Inhabitant],
        *,
        lockstep: bool = False,
        processes: Processes = "shared",
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
        self._world = GraphProcess(BRIDGE, arguments, environment)
        self.graphs: dict[str, Graph] = {}
        bridges: dict[str, Mapping[str, object]] = {}
        specs = [spec for spec in process_specs(processes, actions=actions) if spec is not BRIDGE]
        for number, (name, each) in enumerate(zip(names, robots.values(), strict=True)):
            own = _merged(parameters or {}, each.parameters or {})
            if (rate := sensor_rate(own)) is not None:
                own |= {name: {"sensor_rate": rate, **own.get(name, {})} for name in RATED_NODES}
            place = each.place or Place(y=SPACING * number)
            own[BRIDGE_NODE] = {
                "seed": number,
                **own.get(BRIDGE_NODE, {}),
                "place": [place.x, place.y, place.heading],
            }
            kept = (calibration or folder) / name
            kept.mkdir(parents=True, exist_ok=True)
            given = node_parameters([BRIDGE], each.robot, lockstep, kept, {BRIDGE_NODE: own[BRIDGE_NODE]})
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
            for graph in self.graphs.values():
                graph.claim()
            if self._log is not None:
                self._log.parent.mkdir(parents=True, exist_ok=True)
                self._output = self._log.open("ab")
                self._world.output = self._output
            self._say(STARTING)
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

    def stop(self) -> None:
        """End every process."""
        for name, graph in self.graphs.items():
            graph.stop()
            self.exit_codes.update({f"{name}: {module}": code for module, code in graph.exit_codes.items()})
        self.exit_codes.update(stop_all([self._world]))

    def close(self) -> None:
        """End every process and leave ROS."""
        self.stop()
        self._stack.close()
        if self._output is not None:
            self._output.close()
        self._folder.cleanup()

    @property
    def pids(self) -> dict[str, int]:
        """Process id by robot and module."""
        found = {f"{name}: {module}": pid for name, graph in self.graphs.items() for module, pid in graph.pids.items()}
        return {BRIDGE.module: self._world.pid, **found}

    def spin(self, duration: float) -> None:
        """Serve callbacks and supervise the processes for a time [s]; errors as for ``Graph.spin``."""
        end = time.monotonic() + duration
        while (left := end - time.monotonic()) > 0.0:
            for graph in self.graphs.values():
                graph.spin(min(SLICE, left) / len(self.graphs))
            if self._world.exit_code is not None:
                self._restart()

    def wait_for(self, condition: Callable[[], bool], timeout: float, what: str) -> None:
        """Serve callbacks until a condition is met; ``PoiseError`` with ``what`` after ``timeout`` [s]."""

        def state() -> str:
            return "; ".join(f"{name}: '{each.mode}', '{each.driver_state}'" for name, each in self.graphs.items())

        wait_for(self.spin, condition, timeout, what, state)

    def wait_standing(self, timeout: float = 60.0) -> None:
        """Wait until every robot stands without support; timeout in [s]."""
        self.wait_for(lambda: all(graph.standing for graph in self.graphs.values()), timeout, "standing")

    def _restart(self) -> None:
        count_restart(self._world, self._say)
        self._world.start()
        for graph in self.graphs.values():
            graph.bring_up(BRIDGE.nodes)


def up_world(
    robots: Mapping[str, Inhabitant],
    *,
    duration: float | None = None,
    actions: bool = False,
    **options: Any,
) -> int:
    """Run the graphs of several robots until SIGINT or SIGTERM, or for a time; options are those of ``WorldGraph``."""

    def make(say: Callable[[str], object]) -> WorldGraph:
        return WorldGraph(robots, actions=actions_possible(actions, say), say=say, **options)

    return run_until_signal(make, ", ".join(robots), duration=duration)


def _merged(common: Parameters, own: Parameters) -> dict[str, dict[str, object]]:
    """Parameters by node; ``own`` overrides ``common``. ``PoiseError`` when ``own`` has a parameter of the world."""
    alone = [name for name in own.get(BRIDGE_NODE, {}) if name in SHARED]
    if alone:
        raise PoiseError(f"{', '.join(alone)}: must be equal for all robots of a world; set it for all")
    return {node: {**common.get(node, {}), **own.get(node, {})} for node in {**common, **own}}


def _speaker(say: Callable[[str], object], name: str) -> Callable[[str], object]:
    return lambda text: say(f"{name}: {text}")


def inhabitants(robots: str, places: Sequence[str], motions: Path | None) -> dict[str, Inhabitant]:
    """Parse ``robot_1=g1,robot_2=talos`` and ``robot_2=1,-1.5,0`` into the robots by namespace, in the given order.

    A place is namespace, x and y [m], heading [rad]; ``motions`` is a folder of motion files for all robots. Raises
    ``PoiseError`` that quotes the invalid text.
    """
    found: dict[str, str] = {}
    for text in filter(None, robots.split(",")):
        name, equals, robot = text.partition("=")
        name = absolute_namespace(name).strip("/")
        if not name or not equals or not robot.strip():
            raise ConfigError(f"--robots: '{text}' is not NAMESPACE=ROBOT, such as robot_1=g1")
        if name in found:
            raise ConfigError(f"--robots: '{name}' is given twice")
        found[name] = robot.strip()
    begins = dict(map(_place, places))
    for name in begins:
        if name not in found:
            raise ConfigError(f"--place: no robot '{name}' among --robots: {', '.join(found) or 'none'}")
    return {
        name: Inhabitant(robot, begins.get(name), {} if motions is None else own_motions(robot, motions))
        for name, robot in found.items()
    }


def _place(text: str) -> tuple[str, Place]:
    name, _, place = text.partition("=")
    try:
        x, y, heading = (float(value) for value in place.split(","))
    except ValueError:
        raise ConfigError(f"--place: '{text}' is not NAMESPACE=X,Y,HEADING, such as robot_2=0,1.5,0") from None
    return name.strip("/"), Place(x, y, heading)
