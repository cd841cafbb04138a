"""What the estimator knows, as topics: odometry, contacts, orientation of the inertial unit, pushes, transforms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu
from std_msgs.msg import UInt8MultiArray

from controllers.estimation.estimator import StateEstimator
from controllers.estimation.kernels_predict import ROTATION
from models.errors import MessageError
from models.footprint import base_footprint
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS
from models.nodes.imu import ImuSample, OrientedImuCodec
from models.nodes.messages import WrenchCodec
from models.nodes.odometry import OdometryCodec, contacts_to_bytes
from models.nodes.parameters import describe
from models.nodes.qos import EVENT, LATCHED, SENSOR, sensor
from models.nodes.tf_type import tf_message_type
from models.nodes.transforms import TransformsCodec
from models.types import RobotState, SensorData

_MOVING_FRAMES = ((topics.ODOM_FRAME, topics.BASE_FRAME), (topics.BASE_FRAME, topics.FOOTPRINT_FRAME))


@dataclass(frozen=True, slots=True)
class EstimateRates:
    """Time between two messages [ns]; 0 for every tick."""

    odom: int
    imu: int
    tf: int
    covariance: int
    push: int


def declare_rates(node: PoiseNode, *, shared: bool, lockstep: bool) -> EstimateRates:
    """Declare the rates of what is published.

    Args:
        node: Node that publishes.
        shared: Whether the controller gets the state in this process; otherwise it needs every ``/odom``.
        lockstep: Whether the plant waits for an answer to each tick.
    """

    def period(name: str, default: float, what: str) -> int:
        text = describe(f"Rate of {what} [Hz]", low=1.0, high=1000.0)
        return round(NANOSECONDS / float(node.declare_parameter(name, default, text).value))

    odom = period("odom_rate", 100.0, "/odom and /contacts when the controller shares the process")
    return EstimateRates(
        odom=odom if shared and not lockstep else 0,
        imu=period("imu_rate", 100.0, "/imu/data"),
        tf=period("tf_rate", 50.0, "/tf"),
        covariance=period("covariance_rate", 50.0, "the covariance in /odom, which is repeated in between"),
        push=period("push_rate", 100.0, "/external_wrench"),
    )


class _Due:
    """Divides the stamps into periods and says when another one has begun.

    Args:
        period: [ns]; 0 for every stamp.
        phase: When a period begins, as a share of it: what is published at the same rate shares no tick.
    """

    def __init__(self, period: int, phase: float = 0.0) -> None:
        self._period, self._shift = max(period, 1), round(phase * period)
        self._present = -1

    def __call__(self, stamp: int) -> bool:
        before, self._present = self._present, (stamp - self._shift) // self._period
        return self._present != before


class EstimateTopics:
    """Publishes each state that is due on each topic.

    Args:
        node: Node that publishes.
        law: Estimator whose states they are.
        rates: From ``declare_rates``.
        lockstep: Whether the plant waits for an answer to each tick; ``/odom`` is then reliable.
    """

    def __init__(self, node: PoiseNode, law: StateEstimator, rates: EstimateRates, *, lockstep: bool) -> None:
        self._node, self._law = node, law
        self._codec, self._imu_codec = OdometryCodec(), OrientedImuCodec(topics.IMU_FRAME)
        self._odom_due, self._imu_due, self._tf_due = _Due(rates.odom), _Due(rates.imu, 0.3), _Due(rates.tf, 0.4)
        self._covariance_due, self._push_due = _Due(rates.covariance), _Due(rates.push, 0.6)
        qos = sensor(reliable=lockstep)
        self._odom = node.announce(Odometry, topics.ODOM, qos)
        self._contacts = node.announce(UInt8MultiArray, topics.CONTACTS, qos)
        self._imu = node.announce(Imu, topics.IMU_DATA, SENSOR)
        self._wrench = node.announce(WrenchStamped, topics.EXTERNAL_WRENCH, SENSOR)
        self._wrench_codec = WrenchCodec(topics.ODOM_FRAME)
        self._workspace = node.model.data()
        self._soles = [foot.frame_id for foot in node.model.feet]
        self._tf_codec = TransformsCodec(_MOVING_FRAMES)
        base_footprint(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), np.zeros((2, 3)))  # compiles now, not in a tick
        self._tf = self._announce_transforms()

    def _announce_transforms(self) -> Any:
        """Publisher of ``/tf``; None where this ROS 2 has no such message, which is told."""
        try:
            kind = tf_message_type()
        except MessageError as error:
            self._node.get_logger().warning(f"no transforms on {topics.TF}: {error}")
            self._node.values[topics.TF] = str(error)
            return None
        self._static = self._node.announce(kind, topics.TF_STATIC, LATCHED)
        return self._node.announce(kind, topics.TF, EVENT)

    def start(self, stamp: int) -> None:
        """Publish what does not change, for a robot that begins to be estimated at a stamp [ns]."""
        if self._tf is None:
            return
        frames = static_frames(self._node.model)
        codec = TransformsCodec([(parent, child) for parent, child, _ in frames])
        self._static.publish(codec.encode(stamp, [pose for _, _, pose in frames]))

    def publish(self, state: RobotState, stamp: int, sensors: SensorData) -> None:
        """Publish what is due.

        Args:
            state: Newest state.
            stamp: Its stamp [ns].
            sensors: What it was estimated from.
        """
        if self._odom_due(stamp):
            if self._covariance_due(stamp):
                self._codec.set_covariance(*self._law.odometry_covariance())
            self.publish_odometry(state, stamp)
        if self._imu_due(stamp) and self._law.health.coasting == 0.0:
            self._imu.publish(self._imu_codec.encode(stamp, self._imu_sample(sensors)))
        if self._push_due(stamp):
            push = self._law.push
            self._wrench.publish(self._wrench_codec.encode(stamp, np.concatenate([push.force, push.moment])))
        if self._tf is not None and self._tf_due(stamp):
            self._tf.publish(self._tf_codec.encode(stamp, [state.q[:7], self._footprint(state)]))

    def publish_odometry(self, state: RobotState, stamp: int) -> None:
        """Publish contacts and odometry; the controller in another process waits for the latter."""
        self._contacts.publish(contacts_to_bytes(state.contacts))
        self._odom.publish(self._codec.encode(stamp, state))

    def _imu_sample(self, sensors: SensorData) -> ImuSample:
        """What the inertial unit measured, without the estimated biases, and its orientation."""
        law, axes = self._law, slice(ROTATION, ROTATION + 3)
        return ImuSample(
            orientation=pin.Quaternion(law.filter.rotation).coeffs(),
            covariance=law.filter.covariance[axes, axes],
            gyro=sensors.gyro - law.gyro_bias,
            accel=sensors.accel - law.accel_bias,
        )

    def _footprint(self, state: RobotState) -> Any:
        model, data = self._node.model.pin, self._workspace
        pin.forwardKinematics(model, data, state.q)
        soles = np.array([pin.updateFramePlacement(model, data, sole).translation for sole in self._soles])
        return base_footprint(state.q[:7], soles)


def static_frames(model: Any) -> list[tuple[str, str, Any]]:
    """REP-120 frames that sit on links of the URDF: what ``robot_state_publisher`` cannot know.

    The root link hangs under ``base_link``, so that the tree stays one. A frame named as one of the links is that link
    and left out.

    Args:
        model: The robot.

    Returns:
        Parent, child and pose (7,) of the child in its parent, for each.
    """
    root = model.profile.base_link
    frames = [] if root == topics.BASE_FRAME else [(topics.BASE_FRAME, root, pin.SE3ToXYZQUAT(pin.SE3.Identity()))]
    for name in model.frame_names:
        frame = model.pin.frames[model.frame_id(name)]
        link = model.pin.frames[frame.parentFrame]
        if name == topics.BASE_FRAME or model.pin.existFrame(name, pin.FrameType.BODY):
            continue
        frames.append((link.name, name, pin.SE3ToXYZQUAT(link.placement.actInv(frame.placement))))
    return frames
