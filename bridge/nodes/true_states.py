"""True states of a simulated robot, for nodes that simulate a camera or a lidar."""

from collections.abc import Callable
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState

from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import numbers_of, stamp_of
from models.nodes.messages import JointStateCodec
from models.nodes.odometry import OdometryCodec
from models.nodes.qos import SENSOR
from models.types import Vector


class TrueStates:
    """Subscribes to the true states of the driver, until ``cleanup`` of the node.

    While the node is active, ``due`` receives the stamp [ns] of each state whose base and joints have arrived. If it is
    due, ``on_state`` receives the stamp and the configuration (nq,). ``on_obstacle`` receives the middle of the
    terrain's box (3,) [m]. The optional ``on_stamp`` receives the stamp of each such state, due or not.
    """

    def __init__(
        self,
        node: PoiseNode,
        due: Callable[[int], bool],
        on_state: Callable[[int, Vector], None],
        on_obstacle: Callable[[Vector], None],
        on_stamp: Callable[[int], None] | None = None,
    ) -> None:
        self._due, self._on_state, self._on_centre = due, on_state, on_obstacle
        self._on_stamp = on_stamp
        self._odometry, self._joints = b"", b""
        self._odometry_codec, self._joints_codec = OdometryCodec(), JointStateCodec(node.model)
        node.listen(Odometry, topics.GROUND_TRUTH, self._on_odometry, SENSOR, raw=True, while_active=True)
        node.listen(PoseStamped, topics.GROUND_TRUTH_OBSTACLE, self._on_obstacle, SENSOR)
        node.listen(JointState, topics.GROUND_TRUTH_JOINTS, self._on_joints, SENSOR, raw=True, while_active=True)

    def _on_odometry(self, data: bytes) -> None:
        self._odometry = data
        self._offer()

    def _on_obstacle(self, message: Any) -> None:
        self._on_centre(numbers_of(message.pose.position))

    def _on_joints(self, data: bytes) -> None:
        self._joints = data
        self._offer()

    def _offer(self) -> None:
        """Offer a state once base and joints of the same tick have arrived, in either order."""
        if not self._odometry or not self._joints or stamp_of(self._odometry) != stamp_of(self._joints):
            return
        stamp = stamp_of(self._joints)
        if self._on_stamp is not None:
            self._on_stamp(stamp)
        if not self._due(stamp):
            return
        joints = self._joints_codec.decode(self._joints)[1]
        pose: Vector = self._odometry_codec.decode(self._odometry)[1]
        self._on_state(stamp, np.concatenate([pose, joints]))
