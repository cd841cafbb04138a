"""Rows of ``poise bench graph_faults``, and the graphs they run on, one with a wrong clock (``wall_clock_shift.c``)."""

from __future__ import annotations

import mmap
import os
import random
import shutil
import struct
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Literal

from pydantic.dataclasses import dataclass as schema

from benchmarks.core.benchmark import Positive, settings
from benchmarks.core.fault_rows import AnyRow
from bridge.launch.graph import Graph
from bridge.ros.environment import free_domain
from bridge.ros.processes import BRIDGE, CONTROL, PLANNER, SUPERVISOR, Parameters, ProcessSpec, process_specs
from controllers.commands.command_key import write_key
from models.config import STRICT
from models.errors import PoiseError

#: Graphs that rows are done to; see ``benchmarks/graph/graph_kinds.py``
Kind = Literal["plain", "wrapped", "split", "shuffled", "signed", "full_disk", "wall_clock"]


@schema(frozen=True, slots=True, kw_only=True, config=STRICT)
class GraphRow(AnyRow):
    """One fault of the graph; acts are of ``benchmarks/graph/graph_acts.py``.

    Attributes:
        expect: 'rides': same mode, drivers active all the time; 'stands': so, but at rest in mode stand, or ``mode``;
            'damps': mode damp or drivers damped, nothing active afterwards, and arming refused with the ``reason``.
        graph: Kind of graph; see ``benchmarks/graph/graph_kinds.py``.
        restarted: Module of the only process that must have been restarted; empty for none.
        said: Text that the launcher must have printed.
        silence: Longest time without a command before the drivers damped for lack of one, by their clock [s].
    """

    expect: Literal["rides", "stands", "damps"]
    graph: Kind = "plain"
    restarted: str = ""
    said: str = ""
    silence: Positive | None = None


@schema(frozen=True, slots=True, config=STRICT)
class GraphFaultsConfig:
    """All rows; the unit of every value stands in ``benchmarks/config/graph_faults.yaml``."""

    settle: Positive
    duration: Positive
    forward: Positive
    still: Positive
    rows: dict[str, GraphRow]


config = partial(settings, GraphFaultsConfig, "graph_faults")


COMPILER = "cc"


class WallClock:
    """Shift of the wall clock of processes started with ``variables``; ``PoiseError`` without a working C compiler."""

    def __init__(self, folder: Path) -> None:
        if shutil.which(COMPILER) is None:
            raise PoiseError(f"no C compiler: {COMPILER} is not there")
        library, state = folder / "wall_clock_shift.so", folder / "wall_clock_shift"
        source = Path(str(files("benchmarks.graph"))) / "wall_clock_shift.c"
        command = [COMPILER, "-O2", "-shared", "-fPIC", "-o", str(library), str(source), "-ldl", "-lpthread"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise PoiseError(f"{COMPILER} fails: {done.stderr.strip()[:200]}")
        state.write_bytes(struct.pack("q", 0))
        with state.open("r+b") as file:
            self._page = mmap.mmap(file.fileno(), 8)
        self.variables = {"LD_PRELOAD": str(library), "WALL_CLOCK_SHIFT": str(state)}

    def shift(self, seconds: float) -> None:
        """Have the clock be wrong by so much from now on [s]."""
        self._page[:] = struct.pack("q", round(seconds * 1e9))


SPOILT_BRIDGE = ProcessSpec("benchmarks.graph.spoilt_bridge", BRIDGE.nodes)
PRODDED_CONTROL = ProcessSpec("benchmarks.graph.prodded_control", CONTROL.nodes)
PRODDED_PLANNER = ProcessSpec("benchmarks.graph.prodded_planner", PLANNER.nodes)

NOWHERE = Path("/dev/null/poise")  # A folder that cannot be created, not even by root


class NotHere(PoiseError):
    """This machine lacks what a graph needs."""


@dataclass
class Made:
    """A running graph, with its launcher's output, its key file, and its wall clock (None for the machine's)."""

    graph: Graph
    lines: list[str] = field(default_factory=list)
    key: Path = NOWHERE
    wall_clock: WallClock | None = None


@contextmanager
def graph_of(kind: Kind, robot: str, seed: int, folder: Path) -> Iterator[Made]:
    """Bring a graph up, and end it afterwards.

    Args:
        kind: 'plain': as ``poise up`` starts it. 'wrapped': its bridge spoils messages and its processes raise on
            command. 'split': estimator and controller in separate processes, without a gait planner. 'shuffled':
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
        "robot_driver": {"seed": seed},
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
