"""State estimate as topics: odometry, contacts, IMU orientation, pushes, transforms."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from geometry_msgs.msg import TransformStamped, WrenchStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu
from std_msgs.msg import Float64, UInt8MultiArray

from controllers.estimation.estimator import StateEstimator
from controllers.estimation.filter_kernels import ROTATION
from controllers.estimation.stamps import Due
from models.errors import MessageError
from models.heading import base_footprint
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.imu import ImuSample, OrientedImuCodec
from models.nodes.interfaces import interface
from models.nodes.messages import WrenchCodec, set_stamp
from models.nodes.odometry import OdometryCodec, contacts_to_bytes
from models.nodes.parameters import declare_period
from models.nodes.qos import EVENT, LATCHED, STATE
from models.robot_model import SOLE_FRAMES, RobotModel
from models.types import RobotState, SensorData, Vector

FRICTION_CHANGE = 0.005  #: Least change of the coefficient that is published [-]


@dataclass(frozen=True, slots=True)
class EstimateRates:
    """Time between two messages [ns]; 0: every tick."""

    odom: int
    imu: int
    tf: int
    covariance: int
    push: int


def declare_rates(node: PoiseNode, *, shared: bool, lockstep: bool) -> EstimateRates:
    """Declare the publication rates; a controller in another process and lockstep need every ``/odom``."""
    odom = declare_period(node, "odom_rate", 100.0, "/odom and /contacts when the controller shares the process")
    repeated = "the updates of the covariance in /odom"
    return EstimateRates(
        odom=odom if shared and not lockstep else 0,
        imu=declare_period(node, "imu_rate", 100.0, "/imu/data"),
        tf=declare_period(node, "tf_rate", 50.0, "/tf"),
        covariance=declare_period(node, "covariance_rate", 50.0, repeated),
        push=declare_period(node, "push_rate", 100.0, "/external_wrench"),
    )


class EstimateTopics:
    """Publishes each state on each topic when due."""

    def __init__(self, node: PoiseNode, law: StateEstimator, rates: EstimateRates) -> None:
        self._node, self._law = node, law
        self._codec, self._imu_codec = OdometryCodec(), OrientedImuCodec(topics.IMU_FRAME)
        self._odom_due, self._imu_due, self._tf_due = Due(rates.odom), Due(rates.imu, 0.3), Due(rates.tf, 0.4)
        self._covariance_due, self._push_due = Due(rates.covariance), Due(rates.push, 0.6)
        self._odom = node.announce(Odometry, topics.ODOM, STATE)
        self._contacts = node.announce(UInt8MultiArray, topics.CONTACTS, STATE)
        feet = zip(topics.CONTACT_WRENCHES, SOLE_FRAMES, strict=True) if rates.odom == 0 else ()
        self._reactions = [(node.announce(WrenchStamped, topic, STATE), WrenchCodec(frame)) for topic, frame in feet]
        self._friction, self._friction_sent = node.announce(Float64, topics.GROUND_FRICTION, LATCHED), math.inf
        self._imu = node.announce(Imu, topics.IMU_DATA, STATE)
        self._wrench = node.announce(WrenchStamped, topics.EXTERNAL_WRENCH, STATE)
        self._wrench_codec = WrenchCodec(topics.ODOM_FRAME)
        self._transforms = TransformTopics(node)

    def start(self, stamp: int) -> None:
        """Publish constant data when estimation starts at a stamp [ns]."""
        self._transforms.start(stamp)

    def publish(self, state: RobotState, stamp: int, sensors: SensorData) -> None:
        """Publish the topics that are due, from a state, its stamp [ns] and the samples used for the estimate."""
        if self._odom_due(stamp):
            if self._covariance_due(stamp):
                self._codec.set_covariance(*self._law.odometry_covariance())
            self.publish_odometry(state, stamp)
        if self._imu_due(stamp) and self._law.health.coasting == 0.0:
            self._imu.publish(self._imu_codec.encode(stamp, self._imu_sample(sensors)))
        if self._push_due(stamp):
            push = self._law.push
            self._wrench.publish(self._wrench_codec.encode(stamp, np.concatenate([push.force, push.moment])))
        if self._tf_due(stamp):
            self._transforms.publish(state, stamp)

    def publish_odometry(self, state: RobotState, stamp: int) -> None:
        """Publish contacts, friction and odometry; a controller in another process waits for the odometry."""
        for (topic, codec), contact in zip(self._reactions, state.contacts, strict=False):
            topic.publish(codec.encode(stamp, contact.wrench))
        self._contacts.publish(contacts_to_bytes(state.contacts))
        if abs(state.friction - self._friction_sent) >= FRICTION_CHANGE:
            self._friction_sent = state.friction
            self._friction.publish(Float64(data=state.friction))
        self._odom.publish(self._codec.encode(stamp, state))

    def _imu_sample(self, sensors: SensorData) -> ImuSample:
        """Measurement of the IMU without the estimated biases, and its orientation."""
        law, axes = self._law, slice(ROTATION, ROTATION + 3)
        return ImuSample(
            orientation=pin.Quaternion(law.filter.state.rotation).coeffs(),
            covariance=law.filter.state.covariance[axes, axes],
            gyro=sensors.gyro - law.gyro_bias,
            accel=sensors.accel - law.accel_bias,
        )


_MOVING_FRAMES = ((topics.ODOM_FRAME, topics.BASE_FRAME), (topics.BASE_FRAME, topics.FOOTPRINT_FRAME))


class TransformTopics:
    """Publishes the moving frames, and once the frames fixed to links; disabled if ``tf2_msgs`` is not built."""

    def __init__(self, node: PoiseNode) -> None:
        self._node = node
        self._workspace = node.model.data()
        self._soles = [foot.frame_id for foot in node.model.feet]
        base_footprint(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), np.zeros((2, 3)))  # compiles now, not in a tick
        self._moving: Any = None
        try:
            kind = interface("tf2_msgs", "msg", "TFMessage")
        except MessageError as error:
            node.get_logger().warning(f"no transforms on {topics.TF}: {error}")
            node.values[topics.TF] = str(error)
            return
        self._static = node.announce(kind, topics.TF_STATIC, LATCHED)
        self._moving = node.announce(kind, topics.TF, EVENT)
        self._message = kind(transforms=[_transform(*frames) for frames in _MOVING_FRAMES])

    def start(self, stamp: int) -> None:
        """Publish static frames when estimation starts at a stamp [ns]."""
        if self._moving is None:
            return
        frames = static_frames(self._node.model)
        message = type(self._message)(transforms=[_transform(parent, child) for parent, child, _ in frames])
        _set_poses(message, stamp, [pose for _, _, pose in frames])
        self._static.publish(message)

    def publish(self, state: RobotState, stamp: int) -> None:
        """Publish the moving frames of a state at its stamp [ns]."""
        if self._moving is not None:
            _set_poses(self._message, stamp, [state.q[:7], self._footprint(state)])
            self._moving.publish(self._message)

    def _footprint(self, state: RobotState) -> Vector:
        model, data = self._node.model.pin, self._workspace
        pin.forwardKinematics(model, data, state.q)
        soles = np.array([pin.updateFramePlacement(model, data, sole).translation for sole in self._soles])
        return base_footprint(state.q[:7], soles)


def _transform(parent: str, child: str) -> Any:
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id = parent
    return message


def _set_poses(message: Any, stamp: int, poses: Sequence[Vector]) -> None:
    """Write the stamp [ns] and the pose of each child in its parent (7,)."""
    for each, pose in zip(message.transforms, poses, strict=True):
        set_stamp(each.header.stamp, stamp)
        p, o = each.transform.translation, each.transform.rotation
        p.x, p.y, p.z, o.x, o.y, o.z, o.w = pose.tolist()


def static_frames(model: RobotModel) -> list[tuple[str, str, Any]]:
    """REP-120 frames fixed to links of the URDF that ``robot_state_publisher`` does not publish.

    The root link is a child of ``base_link``, so that there is one tree. A frame with the name of a link is left out.
    Returns parent, child and pose (7,) of the child in its parent, for each.
    """
    root = model.profile.base_link
    frames = [] if root == topics.BASE_FRAME else [(topics.BASE_FRAME, root, pin.SE3ToXYZQUAT(pin.SE3.Identity()))]
    for name in model.frame_names:
        if name != topics.BASE_FRAME and not model.pin.existFrame(name, pin.FrameType.BODY):
            link, placement = model.frame_on_link(name)
            frames.append((link, name, pin.SE3ToXYZQUAT(placement)))
    return frames
