"""What the other nodes report, as the ``Health`` that the supervisor judges."""

from __future__ import annotations

import time

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from controllers.clock_guard import ClockGuard
from controllers.health import Health, tilt
from controllers.supervisor_config import SupervisorConfig
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS, stamp_of
from models.nodes.messages import stamp_ns
from models.nodes.odometry import OdometryCodec
from models.nodes.qos import EVENT, LATCHED, SENSOR
from models.nodes.qos_watch import PUBLISHER
from models.types import SolveStatus, Vector

STATUSES = {status.value: status for status in SolveStatus}

IDLE = ("idle", "active", "inactive", "configured", "unconfigured", "finalized")
"""First word of the controller's report while it solves nothing."""


WATCHED = ("motion_planner",)
"""Nodes whose silence no stamp tells of; their diagnostics are their sign of life."""

COUNT_PERIOD = 0.2
"""Time between two counts of the sensors' publishers [s]."""

SWAY_TIME = 1.0
"""Over which the velocity of the base is averaged: a step to either side [s]."""

REASON_MAX = 200
"""Longest reason that is taken from a report [characters]."""

DIGITS_MAX = 20
"""Longest count or stamp that is read from a report [characters]; 64 bits have 20."""


class HealthTopics:
    """Newest report of each kind; ages are counted on the stamps, only the silence of ``/clock`` on this machine's.

    Args:
        node: Node that subscribes.
        clock_leap: Largest step of ``/clock`` that is believed at once [s].

    Attributes:
        moving: Whether the robot moves; ``/clock`` may not go back then. Kept up to date by the node.
        description: URDF that the robot publishes; None before it has arrived.
        clock_seen: When ``/clock`` was last heard, on the monotonic clock [s].
    """

    def __init__(self, node: PoiseNode, clock_leap: float) -> None:
        self._node, self._odom_codec = node, OdometryCodec()
        self._clock, self.moving = ClockGuard(round(clock_leap * NANOSECONDS)), False
        self.description: str | None = None
        self.clock_seen = time.monotonic()
        self._now = self._odom_stamp = self._command_stamp = self._started = 0
        self._tilt, self._status, self._motion_active = 0.0, SolveStatus.OPTIMAL, False
        self._overruns, self._joint_fault = 0, ""
        self._coasting_since: int | None = None
        self._gait = topics.GAIT_ABSENT
        self._alive: dict[str, float] = {}
        self._looked = [0, 0]
        self._twist: Vector = np.zeros(6)
        self._count_at = 0.0
        self._intruders: tuple[str, ...] = ()
        self._incompatible: dict[str, dict[str, str]] = {}
        self._needed_heard = frozenset(topics.needed_topics(node.model))
        self._needed_said = frozenset([topics.JOINT_COMMAND])  # on others a listener may be deaf: he is no driver
        self._sensors = [node.resolve_topic_name(topic) for topic in (*topics.sensor_topics(node.model), topics.CLOCK)]
        node.listen(String, topics.ROBOT_DESCRIPTION, self._on_description, LATCHED)
        node.listen(Clock, topics.CLOCK, self._on_clock, SENSOR)
        node.listen(Odometry, topics.ODOM, self._on_odom, SENSOR, raw=True)
        node.listen(JointState, topics.POSTURE, self._on_posture, SENSOR, raw=True)
        node.listen(String, topics.MOTION_STATE, self._on_motion_state, EVENT)
        node.listen(String, topics.GAIT_PHASE, self._on_gait_phase, LATCHED)
        node.listen(DiagnosticArray, "/diagnostics", self._on_diagnostics, EVENT)

    @property
    def now(self) -> int:
        """Time of the plant [ns]."""
        return self._now

    @property
    def t(self) -> float:
        """Time of the plant [s]."""
        return self._now / NANOSECONDS

    @property
    def tilt(self) -> float:
        """Newest tilt of the base [rad]."""
        return self._tilt

    @property
    def walking_velocity(self) -> tuple[float, float, float]:
        """How the base moves, without its sway: forward [m/s], left [m/s], turn [rad/s]."""
        return float(self._twist[0]), float(self._twist[1]), float(self._twist[5])

    @property
    def gait_present(self) -> bool:
        """Whether there is somebody who can walk."""
        return self._gait != topics.GAIT_ABSENT

    @property
    def heard(self) -> bool:
        """Whether the clock, a state and a command have arrived: before that, their ages mean nothing."""
        return bool(self._now and self._odom_stamp and self._command_stamp)

    def walk(self) -> None:
        """A walk begins: until the gait planner has said so itself, it has not come to a standstill."""
        self._gait = ""

    def start(self) -> None:
        """Count the age of state, command and clock from now: the robot begins to move."""
        self._odom_stamp = self._command_stamp = self._started = self._now
        self._status, self._overruns, self._joint_fault = SolveStatus.OPTIMAL, 0, ""
        self.clock_seen = time.monotonic()

    @property
    def intruders(self) -> tuple[str, ...]:
        """Sensor topics, and the clock, with more than one publisher: whose samples arrive, nobody could say."""
        now = time.monotonic()
        if now >= self._count_at:
            self._count_at = now + COUNT_PERIOD
            self._intruders = tuple(topic for topic in self._sensors if self._node.count_publishers(topic) > 1)
        return self._intruders

    @property
    def incompatible(self) -> dict[str, str]:
        """Needed topics whose ends do not agree on their QoS: who and on what. A node's last word counts."""
        return {topic: who for found in self._incompatible.values() for topic, who in found.items()}

    def health(self, driver_state: str, config: SupervisorConfig) -> Health:
        """Everything that is known.

        Args:
            driver_state: What the joint drivers say that they do; what they did before for ``controller_timeout``.
            config: That time, and how long a node may be silent.
        """
        arming_time, then = config.controller_timeout, time.monotonic() - config.heartbeat_timeout
        armed = self._now - self._started > arming_time * NANOSECONDS
        late = round(config.heartbeat_timeout * NANOSECONDS)
        return Health(
            state_stamp=self._moving(0, self._odom_stamp, late) / NANOSECONDS,
            command_stamp=self._moving(1, self._command_stamp, late) / NANOSECONDS,
            tilt=self._tilt,
            status=self._status,
            drivers_damped=armed and driver_state == topics.DAMPED,
            motion_active=self._motion_active,
            overruns=self._overruns,
            gait_active=self._gait not in (topics.GAIT_SETTLED, topics.GAIT_ABSENT),
            coasting=0.0 if self._coasting_since is None else (self._now - self._coasting_since) / NANOSECONDS,
            silent=tuple(name for name, seen in self._alive.items() if seen < then),
            intruders=self.intruders,
            joint_fault=self._joint_fault if driver_state == topics.ACTIVE else "",
        )

    def _moving(self, which: int, stamp: int, late: int) -> int:
        """A stamp to count the age from: that of now while the stamps still move from one look to the next.

        Then somebody is alive. How late they arrive here tells of this process and its queue; commands that are too old
        for the joints are refused by the drivers. What is later than ``late`` [ns] tells of a clock that is not theirs.
        """
        moved, self._looked[which] = stamp != self._looked[which], stamp
        return self._now if moved and self._now - stamp <= late else stamp

    def _on_description(self, message: String) -> None:
        self.description = message.data

    def _on_clock(self, message: Clock) -> None:
        stamp = stamp_ns(message.clock)
        try:
            self._clock.judge(stamp, moving=self.moving)
        except PoiseError as error:
            self._node.refuse(topics.CLOCK, error)
            return
        self._now = stamp
        self.clock_seen = time.monotonic()

    def _on_odom(self, data: bytes) -> None:
        try:
            stamp, pose, twist = self._odom_codec.decode(data)
            share = min((stamp - self._odom_stamp) / (SWAY_TIME * NANOSECONDS), 1.0)
            self._twist += share * (twist - self._twist)
            self._odom_stamp, self._tilt = stamp, tilt(pose[3:])
        except PoiseError as error:
            self._node.refuse(topics.ODOM, error)

    def _on_posture(self, data: bytes) -> None:
        try:
            self._command_stamp = stamp_of(data)
        except PoiseError as error:
            self._node.refuse(topics.POSTURE, error)

    def _on_motion_state(self, message: String) -> None:
        self._motion_active = message.data == topics.MOTION_RUNNING

    def _on_gait_phase(self, message: String) -> None:
        self._gait = message.data

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self._hear_qos(status)
            if status.name.rpartition("/")[2] in WATCHED:
                self._alive[status.name.rpartition("/")[2]] = time.monotonic()
            if status.name.endswith("/balance_controller"):
                self._judge(status.message, {item.key: item.value for item in status.values})
            elif status.name.endswith("/state_estimator"):
                self._hear_estimator({item.key: item.value for item in status.values})

    def _hear_qos(self, status: DiagnosticStatus) -> None:
        found = {}
        for item in status.values:
            words, _, topic = item.key.rpartition(" ")
            deaf = self._needed_heard if item.value.startswith(PUBLISHER) else self._needed_said
            if words == topics.INCOMPATIBLE_QOS and topic in deaf:
                found[topic] = f"{item.value[:REASON_MAX]}, says {status.name[:REASON_MAX]}"
        if found:
            self._incompatible[status.name] = found
        else:
            self._incompatible.pop(status.name, None)

    def _hear_estimator(self, values: dict[str, str]) -> None:
        """Since when the estimator coasts. A stamp that is none counts from now: it may be a drop-out."""
        since = values.get(topics.COASTING, "")
        if not since:
            self._coasting_since = None
        elif _is_count(since):
            self._coasting_since = int(since)
        else:
            self._node.refuse("/diagnostics", f"state_estimator: {topics.COASTING}: '{since[:32]}'")
            self._coasting_since = self._coasting_since or self._now

    def _judge(self, status: str, values: dict[str, str]) -> None:
        """Read the controller's report; a status that is not known is no good news."""
        if status in STATUSES:
            self._status = STATUSES[status]
        elif not status.startswith(IDLE):
            self._node.refuse("/diagnostics", f"balance_controller: unknown status '{status[:32]}'")
            self._status = SolveStatus.DAMPED
        self._joint_fault = values.get(topics.JOINT_FAULT, "")[:REASON_MAX]
        overruns = values.get(topics.OVERRUNS, "0")
        if _is_count(overruns):
            self._overruns = int(overruns)
        else:
            self._node.refuse("/diagnostics", f"balance_controller: {topics.OVERRUNS}: '{overruns[:32]}'")


def _is_count(text: str) -> bool:
    """Whether a text is a number that ``int`` reads: it raises on one of more than 4300 digits."""
    return text.isdecimal() and len(text) <= DIGITS_MAX
