"""Sensor topics as ``SensorData``, and state topics as ``RobotState`` for a controller in another process."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import UInt8MultiArray

from controllers.estimation.assembler import MAX_AGE, SampleAssembler
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS, stamp_of
from models.nodes.messages import ImuCodec, JointStateCodec, WrenchCodec
from models.nodes.odometry import OdometryCodec, contacts_from_message
from models.nodes.parameters import describe
from models.nodes.qos import sensor
from models.robot_model import SOLE_FRAMES
from models.types import ContactState, RobotState, SensorData, Vector


def declare_ages(node: PoiseNode) -> tuple[int, int]:
    """Declare the parameters of ``SampleAssembler``; returns ``max_age_ns`` and ``max_gap_ns`` [ns]."""
    age = describe("Oldest inertial or foot sample used with newer joints [s]", low=0.0, high=1.0)
    gap = describe("Largest step of a stamp accepted at once [s]", low=0.0, high=10.0)
    seconds = node.declare_parameter("max_age", MAX_AGE, age).value, node.declare_parameter("max_gap", 0.05, gap).value
    return round(NANOSECONDS * float(seconds[0])), round(NANOSECONDS * float(seconds[1]))


class SampleTopics:
    """Subscribes to joints, IMU and feet; refused samples are counted by the node.

    ``ages`` are from ``declare_ages``. ``take`` is called with every tick's data and its stamp [ns], and may raise
    ``PoiseError`` to refuse it; in lockstep ``again`` is called instead when the plant repeats the joints of this stamp
    [ns], because an answer was lost.
    """

    def __init__(
        self,
        node: PoiseNode,
        ages: tuple[int, int],
        take: Callable[[SensorData, int], None],
        again: Callable[[], None],
        *,
        lockstep: bool,
    ) -> None:
        self._node, self._take, self._again, self._lockstep = node, take, again, lockstep
        self.assembler = SampleAssembler(*ages, strict=lockstep, feet=node.model.profile.sensors.feet.fitted)
        self._taken: int | None = None
        self._joint_codec, self._imu_codec = JointStateCodec(node.model), ImuCodec(topics.IMU_FRAME)
        qos = sensor(reliable=lockstep)
        node.listen(Imu, topics.IMU_RAW, self._on_imu, qos, raw=True)
        for foot, topic in enumerate(topics.foot_wrenches(node.model)):
            node.listen(WrenchStamped, topic, self._foot_callback(foot), qos, raw=True)
        node.listen(JointState, topics.JOINT_STATES, self.on_joints, qos, raw=True)

    def reset(self) -> None:
        """Discard every sample."""
        self._taken = None
        self.assembler.reset()

    def _on_imu(self, data: bytes) -> None:
        self._add(topics.IMU_RAW, lambda: self.assembler.add_imu(*self._imu_codec.decode(data)))

    def on_joints(self, data: bytes) -> None:
        """Add serialised joint states."""
        self._add(topics.JOINT_STATES, lambda: self._add_joints(data))

    def _add_joints(self, data: bytes) -> SensorData | None:
        if self._lockstep and stamp_of(data) == self._taken:
            self._again()
            return None
        return self.assembler.add_joints(*self._joint_codec.decode(data))

    def _foot_callback(self, foot: int) -> Callable[[bytes], None]:
        codec, topic = WrenchCodec(SOLE_FRAMES[foot]), topics.FOOT_WRENCHES[foot]

        def on_foot(data: bytes) -> None:
            self._add(topic, lambda: self.assembler.add_foot(foot, *codec.decode(data)))

        return on_foot

    def _add(self, topic: str, add: Callable[[], SensorData | None]) -> None:
        """Add one sample; a complete tick is passed on."""
        if not self._node.active:
            return
        try:
            sensors = add()
            if sensors is not None:
                stamp = self.assembler.stamp or 0
                self._take(sensors, stamp)
                self._taken = stamp
        except PoiseError as error:
            self._node.refuse(topic, error)


class StateTopics:
    """Joins ``/odom`` with the joint states it was computed from, the contacts and the foot wrenches.

    Joints arrive before the odometry of the same stamp, because the estimator waits for them; contacts and wrenches are
    the newest. ``take`` is called with every state and its stamp [ns]; ``reliable`` is set in lockstep.
    """

    def __init__(self, node: PoiseNode, take: Callable[[RobotState, int], None], *, reliable: bool) -> None:
        self._node, self._take = node, take
        self._joint_codec, self._odom_codec = JointStateCodec(node.model), OdometryCodec()
        self._joints: tuple[int, Vector, Vector, Vector] | None = None
        self._odom: tuple[int, Vector, Vector] | None = None
        self._contacts = (True, True)
        self._wrenches = [np.zeros(6), np.zeros(6)]
        qos = sensor(reliable=reliable)
        for foot, topic in enumerate(topics.FOOT_WRENCHES):
            node.listen(WrenchStamped, topic, self._foot_callback(foot), qos, raw=True)
        node.listen(UInt8MultiArray, topics.CONTACTS, self._on_contacts, qos)
        node.listen(JointState, topics.JOINT_STATES, self._on_joints, qos, raw=True)
        node.listen(Odometry, topics.ODOM, self._on_odom, qos, raw=True)

    def _guarded(self, topic: str, work: Callable[[], None]) -> None:
        if not self._node.active:
            return
        try:
            work()
        except PoiseError as error:
            self._node.refuse(topic, error)

    def _on_joints(self, data: bytes) -> None:
        def work() -> None:
            self._joints = self._joint_codec.decode(data)
            self._join()

        self._guarded(topics.JOINT_STATES, work)

    def _on_odom(self, data: bytes) -> None:
        def work() -> None:
            self._odom = self._odom_codec.decode(data)
            self._join()

        self._guarded(topics.ODOM, work)

    def _on_contacts(self, message: UInt8MultiArray) -> None:
        def work() -> None:
            self._contacts = contacts_from_message(message)

        self._guarded(topics.CONTACTS, work)

    def _foot_callback(self, foot: int) -> Callable[[bytes], None]:
        codec = WrenchCodec(SOLE_FRAMES[foot])

        def on_foot(data: bytes) -> None:
            def work() -> None:
                self._wrenches[foot] = codec.decode(data)[1]

            self._guarded(topics.FOOT_WRENCHES[foot], work)

        return on_foot

    def _join(self) -> None:
        """Pass a state on when both halves have the same stamp."""
        if self._joints is None or self._odom is None or self._joints[0] != self._odom[0]:
            return
        stamp, q, v, tau = self._joints
        _, pose, twist = self._odom
        self._odom = None
        left, right = (ContactState(self._contacts[i], self._wrenches[i]) for i in range(2))
        state = RobotState(
            stamp / NANOSECONDS, np.concatenate([pose, q]), np.concatenate([twist, v]), tau, (left, right)
        )
        self._take(state, stamp)
