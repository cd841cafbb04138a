"""The graphs that rows of ``poise bench graph_faults`` are done to."""

from __future__ import annotations

import os
import random
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.graph_rows import Kind
from benchmarks.wall_clock import WallClock
from bridge.launch import Graph
from bridge.ros.environment import free_domain
from bridge.ros.layout import BRIDGE, CONTROL, PLANNER, SUPERVISOR, process_specs
from bridge.ros.processes import Parameters, ProcessSpec
from controllers.command_key import write_key
from models.errors import PoiseError

SPOILT_BRIDGE = ProcessSpec("benchmarks.nodes.spoilt_bridge", BRIDGE.nodes)
PRODDED_CONTROL = ProcessSpec("benchmarks.nodes.prodded_control", CONTROL.nodes)
PRODDED_PLANNER = ProcessSpec("benchmarks.nodes.prodded_planner", PLANNER.nodes)

NOWHERE = Path("/dev/null/poise")
"""A folder that nobody can make, root included."""


class NotHere(PoiseError):
    """This machine lacks what a graph needs."""


@dataclass
class Made:
    """A running graph, and what its rows need beside it.

    Attributes:
        graph: The graph.
        lines: What the launcher has said.
        key: File of the key of signed commands.
        wall_clock: Of the graph's processes; None for the machine's.
    """

    graph: Graph
    lines: list[str] = field(default_factory=list)
    key: Path = NOWHERE
    wall_clock: WallClock | None = None


@contextmanager
def graph_of(kind: Kind, robot: str, seed: int, folder: Path) -> Iterator[Made]:
    """Bring a graph up, and end it afterwards.

    Args:
        kind: 'plain': as ``poise up`` starts it. 'wrapped': its bridge spoils messages and its processes raise on
            command. 'split': estimator and controller in processes of their own, without a gait planner. 'shuffled':
            processes started and nodes activated in a random order. 'signed': commands must be signed. 'full_disk':
            no log can be written and no black box. 'wall_clock': the processes' wall clock can be shifted.
        robot: Profile, by name or path.
        seed: Of the sensor noise and the order.
        folder: For logs, key and library.

    Raises:
        NotHere: This machine lacks something.
        PoiseError: The graph does not come up.
    """
    boxes = NOWHERE if kind == "full_disk" else folder
    parameters: dict[str, Mapping[str, object]] = {
        "mujoco_bridge": {"seed": seed},
        "balance_controller": {"black_box.folder": str(boxes)},
    }
    specs: list[ProcessSpec] = process_specs(merged=kind != "split")
    activation: Sequence[str] | None = None
    variables, log = {"ROS_LOG_DIR": str(folder)}, folder / "log"
    made_key, wall_clock = folder / f"key_{seed}", None
    if kind == "wrapped":
        specs = [SPOILT_BRIDGE, PRODDED_CONTROL, PRODDED_PLANNER, SUPERVISOR]
    elif kind == "shuffled":
        shuffle = random.Random(seed).shuffle
        activation = [name for spec in specs for name in spec.nodes]
        shuffle(specs)
        shuffle(activation)
    elif kind == "signed":
        if not made_key.exists():
            write_key(made_key)
        parameters["supervisor"] = {"command_key": str(made_key)}
    elif kind == "full_disk":
        variables, log = {"ROS_LOG_DIR": str(NOWHERE)}, Path("/dev/full")
    elif kind == "wall_clock":
        wall_clock = _wall_clock(folder)
        variables |= wall_clock.variables
    with _environment(variables), _made(robot, parameters, specs, activation, log) as made:
        made.key, made.wall_clock = made_key, wall_clock
        yield made


@contextmanager
def _made(
    robot: str,
    parameters: Parameters,
    specs: Sequence[ProcessSpec],
    activation: Sequence[str] | None,
    log: Path,
) -> Iterator[Made]:
    lines: list[str] = []
    graph = Graph(
        robot,
        domain_id=free_domain(),
        parameters=parameters,
        specs=specs,
        activation=activation,
        log=log,
        say=lines.append,
    )
    with graph:
        yield Made(graph, lines)


def _wall_clock(folder: Path) -> WallClock:
    try:
        return WallClock(folder)
    except PoiseError as error:
        raise NotHere(str(error)) from error


@contextmanager
def _environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Variables that the processes of a graph, those it restarts included, are started with."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
