"""Collects the reports of the other nodes into the ``Health`` that the supervisor checks."""

import time
from pathlib import Path
from typing import Any

import numpy as np
from msgspec.structs import replace
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from controllers.estimation.stamps import ClockFilter
from controllers.safety.health import Health, SupervisorConfig, second_publisher, tilt
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS, stamp_of
from models.nodes.messages import stamp_ns
from models.nodes.odometry import OdometryCodec
from models.nodes.qos import LATCHED, PUBLISHER, SENSOR
from models.status import (
    ControlStatus,
    EstimatorStatus,
    GaitStatus,
    MotionState,
    MotionStatus,
    NodeStatus,
    StartStatus,
)
from models.types import SolveStatus, Vector

#: Status before the first report of the controller
NO_CONTROL = ControlStatus(active=False, solve=SolveStatus.OPTIMAL, overruns=0, joint_fault="")
WATCHED = ("motion_planner",)  #: Nodes without a stamped topic, supervised by their status
COUNT_PERIOD = 0.2  #: Time between two counts of the sensors' publishers [s]
SWAY_TIME = 1.0  #: Time constant of the mean velocity of the base: one step with each foot [s]
FAST_DDS = bytes((1, 15))  #: Vendor at the start of an endpoint's identity; host and process follow
PROCESSES, PID_MAX = Path("/proc"), 1 << 22  #: Processes of this machine, and the largest process id on Linux
CHECK_MAX = 40_000_000  #: Largest time between two checks that counts as silence of a topic: two periods [ns]
REASON_MAX = 200  #: Longest reason in a report; the rest is cut off [characters]


def publisher_name(end: Any, host: bytes) -> str:
    """Node of a publisher and, where Fast DDS reports it, its process on the machine with the id ``host``."""
    name, gid = f"node '{end.node_namespace.rstrip('/')}/{end.node_name}'", bytes(end.endpoint_gid)
    if gid[:2] != FAST_DDS:
        return name
    if gid[2:4] != host:
        return f"{name} on another machine"
    low = int.from_bytes(gid[4:6], "little")  # of the process id
    found = [pid for pid in range(low, PID_MAX, 1 << 16) if (PROCESSES / str(pid)).exists()]
    return f"{name}, process {found[0]}" if len(found) == 1 else name


