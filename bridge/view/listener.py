"""Settings and subscriptions of the page, and the records to draw."""

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

from bridge.ros.client import Client
from bridge.ros.environment import ignore, newest
from bridge.ros.processes import in_namespace
from models.config import STRICT, Positive
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.cdr import numbers_of
from models.nodes.messages import JointStateCodec, WrenchCodec, to_seconds
from models.nodes.odometry import OdometryCodec
from models.nodes.qos import EVENT, LATCHED, SENSOR
from models.nodes.status import subscribe_status
from models.robot_model import SOLE_FRAMES, RobotModel
from models.status import ControlStatus
from models.types import Matrix, Mode, Vector
from planners.gait.footsteps import Foothold
from planners.nodes.footstep_messages import foothold_from_pose


@config_dataclass(frozen=True, slots=True, config=STRICT)
class ViewConfig:
    """Rates and contents of the page; see ``bridge/config/view.yaml``."""

    rate: Positive
    plot_rate: Positive
    plot_window: Positive
    force_scale: Positive
    force_least: Positive
    drive_idle: Positive
    drive_rate: Positive
    push_force_max: Positive
    torques: Annotated[int, Field(ge=1)]
    answer_timeout: Positive


@dataclass(frozen=True, slots=True)
class Snapshot:
    """State of the robot at one stamp, from its topics; W is ``odom``."""

    t: float  #: Stamp of the joint states [s]
    q: Vector  #: Estimated configuration (nq,) [m, rad]
    v: Vector  #: Estimated velocity (nv,) [m/s, rad/s]
    tau: Vector  #: Measured joint torques (nj,) [N.m]
    wrenches: Matrix  #: Ground reaction on each foot in its sole frame (2, 6) [N, N.m]; zero without a sensor
    push: Vector  #: Estimated push about the CoM in W: force, moment (6,) [N, N.m]
    footsteps: tuple[tuple[int, Foothold], ...]  #: Foot (0 left, 1 right) and place of the coming footsteps in W
    #: Distance of the DCM inside the region from which one step brings it to rest [m]; NaN when not walking
    margin: float


@dataclass(frozen=True, slots=True)
class Words:
    """Status texts of the robot."""

    mode: str = ""  #: Of the supervisor; empty before the first word
    drivers: str = ""  #: State of the joint drivers
    phase: str = ""  #: Of the gait
    commander: str = ""  #: Source in command
    faults: tuple[tuple[str, str], ...] = ()  #: Latched faults, and the messages of nodes with errors, by node
    tick_median: float = float("nan")  #: Of the controller's last ticks [us]; NaN before its first diagnostics
    tick_tail: float = float("nan")  #: 99th percentile of these [us]


SILENCE = 3.0  #: Age of diagnostics above which a node counts as stopped, and of joints above which they are old [s]


class Listener:
    """Stores the newest message of every topic of the page; sensor subscriptions are polled once per picture."""

    def __init__(self, model: RobotModel, client: Client) -> None:
        self._model = model
        self._node = Node("poise_view", context=client.node.context, **in_namespace(client.namespace))
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
        self._margin, self._received = float("nan"), time.monotonic()
        self._words = Words()
        self._statuses: dict[str, tuple[float, Any]] = {}
        self.refused = 0
        listen = client.node.create_subscription
        for field, topic in {
            "mode": topics.MODE,
            "drivers": topics.DRIVER_STATE,
            "phase": topics.GAIT_PHASE,
            "commander": topics.COMMANDER,
        }.items():
            listen(String, topic, self._word(field), LATCHED)
        listen(WrenchStamped, topics.EXTERNAL_WRENCH, self._on_push, SENSOR)
        listen(Float64, topics.GAIT_CAPTURE_MARGIN, self._on_margin, SENSOR)
        listen(Path, topics.FOOTSTEPS, self._on_footsteps, EVENT)
        listen(DiagnosticArray, "/diagnostics", self._on_diagnostics, EVENT)
        subscribe_status(client.node, ControlStatus, topics.CONTROL_STATUS, self._on_control)

    def poll(self) -> Snapshot | None:
        """Newest state; None before joints and base have arrived. Malformed messages are counted in ``refused``."""
        joint_codec, odom_codec, foot_codecs = self._codecs
        if (joints := self._take(self._joints, joint_codec)) is not None:
            stamp, q, v, self._tau = joints
            self._t, self._joint_state, self._received = to_seconds(stamp), (q, v), time.monotonic()
        if (odom := self._take(self._odom, odom_codec)) is not None:
            self._base = odom[1:]
        for foot, subscription in enumerate(self._feet):
            if (sample := self._take(subscription, foot_codecs[foot])) is not None:
                self._wrenches[foot] = sample[1]
        if self._base is None or self._joint_state is None:
            return None
        walks = self._words.mode == Mode.WALK.value
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
        """Newest decoded sample of a subscription; None without a new or valid one."""
        try:
            data = newest(subscription)
            return None if data is None else codec.decode(data)
        except PoiseError:
            self.refused += 1
            return None

    def words(self) -> Words:
        """Status texts of the robot."""
        now = time.monotonic()
        faults = [
            (name, str(status.message))
            for name, (_, status) in sorted(self._statuses.items())
            if status.level in (DiagnosticStatus.WARN, DiagnosticStatus.ERROR)
        ]
        faults += [
            (name, "silent") for name, (received, _) in sorted(self._statuses.items()) if now - received > SILENCE
        ]
        if now - self._received > SILENCE:
            faults.append((topics.JOINT_STATES, "silent: the picture is old"))
        return replace(self._words, faults=tuple(faults))

    def close(self) -> None:
        """Leave the graph."""
        self._node.destroy_node()

    def _word(self, field: str) -> Any:
        def on_word(message: String) -> None:
            self._words = replace(self._words, **{field: message.data})

        return on_word

    def _on_push(self, message: WrenchStamped) -> None:
        self._push = numbers_of(message.wrench)

    def _on_margin(self, message: Float64) -> None:
        self._margin = float(message.data)

    def _on_footsteps(self, message: Path) -> None:
        try:
            self._footsteps = tuple(
                (SOLE_FRAMES.index(pose.header.frame_id), foothold_from_pose("footstep", pose.pose))
                for pose in message.poses
            )
        except (PoiseError, ValueError):
            self.refused += 1

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self._statuses[status.name] = (time.monotonic(), status)

    def _on_control(self, status: ControlStatus) -> None:
        self._words = replace(self._words, tick_median=status.tick_median_us, tick_tail=status.tick_tail_us)
