"""Collects the evidence for the preflight checks; subscribed to the fast topics only meanwhile."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu, JointState

from controllers.safety.preflight import Evidence
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS
from models.nodes.messages import ImuCodec, JointStateCodec, WrenchCodec
from models.nodes.odometry import OdometryCodec
from models.nodes.qos import SENSOR_QUEUE
from models.robot_model import SOLE_FRAMES
from models.types import Vector


class PreflightProbe:
    """Samples the sensor topics and the odometry while open."""

    def __init__(self, node: PoiseNode) -> None:
        self._node = node
        imu = ImuCodec(topics.IMU_FRAME)
        self._joint_codec, self._odom_codec = JointStateCodec(node.model), OdometryCodec()
        #: Message type of each topic, and a function that stores a message and returns its stamp [ns]
        self._takers: dict[str, tuple[type, Callable[[bytes], int]]] = {
            topics.JOINT_STATES: (JointState, self._take_joints),
            topics.IMU_RAW: (Imu, lambda data: imu.decode(data)[0]),
            topics.ODOM: (Odometry, self._take_odom),
        }
        for topic, frame in zip(topics.foot_wrenches(node.model), SOLE_FRAMES, strict=False):
            self._takers[topic] = WrenchStamped, partial(_foot_stamp, WrenchCodec(frame))
        self._stamps: dict[str, list[int]] = {}
        self._refusals: dict[str, str] = {}
        self._joints: Vector | None = None
        self._quaternion: Vector | None = None
        self._subscriptions: list[Any] = []

    @property
    def open(self) -> bool:
        """Whether it is subscribed."""
        return bool(self._subscriptions)

    def start(self) -> None:
        """Discard old samples and subscribe."""
        self.stop()
        self._stamps = {topic: [] for topic in topics.sensor_topics(self._node.model)}
        self._refusals, self._joints, self._quaternion = {}, None, None
        subscribe = self._node.create_subscription
        self._subscriptions = [
            subscribe(kind, topic, partial(self._on_message, topic, take), SENSOR_QUEUE, raw=True)
            for topic, (kind, take) in self._takers.items()
        ]

    def stop(self) -> None:
        """Unsubscribe."""
        while self._subscriptions:
            self._node.destroy_subscription(self._subscriptions.pop())

    def evidence(self, description: str | None, incompatible: Mapping[str, str]) -> Evidence:
        """Evidence from the samples since ``start``, the URDF if received, and the QoS mismatches of needed topics."""
        rates = {}
        for topic, stamps in self._stamps.items():
            span = stamps[-1] - stamps[0] if len(stamps) > 1 else 0
            rates[topic] = (len(stamps) - 1) * NANOSECONDS / span if span > 0 else 0.0
        return Evidence(description, self._joints, dict(self._refusals), self._quaternion, rates, incompatible)

    def _on_message(self, topic: str, take: Callable[[bytes], int], data: bytes) -> None:
        try:
            stamp = take(data)
            if topic in self._stamps:
                self._stamps[topic].append(stamp)
        except PoiseError as error:
            self._refusals[topic] = str(error)

    def _take_joints(self, data: bytes) -> int:
        stamp, self._joints, _, _ = self._joint_codec.decode(data)
        return stamp

    def _take_odom(self, data: bytes) -> int:
        stamp, pose, _ = self._odom_codec.decode(data)
        self._quaternion = pose[3:]
        return stamp


def _foot_stamp(codec: WrenchCodec, data: bytes) -> int:
    return codec.decode(data)[0]
