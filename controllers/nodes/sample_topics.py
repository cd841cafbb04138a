"""Sensor topics as ``SensorData``, and state topics as ``RobotState`` for a controller in another process."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64, UInt8MultiArray

from controllers.estimation.assembler import MAX_AGE, SampleAssembler
from models.errors import MessageError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS, stamp_of
from models.nodes.messages import ImuCodec, JointStateCodec, WrenchCodec
from models.nodes.odometry import OdometryCodec, contacts_from_message
from models.nodes.parameters import declare_ns
from models.nodes.qos import LATCHED, sensor
from models.robot_model import SOLE_FRAMES
from models.types import ContactState, RobotState, SensorData, Vector

KEPT = 100  #: Number of ticks whose joint samples are stored until the odometry arrives


def declare_ages(node: PoiseNode) -> tuple[int, int]:
    """Declare the parameters of ``SampleAssembler``; returns ``age_max_ns`` and ``gap_max_ns`` [ns]."""
    text = "Oldest inertial or foot sample used with newer joints [s]"
    age = declare_ns(node, "age_max", MAX_AGE, text, low=0.0, high=1.0)
    return age, declare_ns(node, "gap_max", 0.05, "Largest step of a stamp accepted at once [s]", low=0.0, high=10.0)


class SampleTopics:
    """Subscribes to joints, IMU and feet; the node counts refused samples.

    ``ages`` are from ``declare_ages``. ``take`` is called with the data and the stamp [ns] of every tick, and may raise
    ``PoiseError`` to refuse it. If the plant ``waits`` for commands and repeats the joints of the last tick because its
    command was lost, ``again`` is called instead.
    """

    def __init__(
        self,
        node: PoiseNode,
        ages: tuple[int, int],
        take: Callable[[SensorData, int], None],
        again: Callable[[], None],
        *,
        lockstep: bool,
        waits: bool,
    ) -> None:
        self._take, self._again, self._waits = take, again, waits
        fitted = node.model.profile.sensors.feet.fitted
        self.assembler = SampleAssembler(*ages, strict=lockstep, repeats=waits, feet=fitted)
        self._taken: int | None = None
        self._joint_codec, self._imu_codec = JointStateCodec(node.model), ImuCodec(topics.IMU_FRAME)
        listen = partial(node.listen, qos=sensor(lockstep=lockstep, waits=waits), raw=True, while_active=True)
        listen(Imu, topics.IMU_RAW, self._on_imu)
        for foot, topic in enumerate(topics.foot_wrenches(node.model)):
            listen(WrenchStamped, topic, partial(self._on_foot, foot, WrenchCodec(SOLE_FRAMES[foot])))
        listen(JointState, topics.JOINT_STATES, self._on_joints)

    def reset(self) -> None:
        """Discard every sample."""
        self._taken = None
        self.assembler.reset()

    def _on_imu(self, data: bytes) -> None:
        self._pass_on(self.assembler.add_imu(*self._imu_codec.decode(data)))

    def _on_foot(self, foot: int, codec: WrenchCodec, data: bytes) -> None:
        self._pass_on(self.assembler.add_foot(foot, *codec.decode(data)))

    def _on_joints(self, data: bytes) -> None:
        if self._waits and stamp_of(data) == self._taken:
            self._again()
        else:
            self._pass_on(self.assembler.add_joints(*self._joint_codec.decode(data)))

    def _pass_on(self, sensors: SensorData | None) -> None:
        if sensors is not None:
            stamp = self.assembler.stamp or 0
            self._take(sensors, stamp)
            self._taken = stamp


class StateTopics:
    """Combines ``/odom`` with its joint states, and with contacts, wrenches and friction of the estimator.

    Samples arrive before the odometry of the same stamp, because the estimator waits for them. The wrenches are those
    used by the estimator, because sensors may be faulty or absent. ``take`` is called with every state and its stamp
    [ns]; ``qos`` applies to the subscribers.
    """

    def __init__(self, node: PoiseNode, take: Callable[[RobotState, int], None], qos: Any) -> None:
        self._take = take
        self._joint_codec, self._odom_codec = JointStateCodec(node.model), OdometryCodec()
        self._samples: dict[int, list[Vector]] = {}  # joints of the newest ticks, by stamp [ns]
        self._contacts, self._friction = (True, True), math.inf
        self._wrenches = [np.zeros(6), np.zeros(6)]
        listen = partial(node.listen, qos=qos, while_active=True)
        for foot, topic in enumerate(topics.CONTACT_WRENCHES):
            listen(WrenchStamped, topic, partial(self._on_foot, foot, WrenchCodec(SOLE_FRAMES[foot])), raw=True)
        listen(UInt8MultiArray, topics.CONTACTS, self._on_contacts)
        node.listen(Float64, topics.GROUND_FRICTION, self._on_friction, LATCHED)
        listen(JointState, topics.JOINT_STATES, self._on_joints, raw=True)
        listen(Odometry, topics.ODOM, self._on_odom, raw=True)

    def _on_foot(self, foot: int, codec: WrenchCodec, data: bytes) -> None:
        self._wrenches[foot] = codec.decode(data)[1]

    def _on_contacts(self, message: UInt8MultiArray) -> None:
        self._contacts = contacts_from_message(message)

    def _on_friction(self, message: Float64) -> None:
        if not message.data > 0.0:
            raise MessageError(f"data: a coefficient of friction of {message.data} is not positive")
        self._friction = message.data

    def _on_joints(self, data: bytes) -> None:
        stamp, *joints = self._joint_codec.decode(data)
        self._samples[stamp] = joints
        if len(self._samples) > KEPT:
            del self._samples[next(iter(self._samples))]

    def _on_odom(self, data: bytes) -> None:
        stamp, pose, twist = self._odom_codec.decode(data)
        if stamp not in self._samples:
            return
        q, v, tau = self._samples[stamp]
        left, right = (ContactState(*foot) for foot in zip(self._contacts, self._wrenches, strict=True))
        state = RobotState(
            stamp / NANOSECONDS,
            np.concatenate([pose, q]),
            np.concatenate([twist, v]),
            tau,
            (left, right),
            self._friction,
        )
        self._take(state, stamp)
