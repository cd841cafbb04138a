"""Settings and subscriptions of the page, and the records that it draws."""

import time
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry, Path
from pydantic import Field
from pydantic.dataclasses import dataclass as config_dataclass
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String

from bridge.ros.client import Client, next_step, start_lines
from bridge.ros.environment import ignore, newest
from bridge.ros.namespace import in_namespace
from models.config import STRICT, Positive
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.cdr import numbers_of
from models.nodes.messages import JointStateCodec, WrenchCodec, to_seconds
from models.nodes.odometry import OdometryCodec
from models.nodes.qos import EVENT, LATCHED, SENSOR
from models.nodes.status import subscribe_status
from models.robot_model import SOLE_FRAMES, RobotModel
from models.status import ControlStatus, StartStatus
from models.types import Matrix, Mode, Vector
from planners.gait.footsteps import Foothold
from planners.nodes.footstep_messages import foothold_from_pose


@config_dataclass(frozen=True, slots=True, config=STRICT)
class ViewConfig:
    """Rates and contents of the page; see ``bridge/config/view.yaml``."""

    rate: Positive
    plot_rate: Positive
    map_rate: Positive
    plot_window: Positive
    force_scale: Positive
    force_least: Positive
    drive_idle: Positive
    drive_rate: Positive
    push_force_max: Positive
    torques: Annotated[int, Field(ge=1)]
    answer_timeout: Positive
    silence: Positive
    slow: Positive


@dataclass(frozen=True, slots=True)
class Snapshot:
    """State of the robot at one stamp, from the topics; W is ``odom``."""

    t: float  #: Stamp of the joint states [s]
    q: Vector  #: Estimated configuration (nq,) [m, rad]
    v: Vector  #: Estimated velocity (nv,) [m/s, rad/s]
    tau: Vector  #: Measured joint torques (nj,) [N.m]
    wrenches: Matrix  #: Ground reaction on each foot in its sole frame (2, 6) [N, N.m]; zero without a sensor
    push: Vector  #: Estimated push about the CoM in W: force, moment (6,) [N, N.m]
    footsteps: tuple[tuple[int, Foothold], ...]  #: Foot (0 left, 1 right) and foothold of the next footsteps in W
    #: Margin of the DCM inside the region from which one step brings it to rest [m]; NaN when not walking
    margin: float


@dataclass(frozen=True, slots=True)
class Words:
    """Status texts of the robot."""

    mode: str = ""  #: Mode of the supervisor; empty before the first message
    drivers: str = ""  #: State of the joint drivers
    phase: str = ""  #: Phase of the gait
    commander: str = ""  #: Active command source
    factor: float = float("nan")  #: Real-time factor; NaN while unknown
    faults: tuple[tuple[str, str], ...] = ()  #: Faulty topics, nodes or quantities, each with the reason
    start: tuple[tuple[str, str], ...] = ()  #: State of the start and of the monitors, for a real robot only
    next: str = ""  #: Next action of the user
    waiting: str = ""  #: Missing data of the picture; empty while all data arrive
    tick_median: float = float("nan")  #: Median of the controller's last ticks [us]; NaN before its first diagnostics
    tick_tail: float = float("nan")  #: 99th percentile of these [us]


REFUSAL_TIME = 10.0  #: Time for which a refusal is displayed [s]
START = "start a robot with poise up; this page continues when its data arrive"


