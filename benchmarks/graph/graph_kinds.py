"""Rows of ``poise bench graph_faults``, the graphs they need, and the stage: a graph with its received messages."""

import os
import random
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Literal
from unittest.mock import patch

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist
from pydantic.dataclasses import dataclass as schema
from std_msgs.msg import String

from benchmarks.core.benchmark import settings
from benchmarks.core.fault_rows import AnyRow
from benchmarks.core.machine import Unavailable
from bridge.launch.graph import Graph
from bridge.launch.layout import BRIDGE, CONTROL, PLANNER, SUPERVISOR, process_specs
from bridge.record.observer import Observer
from bridge.ros.environment import free_domain
from bridge.ros.processes import ProcessSpec
from controllers.commands.command_signature import write_key
from models.config import STRICT, Positive
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.cdr import NANOSECONDS
from models.nodes.messages import stamp_ns
from models.nodes.qos import COMMAND, EVENT, LATCHED
from models.robot_model import RobotModel
from models.types import Vector

#: Kinds of graphs; see ``graph_of``
Kind = Literal["plain", "wrapped", "split", "shuffled", "signed", "full_disk", "wall_clock"]


@schema(frozen=True, slots=True, kw_only=True, config=STRICT)
class GraphRow(AnyRow):
    """Fault of the graph; acts are in ``benchmarks/graph/graph_acts.py``."""

    #: 'rides': same mode, drivers always active. 'stands': drivers always active, at rest in mode stand or ``mode``.
    #: 'damps': mode damp or drivers damped, nothing active afterwards, arming refused with the ``reason``
    expect: Literal["rides", "stands", "damps"]
    graph: Kind = "plain"  #: Kind of graph; see ``graph_of``
    restarted: str = ""  #: Module of the only process that must have restarted; empty for none
    launcher_output: str = ""  #: Text that the launcher must have printed
    #: Maximum time without a command until the drivers damp, by the drivers' clock [s]
    silence: Positive | None = None


@schema(frozen=True, slots=True, config=STRICT)
class GraphFaultsConfig:
    """All rows; the units are in ``benchmarks/config/graph_faults.yaml``."""

    settle: Positive
    duration: Positive
    forward: Positive
    still: Positive
    rows: dict[str, GraphRow]


config = partial(settings, GraphFaultsConfig, "graph_faults")


class WallClock:
    """Shiftable wall clock for processes started with ``variables``; ``Unavailable`` without libfaketime."""

    def __init__(self, folder: Path) -> None:
        found = find_spec("libfaketime")
        if found is None or found.origin is None:
            raise Unavailable("libfaketime is not installed: pip install libfaketime")
        self._state = folder / "wall_clock_shift"
        self.shift(0.0)
        self.variables = {
            "LD_PRELOAD": str(Path(found.origin).parent / "vendor/libfaketime/src/libfaketime.so.1"),
            "FAKETIME_TIMESTAMP_FILE": str(self._state),
            "FAKETIME_NO_CACHE": "1",  # the file is read at every call
            "DONT_FAKE_MONOTONIC": "1",
        }

    def shift(self, seconds: float) -> None:
        """Set the offset of the clock [s]."""
        new = self._state.with_suffix(".new")
        new.write_text(f"{seconds:+.9f}\n", encoding="ascii")
        new.replace(self._state)


FAULTY_DRIVER = ProcessSpec("benchmarks.graph.faulty_driver", BRIDGE.nodes)
FAULTY_CONTROL = ProcessSpec("benchmarks.graph.faulty_control", CONTROL.nodes)
FAULTY_PLANNER = ProcessSpec("benchmarks.graph.faulty_planner", PLANNER.nodes)

NOWHERE = Path("/dev/null/poise")  # a folder that cannot be created, not even by root


@dataclass
class TestedGraph:
    """Running graph with the output of its launcher, its key file, and its wall clock (None: the machine's)."""

    graph: Graph
    lines: list[str] = field(default_factory=list)
    key: Path = NOWHERE
    wall_clock: WallClock | None = None


@contextmanager
def graph_of(kind: Kind, robot: str, seed: int, folder: Path) -> Iterator[TestedGraph]:
    """Start a graph and stop it afterwards; ``Unavailable`` or ``PoiseError`` when it does not start.

    'plain': as started by ``poise up``. 'wrapped': driver that corrupts messages and processes that raise, on command.
    'split': every node in a separate process. 'shuffled': processes start and nodes activate in random order.
    'signed': commands must be signed. 'full_disk': neither logs nor black boxes can be written.
    'wall_clock': the wall clock of the processes can be shifted. ``folder`` is for logs, key and library.
    """
    boxes = NOWHERE if kind == "full_disk" else folder
    parameters: dict[str, Mapping[str, object]] = {
        "robot_driver": {"seed": seed, "real_time": "strict"},
        "balance_controller": {"black_box.folder": str(boxes), "force_deactivate": True},
    }
    specs: list[ProcessSpec] = process_specs("separate" if kind == "split" else "shared")
    activation: Sequence[str] | None = None
    variables, log = {"ROS_LOG_DIR": str(folder)}, folder / "log"
    made_key, wall_clock = folder / f"key_{seed}", None
    if kind == "wrapped":
        specs = [FAULTY_DRIVER, FAULTY_CONTROL, FAULTY_PLANNER, SUPERVISOR]
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
        wall_clock = WallClock(folder)
        variables |= wall_clock.variables
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
    with patch.dict(os.environ, variables), graph:  # also for processes that the graph restarts
        yield TestedGraph(graph, lines, made_key, wall_clock)


