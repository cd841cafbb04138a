"""``RobotState`` from topics: for a controller whose estimator lives in another process."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState
from std_msgs.msg import UInt8MultiArray

from models.errors import PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS
from models.nodes.messages import JointStateCodec, WrenchCodec
from models.nodes.odometry import OdometryCodec, contacts_from_message
from models.nodes.qos import sensor
from models.robot_model import SOLE_FRAMES
from models.types import ContactState, RobotState, Vector


class StateTopics:
    """Joins ``/odom`` with the joint states it was computed from, the contacts and the foot wrenches.

    The joints arrive before the odometry of the same stamp, because the estimator waits for them; contacts and
    wrenches are the newest.

    Args:
        node: Node that subscribes.
        take: Called with every state and its stamp [ns].
        reliable: Whether the sensors are reliable (lockstep).
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
        """Hand a state over when both halves carry the same stamp."""
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
