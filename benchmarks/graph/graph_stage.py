"""The stage of ``poise bench graph_faults``: a running graph, who has the robot walk, and what is seen of it."""

from __future__ import annotations

import time
from collections import deque
from contextlib import suppress
from functools import partial

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist
from std_msgs.msg import String

from benchmarks.graph.graph_kinds import GraphRow, Made, config
from bridge.launch.graph import Graph
from bridge.record.observer import Observer
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.cdr import NANOSECONDS
from models.nodes.messages import stamp_ns
from models.nodes.qos import COMMAND, EVENT, LATCHED
from models.robot_model import RobotModel
from models.types import Vector

LOOK = 0.02  # period of the check of the robot [s]
SPEED_TIME = 0.5  # over which its speed is taken [s]
BACK_TIME = 90.0  # longest wait for the robot to stand or walk again [s]
SENSOR_RATE, CLOCK_RATE = 1000.0, 100.0  # of the bridge's topics [Hz]
TIMEOUTS, BOXES = "driver timeouts", "black boxes not written"  # counts in the diagnostics of bridge and controller
VELOCITY_PERIOD = 0.1  # between two velocities of the user [s]


class User:
    """Publishes a walking velocity on ``topic`` ten times a second, until ``walk(None)``."""

    def __init__(self, graph: Graph, topic: str = topics.CMD_VEL) -> None:
        self._publisher = graph.node.create_publisher(Twist, topic, COMMAND)
        self._velocity: float | None = None
        graph.node.create_timer(VELOCITY_PERIOD, self._speak)

    def walk(self, forward: float | None) -> None:
        """Walk at a velocity from now on [m/s]; None: fall silent."""
        self._velocity = forward

    def _speak(self) -> None:
        if self._velocity is not None:
            message = Twist()
            message.linear.x = self._velocity
            self._publisher.publish(message)


class GraphStage:
    """A running graph under test, and what is received from it.

    Attributes:
        words: Time, topic and text of each message.
        diagnostics: Newest message of each node's diagnostics.
        refusals: Refusals of the nodes.
        silences: Waits of the drivers for a command before they damped for lack of one [s].
        still_since: Since when the robot is at rest; None while it is not.
        wall_lead: Wall clock of the processes ahead of this one's [s].
    """

    def __init__(self, model: RobotModel, made: Made) -> None:
        graph = made.graph
        self.made, self.graph, self.user = made, graph, User(graph)
        self.words: list[tuple[float, str, str]] = []
        self.diagnostics: dict[str, str] = {}
        self.refusals: list[str] = []
        self.silences: list[float] = []
        self.still_since: float | None = None
        self.wall_lead = 0.0
        self._counts: dict[tuple[str, str], int] = {}
        self._spoil = graph.node.create_publisher(String, "spoil", EVENT)
        self._observer = Observer(model)
        self._path: deque[tuple[float, Vector]] = deque(maxlen=round(SPEED_TIME / LOOK))
        graph.node.create_timer(LOOK, self._look)  # the graph serves it while it restarts a process, too
        listen = graph.node.create_subscription
        for topic in (topics.MODE, topics.DRIVER_STATE, topics.GAIT_PHASE, topics.COMMANDER):
            listen(String, topic, partial(self._hear, topic), LATCHED)
        listen(DiagnosticArray, "/diagnostics", self._on_diagnostics, EVENT)

    @property
    def height(self) -> float:
        """Of the base [m]."""
        return float(self._observer.base_position[2])

    @property
    def speed(self) -> float:
        """Over the last ``SPEED_TIME`` [m/s]."""
        (t0, first), (t1, last) = self._path[0], self._path[-1]
        return float(np.linalg.norm((last - first)[:2]) / max(t1 - t0, LOOK))

    def spoil(self, topic: str, spoil: str, duration: float) -> None:
        """Have the wrapped bridge spoil the messages of a topic for a time [s]; see ``SPOILS``."""
        rate = CLOCK_RATE if topic == topics.CLOCK else SENSOR_RATE
        self._spoil.publish(String(data=f"{topic} {spoil} {round(duration * rate)}"))

    def _look(self) -> None:
        with suppress(PoiseError):  # a message that is spoilt on purpose
            self._observer.poll()
        now = time.monotonic()
        self._path.append((now, self._observer.base_position))
        if self.speed > config().still:
            self.still_since = None
        elif self.still_since is None:
            self.still_since = now

    def begin(self, row: GraphRow) -> None:
        """Bring the robot to stand or walk for the row."""
        given = config()
        if row.walk:
            self.graph.send("walk")
            self.graph.wait_for(lambda: self.graph.mode == "walk", BACK_TIME, "walking")
            self.user.walk(given.forward)
        self.graph.spin(given.settle + (SPEED_TIME if row.walk else 0.0))

    def bring_back(self) -> None:
        """Have it stand where it began, without faults."""
        self.user.walk(None)
        self.ask("reset_faults")
        self.ask("reset")
        self.graph.wait_standing(BACK_TIME)

    def ask(self, service: str) -> tuple[bool, str]:
        """Call a service, twice where the reply to the first call is lost; see ``Graph.call``."""
        try:
            return self.graph.call(service)
        except PoiseError:
            return self.graph.call(service)

    def close(self) -> None:
        """Look no more."""
        self._observer.close()

    def _hear(self, topic: str, message: String) -> None:
        self.words.append((time.monotonic(), topic, message.data))

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
        """Whether a count of a node is larger than it was; one that begins anew has none."""
        before, self._counts[node, what] = self._counts.get((node, what), 0), count
        return count > before