LOOK = 0.02  # period of the check of the robot [s]
SPEED_TIME = 0.5  # averaging time of the robot's speed [s]
BACK_TIME = 90.0  # maximum wait for the robot to stand or walk again [s]
SENSOR_RATE, CLOCK_RATE = 1000.0, 100.0  # rates of the bridge's topics [Hz]
TIMEOUTS, BOXES = "driver timeouts", "black boxes not written"  # counts in the diagnostics of bridge and controller
VELOCITY_PERIOD = 0.1  # period of the user's velocity commands [s]


class User:
    """Publishes a walking velocity on ``topic`` ten times a second, until ``walk(None)``."""

    def __init__(self, graph: Graph, topic: str = topics.CMD_VEL) -> None:
        self._publisher = graph.node.create_publisher(Twist, topic, COMMAND)
        self._velocity: float | None = None
        graph.node.create_timer(VELOCITY_PERIOD, self._publish)

    def walk(self, forward: float | None) -> None:
        """Set the published velocity [m/s]; None stops publishing."""
        self._velocity = forward

    def _publish(self) -> None:
        if self._velocity is not None:
            message = Twist()
            message.linear.x = self._velocity
            self._publisher.publish(message)


class GraphStage:
    """Graph under test with its received messages and diagnostics."""

    def __init__(self, model: RobotModel, made: TestedGraph) -> None:
        graph = made.graph
        self.made, self.graph, self.user = made, graph, User(graph)
        self.messages: list[tuple[float, str, str]] = []  #: Time, topic and text of each message
        self.diagnostics: dict[str, str] = {}  #: Latest diagnostic message of each node
        self.refusals: list[str] = []  #: Refusals of the nodes
        self.silences: list[float] = []  #: Time without a command before each timeout of the drivers [s]
        self.still_since: float | None = None  #: Time since which the robot is at rest; None while it moves
        self.wall_lead = 0.0  #: Wall clock of the processes minus wall clock of this process [s]
        self._counts: dict[tuple[str, str], int] = {}
        self._corrupt = graph.node.create_publisher(String, "corrupt", EVENT)
        self.observer = Observer(model, graph.node.context)
        self._path: deque[tuple[float, Vector]] = deque(maxlen=round(SPEED_TIME / LOOK))
        graph.node.create_timer(LOOK, self._look)  # also runs while the graph restarts a process
        listen = graph.node.create_subscription
        for topic in (topics.MODE, topics.DRIVER_STATE, topics.GAIT_PHASE, topics.COMMANDER):
            listen(String, topic, partial(self._on_text, topic), LATCHED)
        listen(DiagnosticArray, "/diagnostics", self._on_diagnostics, EVENT)

    @property
    def height(self) -> float:
        """Height of the base [m]."""
        return float(self.observer.base_position[2])

    @property
    def speed(self) -> float:
        """Horizontal speed over the last ``SPEED_TIME`` [m/s]."""
        (t0, first), (t1, last) = self._path[0], self._path[-1]
        return float(np.linalg.norm((last - first)[:2]) / max(t1 - t0, LOOK))

    def corrupt(self, topic: str, corruption: str, duration: float) -> None:
        """Make the faulty driver corrupt the messages of a topic for a time [s]; see ``CORRUPTIONS``."""
        rate = CLOCK_RATE if topic == topics.CLOCK else SENSOR_RATE
        self._corrupt.publish(String(data=f"{topic} {corruption} {round(duration * rate)}"))

    def _look(self) -> None:
        with suppress(PoiseError):  # a message may be corrupted on purpose
            self.observer.poll()
        now = time.monotonic()
        self._path.append((now, self.observer.base_position))
        if self.speed > config().still:
            self.still_since = None
        elif self.still_since is None:
            self.still_since = now

    def begin(self, row: GraphRow) -> None:
        """Make the robot stand or walk for the row."""
        given = config()
        if row.walk:
            self.graph.send("walk")
            self.graph.wait_for(lambda: self.graph.mode == "walk", BACK_TIME, "walking")
            self.user.walk(given.forward)
        self.graph.spin(given.settle + (SPEED_TIME if row.walk else 0.0))

    def bring_back(self) -> None:
        """Reset the robot to its initial stand, without faults."""
        self.user.walk(None)
        self.ask("reset_faults")
        self.ask("reset")
        self.graph.wait_standing(BACK_TIME)

    def ask(self, service: str) -> tuple[bool, str]:
        """Call a service; call it again if the first reply is lost; see ``Graph.call``."""
        try:
            return self.graph.call(service)
        except PoiseError:
            return self.graph.call(service)

    def _on_text(self, topic: str, message: String) -> None:
        self.messages.append((time.monotonic(), topic, message.data))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.wall_lead = stamp_ns(message.header.stamp) / NANOSECONDS - time.time()
        for status in message.status:
            self.diagnostics[status.name] = status.message
            values = {item.key: item.value for item in status.values}
            refused = sum(int(value) for key, value in values.items() if key.startswith("refused "))
            if self._grown(status.name, "refused", refused):
                self.refusals.append(values["last refusal"])
            if self._grown(status.name, BOXES, int(values.get(BOXES, 0))):
                self.refusals.append(f"black box not written: {values['black box']}")
            if self._grown(status.name, TIMEOUTS, int(values.get(TIMEOUTS, 0))):
                self.silences.append(float(values["silence before timeout [s]"]))

    def _grown(self, node: str, what: str, count: int) -> bool:
        """Whether a count of a node has increased; a count that restarts has not."""
        before, self._counts[node, what] = self._counts.get((node, what), 0), count
        return count > before
