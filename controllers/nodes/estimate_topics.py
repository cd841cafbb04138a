"""What the estimator knows, as topics: odometry, contacts, orientation of the inertial unit, pushes, transforms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu
from std_msgs.msg import UInt8MultiArray

from controllers.estimation.estimator import StateEstimator
from controllers.estimation.kernels_predict import ROTATION
from controllers.nodes.due import Due
from controllers.nodes.transform_topics import TransformTopics
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS
from models.nodes.imu import ImuSample, OrientedImuCodec
from models.nodes.messages import WrenchCodec
from models.nodes.odometry import OdometryCodec, contacts_to_bytes
from models.nodes.parameters import describe
from models.nodes.qos import SENSOR, sensor
from models.types import RobotState, SensorData


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
        self._odom_due, self._imu_due, self._tf_due = Due(rates.odom), Due(rates.imu, 0.3), Due(rates.tf, 0.4)
        self._covariance_due, self._push_due = Due(rates.covariance), Due(rates.push, 0.6)
        qos = sensor(reliable=lockstep)
        self._odom = node.announce(Odometry, topics.ODOM, qos)
        self._contacts = node.announce(UInt8MultiArray, topics.CONTACTS, qos)
        self._imu = node.announce(Imu, topics.IMU_DATA, SENSOR)
        self._wrench = node.announce(WrenchStamped, topics.EXTERNAL_WRENCH, SENSOR)
        self._wrench_codec = WrenchCodec(topics.ODOM_FRAME)
        self._transforms = TransformTopics(node)

    def start(self, stamp: int) -> None:
        """Publish what does not change, for a robot that begins to be estimated at a stamp [ns]."""
        self._transforms.start(stamp)

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
        if self._tf_due(stamp):
            self._transforms.publish(state, stamp)

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
