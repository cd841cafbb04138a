"""What the simulated robot publishes beside its sensors: time, truth, state and offsets of its drivers, description."""

from __future__ import annotations

import numpy as np
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from bridge.ros.driven_robot import DrivenRobot
from bridge.ros.truth_topics import TruthTopics
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.messages import JointStateCodec, set_stamp
from models.nodes.odometry import OdometryCodec
from models.nodes.qos import LATCHED, SENSOR


class SlowTopics:
    """Publishers of ``/clock``, ``ground_truth/odom``, ``driver_state``, ``encoder_offsets``, ``robot_description``.

    Args:
        node: Node that publishes.
        driven: Robot to report on.
    """

    def __init__(self, node: PoiseNode, driven: DrivenRobot) -> None:
        self._driven, self._said = driven, ""
        self._codec, self._joint_codec = OdometryCodec(), JointStateCodec(node.model)
        self._zero = np.zeros(node.model.nj)
        self._time = node.announce(Clock, topics.CLOCK, SENSOR)
        self._truth = node.announce(Odometry, topics.GROUND_TRUTH, SENSOR)
        self._more_truth = TruthTopics(node, driven.plant, self._joint_codec)
        self._state = node.announce(String, topics.DRIVER_STATE, LATCHED)
        self._offsets = node.announce(JointState, topics.ENCODER_OFFSETS, LATCHED)
        self._description = node.announce(String, topics.ROBOT_DESCRIPTION, LATCHED)

    def publish_latched(self, description: str, stamp: int) -> None:
        """Publish description, encoder offsets and state; to be called once the node is active, at a stamp [ns]."""
        self._description.publish(String(data=description))
        self.publish_start(stamp)

    def publish_start(self, stamp: int) -> None:
        """Publish what the drivers begin with at a stamp [ns]: the offsets that they subtract, and their state.

        The state is told even if it is the same: held twice is a robot that has been put back while it was held.
        """
        offsets = self._driven.encoder_offsets
        offsets = self._zero if offsets is None else offsets
        self._offsets.publish(self._joint_codec.encode(stamp, offsets, self._zero, self._zero))
        self._said = ""
        self.publish_state()

    def publish_time(self, stamp: int) -> None:
        """Publish the simulated time [ns]."""
        message = Clock()
        set_stamp(message.clock, stamp)
        self._time.publish(message)

    def publish_truth(self, stamp: int) -> None:
        """Publish the exact base pose and twist, and what is listened to of the rest; for scoring and display only."""
        truth = self._driven.plant.truth
        self._truth.publish(self._codec.encode(stamp, truth))
        self._more_truth.publish(stamp, truth)

    def publish_state(self) -> None:
        """Publish the state of the drivers, if it has changed."""
        if self._said != self._driven.state:
            self._said = self._driven.state
            self._state.publish(String(data=self._said))