class HealthTopics:
    """Newest report of each kind; ages are measured on stamps, that of ``/clock`` in updates of the node.

    Args:
        node: Node that subscribes.
        clock_leap: Largest step of ``/clock`` that is accepted at once [s].
    """

    def __init__(self, node: PoiseNode, clock_leap: float) -> None:
        self._node, self._odom_codec = node, OdometryCodec()
        self._clock = ClockFilter(round(clock_leap * NANOSECONDS))
        self.moving = False  #: Whether the robot moves, set by the node; ``/clock`` must not go back then
        self.description: str | None = None  #: URDF that the robot publishes; None before it has arrived
        self._clock_silence = 0.0  # counted in updates: a stalled node is not a silent clock [s]
        self.now = 0  #: Time of the plant [ns]
        self.tilt = 0.0  #: Newest tilt of the base [rad]
        self._odom_stamp = self._command_stamp = self._started = 0
        self._motion_active = False
        self._control = NO_CONTROL
        self._coasting_since: int | None = None
        self._gait = GaitStatus(ready=False, settled=True)
        self.start_status: StartStatus | None = None  #: Of a real robot; None before its first report, or in simulation
        self._alive: dict[str, tuple[float, int]] = {}  # last status of each node: in real time [s], in plant time [ns]
        self._last_stamps, self._silence = [0, 0], [0, 0]  # of state and command [ns]
        self._checked = 0  # time of the plant at the last check [ns]
        self._twist: Vector = np.zeros(6)
        self._count_at = 0.0
        self._intruders: tuple[str, ...] = ()
        self._publishers: dict[str, bytes] = {}  # identity of the only publisher, by topic
        self._incompatible: dict[str, dict[str, str]] = {}
        self._needed_topics = frozenset(topics.needed_topics(node.model))
        self._needed_outputs = frozenset([topics.JOINT_SETPOINTS])  # other topics may have mismatched observers
        self._sensors = [node.resolve_topic_name(topic) for topic in (*topics.sensor_topics(node.model), topics.CLOCK)]
        node.listen(String, topics.ROBOT_DESCRIPTION, self._on_description, LATCHED)
        node.listen(Clock, topics.CLOCK, self._on_clock, SENSOR)
        node.listen(Odometry, topics.ODOM, self._on_odom, SENSOR, raw=True)
        node.listen(JointState, topics.POSTURE, self._on_posture, SENSOR, raw=True)
        node.listen_status(MotionStatus, topics.MOTION_STATUS, self._on_motion)
        node.listen_status(GaitStatus, topics.GAIT_STATUS, self._on_gait, LATCHED)
        node.listen_status(NodeStatus, topics.NODE_STATUS, self._on_node)
        node.listen_status(StartStatus, topics.START_STATUS, self._on_start, LATCHED)
        node.listen_status(ControlStatus, topics.CONTROL_STATUS, self._on_control, on_malformed=self._on_bad_control)
        node.listen_status(
            EstimatorStatus, topics.ESTIMATOR_STATUS, self._on_estimator, on_malformed=self._on_bad_estimator
        )

    @property
    def t(self) -> float:
        """Time of the plant [s]."""
        return self.now / NANOSECONDS

    @property
    def walking_velocity(self) -> tuple[float, float, float]:
        """Velocity of the base without its sway: forward [m/s], left [m/s], turn [rad/s]."""
        return float(self._twist[0]), float(self._twist[1]), float(self._twist[5])

    @property
    def gait_present(self) -> bool:
        """Whether there is a gait planner, ready to walk."""
        return self._gait.ready and not self._control.gait_silent

    @property
    def gait_active(self) -> bool:
        """Whether the robot walks or is coming to a standstill."""
        return self._control.stepping if self._control.gait_silent else not self._gait.settled

    @property
    def complete(self) -> bool:
        """Whether the clock, a state and a command have arrived; before, their ages are meaningless."""
        return bool(self.now and self._odom_stamp and self._command_stamp)

    @property
    def state_stamp(self) -> int:
        """Stamp of the newest state [ns]."""
        return self._odom_stamp

    def walk(self) -> None:
        """Start of a walk: the gait counts as moving until its first report."""
        self._gait = GaitStatus(ready=True, settled=False)

    def start(self) -> None:
        """Restart the ages of state, command and clock when the robot begins to move."""
        self._odom_stamp = self._command_stamp = self._started = self._checked = self.now
        self._silence = [0, 0]
        self._control = NO_CONTROL
        self._motion_active = False
        self._clock_silence = 0.0

    def clock_silence(self, period: float) -> float:
        """Time without ``/clock`` [s]; called once per update of the node, with its period [s]."""
        self._clock_silence += period
        return self._clock_silence

    @property
    def intruders(self) -> tuple[str, ...]:
        """One sentence per sensor topic, or ``/clock``, with a second publisher: the source of a sample is unknown."""
        now = time.monotonic()
        if now >= self._count_at:
            self._count_at = now + COUNT_PERIOD
            self._intruders = tuple(filter(None, map(self._intruder, self._sensors)))
        return self._intruders

    def _intruder(self, topic: str) -> str:
        """Sentence on a second publisher of a topic; empty if none."""
        ends = {bytes(end.endpoint_gid): end for end in self._node.get_publishers_info_by_topic(topic)}
        if len(ends) == 1:
            self._publishers[topic] = next(iter(ends))
        if len(ends) < 2:
            return ""
        own = self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(topics.NODE_STATUS))
        name = self._node.get_name()
        host = next((bytes(end.endpoint_gid)[2:4] for end in own if end.node_name == name), b"")
        others = [publisher_name(end, host) for gid, end in ends.items() if gid != self._publishers.get(topic)]
        return second_publisher(topic, " and ".join(sorted(others)))

    @property
    def incompatible(self) -> dict[str, str]:
        """Needed topics with incompatible QoS, with node and policy, from the last report of each node."""
        return {topic: who for found in self._incompatible.values() for topic, who in found.items()}

    def health(self, driver_state: str, config: SupervisorConfig) -> Health:
        """Health of the graph.

        ``driver_state`` is the reported state of the drivers. Damped drivers are a fault only after
        ``config.controller_timeout`` since the robot began to move. A node is silent after ``config.heartbeat_timeout``
        both in real time and in plant time: slowed time shows a slow machine, on which reports are late, too.
        """
        armed = self.now - self._started > config.controller_timeout * NANOSECONDS
        oldest = time.monotonic() - config.heartbeat_timeout
        holds = () if self.start_status is None else self.start_status.holds
        late = round(config.heartbeat_timeout * NANOSECONDS)
        advance, self._checked = min(self.now - self._checked, CHECK_MAX), self.now
        return Health(
            state_stamp=self._last_seen(0, self._odom_stamp, late, advance) / NANOSECONDS,
            command_stamp=self._last_seen(1, self._command_stamp, late, advance) / NANOSECONDS,
            tilt=self.tilt,
            status=self._control.solve,
            drivers_damped=armed and driver_state == topics.DAMPED,
            motion_active=self._motion_active,
            overruns=self._control.overruns,
            gait_active=self.gait_active,
            coasting=0.0 if self._coasting_since is None else (self.now - self._coasting_since) / NANOSECONDS,
            silent=tuple(
                name
                for name, (real, plant) in self._alive.items()
                if real < oldest and not 0 <= self.now - plant <= late  # a clock that went back shows nothing
            ),
            intruders=self.intruders,
            hardware=tuple(reason[:REASON_MAX] for reason in holds),
            joint_fault=self._control.joint_fault if driver_state == topics.ACTIVE else "",
        )

    def _last_seen(self, which: int, stamp: int, late: int, advance: int) -> int:
        """Stamp from which an age is counted [ns]: the present time while the stamps advance between two checks.

        An advancing stamp shows that the publisher is alive and only this process and its queue are late; the drivers
        refuse commands that are too old. A delay above ``late`` [ns] means another clock: the stamp itself counts.
        ``advance`` [ns] is the silence between two checks; it is bounded: after a stall the clock may be read first.
        """
        moved, self._last_stamps[which] = stamp != self._last_stamps[which], stamp
        self._silence[which] = 0 if moved else self._silence[which] + advance
        return self.now - self._silence[which] if self.now - stamp <= late else stamp

    def _on_description(self, message: String) -> None:
        self.description = message.data

    def _on_clock(self, message: Clock) -> None:
        stamp = stamp_ns(message.clock)
        self._clock.check(stamp, moving=self.moving)
        self.now = stamp
        self._clock_silence = 0.0

    def _on_odom(self, data: bytes) -> None:
        stamp, pose, twist = self._odom_codec.decode(data)
        share = min(max((stamp - self._odom_stamp) / (SWAY_TIME * NANOSECONDS), 0.0), 1.0)
        self._twist += share * (twist - self._twist)
        self._odom_stamp, self.tilt = stamp, tilt(pose[3:])

    def _on_posture(self, data: bytes) -> None:
        self._command_stamp = stamp_of(data)

    def _on_motion(self, status: MotionStatus) -> None:
        if status.state in (MotionState.RUNNING, MotionState.DONE, MotionState.ENDED):
            self._motion_active = status.state is MotionState.RUNNING

    def _on_gait(self, status: GaitStatus) -> None:
        self._gait = status

    def _on_start(self, status: StartStatus) -> None:
        self.start_status = status

    def _on_node(self, status: NodeStatus) -> None:
        if status.name in WATCHED:
            self._alive[status.name] = time.monotonic(), self.now
        self._incompatible.pop(status.name, None)
        found = {}
        for topic, end, policy in zip(status.topics, status.ends, status.policies, strict=False):
            if topic in (self._needed_topics if end == PUBLISHER else self._needed_outputs):
                found[topic] = f"{end}: {policy}, reports {status.name}"[:REASON_MAX]
        if found:
            self._incompatible[status.name] = found

    def _on_control(self, status: ControlStatus) -> None:
        """Store the report; an idle controller keeps its last solver status."""
        solve = status.solve if status.active else self._control.solve
        self._control = replace(status, solve=solve, joint_fault=status.joint_fault[:REASON_MAX])

    def _on_bad_control(self) -> None:
        """A malformed report counts as a failure."""
        self._control = replace(self._control, solve=SolveStatus.DAMPED)

    def _on_estimator(self, status: EstimatorStatus) -> None:
        self._coasting_since = status.coasting_since

    def _on_bad_estimator(self) -> None:
        """A malformed report counts as the start of a drop-out."""
        self._coasting_since = self._coasting_since or self.now