class Listener:
    """Stores the newest message of each topic of the page; sensor subscriptions are polled once for each picture."""

    def __init__(self, model: RobotModel, client: Client, config: ViewConfig) -> None:
        self._client, self._config = client, config
        name = f"{client.node.get_name()}_view"
        self._node = Node(name, context=client.node.context, **in_namespace(client.namespace))
        subscribe = self._node.create_subscription
        self._joints = subscribe(JointState, topics.JOINT_STATES, ignore, SENSOR, raw=True)
        self._odom = subscribe(Odometry, topics.ODOM, ignore, SENSOR, raw=True)
        self._feet = [
            subscribe(WrenchStamped, topic, ignore, SENSOR, raw=True) for topic in topics.foot_wrenches(model)
        ]
        self._codecs = JointStateCodec(model), OdometryCodec(), [WrenchCodec(frame) for frame in SOLE_FRAMES]
        self._t, self._tau = 0.0, np.zeros(model.nj)
        self._base: tuple[Vector, Vector] | None = None
        self._joint_state: tuple[Vector, Vector] | None = None
        self._wrenches, self._push = np.zeros((2, 6)), np.zeros(6)
        self._footsteps: tuple[tuple[int, Foothold], ...] = ()
        self._margin, self._since = float("nan"), time.monotonic()
        self._words = Words()
        self._start: StartStatus | None = None
        self._received: dict[str, float] = {}  # monotonic time of the newest sample by topic [s]
        self._statuses: dict[str, tuple[float, Any]] = {}  # the same with the diagnostics, by node
        self._refusals: dict[str, tuple[float, str]] = {}  # the same with the reason, by node or topic
        listen = client.node.create_subscription
        listen(String, topics.GAIT_PHASE, self._word("phase"), LATCHED)
        listen(WrenchStamped, topics.EXTERNAL_WRENCH, self._on_push, SENSOR)
        listen(Float64, topics.GAIT_CAPTURE_MARGIN, self._on_margin, SENSOR)
        listen(DiagnosticStatus, topics.REFUSALS, self._on_refusal, EVENT)  # not latched: unknown age
        listen(Path, topics.FOOTSTEPS, self._on_footsteps, EVENT)
        listen(DiagnosticArray, "/diagnostics", self._on_diagnostics, EVENT)
        subscribe_status(client.node, ControlStatus, topics.CONTROL_STATUS, self._on_control)
        subscribe_status(client.node, StartStatus, topics.START_STATUS, self._on_start, LATCHED)

    def poll(self) -> Snapshot | None:
        """Newest state; None before joints and base have arrived. Malformed messages become faults in ``words``."""
        joint_codec, odom_codec, foot_codecs = self._codecs
        if (joints := self._take(self._joints, joint_codec)) is not None:
            stamp, q, v, self._tau = joints
            self._t, self._joint_state = to_seconds(stamp), (q, v)
        if (odom := self._take(self._odom, odom_codec)) is not None:
            self._base = odom[1:]
        for foot, subscription in enumerate(self._feet):
            if (sample := self._take(subscription, foot_codecs[foot])) is not None:
                self._wrenches[foot] = sample[1]
        if self._base is None or self._joint_state is None:
            return None
        walks = self._client.mode == Mode.WALK.value
        return Snapshot(
            t=self._t,
            q=np.concatenate([self._base[0], self._joint_state[0]]),
            v=np.concatenate([self._base[1], self._joint_state[1]]),
            tau=self._tau,
            wrenches=self._wrenches.copy(),
            push=self._push,
            footsteps=self._footsteps if walks else (),
            margin=self._margin if walks else float("nan"),
        )

    def _take(self, subscription: Any, codec: Any) -> Any:
        """Newest decoded sample of a subscription; None without a new, valid one."""
        try:
            if (data := newest(subscription)) is None:
                return None
            sample = codec.decode(data)
        except PoiseError as error:
            self._refuse(subscription.topic_name, str(error))
            return None
        self._received[subscription.topic_name] = time.monotonic()
        return sample

    def _refuse(self, topic: str, reason: str) -> None:
        self._refusals[topic] = time.monotonic(), reason

    def words(self) -> Words:
        """Status texts of the robot."""
        now, silence, client = time.monotonic(), self._config.silence, self._client
        needed = [subscription.topic_name for subscription in (self._joints, self._odom, *self._feet)]
        ages = {topic: now - self._received.get(topic, self._since) for topic in needed}
        absent = [topic for topic in needed if topic not in self._received or ages[topic] > silence]
        nodes = sorted(self._statuses.items())
        alive = any(now - received <= silence for _, (received, _) in nodes)
        faults = [(topic, f"no data for {ages[topic]:.0f} s") for topic in absent]
        if alive:  # otherwise the whole robot is silent
            faults += [
                (node, "no diagnostics: its process may have ended") for node, (at, _) in nodes if now - at > silence
            ]
        faults += [(node, str(status.message)) for node, (_, status) in nodes if status.level != DiagnosticStatus.OK]
        faults += [(topic, reason) for topic, (at, reason) in self._refusals.items() if now - at <= REFUSAL_TIME]
        if alive and 0.0 < client.factor < self._config.slow:
            reason = f"{client.factor:.2f}: other programs use the processor, or a lower speed was requested"
            faults.append(("real-time factor", reason))
        if client.mode in (Mode.OFF.value, Mode.DAMP.value):
            faults.append(("mode", f"{client.mode}: no controller supports the robot"))
        return replace(
            self._words,
            mode=client.mode,
            drivers=client.driver_state,
            commander=client.commander,
            factor=client.factor,
            faults=tuple(faults),
            start=() if self._start is None else tuple(start_lines(self._start).items()),
            next=(client.paused or next_step(client.status, self._start)) if alive and client.status else START,
            waiting=f"waiting for data on {', '.join(absent)}" if absent else "",
        )

    def close(self) -> None:
        """Leave the graph."""
        self._node.destroy_node()

    def _word(self, field: str) -> Any:
        def on_word(message: Any) -> None:
            self._words = replace(self._words, **{field: message.data})

        return on_word

    def _on_push(self, message: WrenchStamped) -> None:
        self._push = numbers_of(message.wrench)

    def _on_margin(self, message: Float64) -> None:
        self._margin = float(message.data)

    def _on_refusal(self, message: DiagnosticStatus) -> None:
        self._refusals[message.name] = time.monotonic(), str(message.message)

    def _on_footsteps(self, message: Path) -> None:
        try:
            self._footsteps = tuple(
                (SOLE_FRAMES.index(pose.header.frame_id), foothold_from_pose("footstep", pose.pose))
                for pose in message.poses
            )
        except (PoiseError, ValueError) as error:
            self._refuse(topics.FOOTSTEPS, str(error))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if not (space := self._client.namespace) or status.name.startswith(f"{space}/"):
                self._statuses[status.name] = (time.monotonic(), status)

    def _on_start(self, status: StartStatus) -> None:
        self._start = status

    def _on_control(self, status: ControlStatus) -> None:
        self._words = replace(self._words, tick_median=status.tick_median_us, tick_tail=status.tick_tail_us)
