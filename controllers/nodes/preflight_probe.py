"""Collects the evidence for the preflight checks; subscribes to the fast topics only meanwhile."""

from __future__ import annotations

from collections.abc import Callable, Mapping
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
    """Samples every sensor once."""

    def __init__(self, node: PoiseNode) -> None:
        self._node = node
        self._joint_codec, self._imu_codec = JointStateCodec(node.model), ImuCodec(topics.IMU_FRAME)
        self._foot_codecs = [WrenchCodec(frame) for frame in SOLE_FRAMES]
        self._odom_codec = OdometryCodec()
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

        def listen(kind: type, topic: str, take: Callable[[bytes], int]) -> None:
            def on_message(data: bytes) -> None:
                try:
                    stamp = take(data)
                    if topic in self._stamps:
                        self._stamps[topic].append(stamp)
                except PoiseError as error:
                    self._refusals[topic] = str(error)

            self._subscriptions.append(self._node.create_subscription(kind, topic, on_message, SENSOR_QUEUE, raw=True))

        listen(JointState, topics.JOINT_STATES, self._take_joints)
        listen(Imu, topics.IMU_RAW, lambda data: self._imu_codec.decode(data)[0])
        for foot, topic in enumerate(topics.foot_wrenches(self._node.model)):
            listen(WrenchStamped, topic, self._foot_decoder(foot))
        listen(Odometry, topics.ODOM, self._take_odom)

    def stop(self) -> None:
        """Unsubscribe."""
        while self._subscriptions:
            self._node.destroy_subscription(self._subscriptions.pop())

    def evidence(self, description: str | None, incompatible: Mapping[str, str]) -> Evidence:
        """Samples since ``start``, with the URDF, if it has arrived, and the QoS mismatches of needed topics."""
        rates = {}
        for topic, stamps in self._stamps.items():
            span = stamps[-1] - stamps[0] if len(stamps) > 1 else 0
            rates[topic] = (len(stamps) - 1) * NANOSECONDS / span if span > 0 else 0.0
        return Evidence(description, self._joints, dict(self._refusals), self._quaternion, rates, incompatible)

    def _foot_decoder(self, foot: int) -> Callable[[bytes], int]:
        return lambda data: self._foot_codecs[foot].decode(data)[0]

    def _take_joints(self, data: bytes) -> int:
        stamp, self._joints, _, _ = self._joint_codec.decode(data)
        return stamp

    def _take_odom(self, data: bytes) -> int:
        stamp, pose, _ = self._odom_codec.decode(data)
        self._quaternion = pose[3:]
        return stamp
