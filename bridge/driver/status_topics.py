"""Topics of the driver beside the sensors: time, state and offsets of the drivers, description, and the truth."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from bridge.driver.drivers import Drivers
from bridge.plants.base import SimulatedPlant
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.messages import JointStateCodec, set_stamp
from models.nodes.odometry import OdometryCodec
from models.nodes.qos import LATCHED, SENSOR


class StatusTopics:
    """Publishers of ``/clock``, ``driver_state``, ``encoder_offsets`` and ``robot_description``."""

    def __init__(self, node: PoiseNode, drivers: Drivers) -> None:
        self._drivers, self._published = drivers, ""
        self._codec = JointStateCodec(node.model)
        self._zero = np.zeros(node.model.nj)
        self._time = node.announce(Clock, topics.CLOCK, SENSOR)
        self._state = node.announce(String, topics.DRIVER_STATE, LATCHED)
        self._offsets = node.announce(JointState, topics.ENCODER_OFFSETS, LATCHED)
        self._description = node.announce(String, topics.ROBOT_DESCRIPTION, LATCHED)

    def publish_latched(self, description: str, stamp: int) -> None:
        """Publish description, encoder offsets and state with a stamp [ns], once the node is active."""
        self._description.publish(String(data=description))
        self.publish_start(stamp)

    def publish_start(self, stamp: int) -> None:
        """Publish the encoder offsets, and the state even if it is unchanged: ``held`` twice is a reset; stamp [ns]."""
        offsets = self._drivers.encoder_offsets
        offsets = self._zero if offsets is None else offsets
        self._offsets.publish(self._codec.encode(stamp, offsets, self._zero, self._zero))
        self._published = ""
        self.publish_state()

    def publish_time(self, stamp: int) -> None:
        """Publish the time of the robot [ns]."""
        message = Clock()
        set_stamp(message.clock, stamp)
        self._time.publish(message)

    def publish_state(self) -> None:
        """Publish the state of the drivers, if it has changed."""
        if self._published != self._drivers.state:
            self._published = self._drivers.state
            self._state.publish(String(data=self._published))


class TruthTopics:
    """Publishers of ``ground_truth/odom``, and of ``joint_states`` and ``obstacle`` beside it while subscribed to."""

    def __init__(self, node: PoiseNode, plant: SimulatedPlant) -> None:
        self._plant = plant
        self._codec, self._joint_codec = OdometryCodec(), JointStateCodec(node.model)
        self._odometry = node.announce(Odometry, topics.GROUND_TRUTH, SENSOR)
        self._joints = node.announce(JointState, topics.GROUND_TRUTH_JOINTS, SENSOR)
        self._obstacle = node.announce(PoseStamped, topics.GROUND_TRUTH_OBSTACLE, SENSOR)

    def publish(self, stamp: int) -> None:
        """Publish the true state and the place of the obstacle with a stamp [ns]; the joints last."""
        truth = self._plant.truth
        self._odometry.publish(self._codec.encode(stamp, truth))
        centre = self._plant.obstacle_centre
        if centre is not None and self._obstacle.get_subscription_count():
            message = PoseStamped()
            set_stamp(message.header.stamp, stamp)
            message.header.frame_id = topics.ODOM_FRAME
            place = message.pose.position
            place.x, place.y, place.z = centre.tolist()
            self._obstacle.publish(message)
        if self._joints.get_subscription_count():
            self._joints.publish(self._joint_codec.encode(stamp, truth.q[7:], truth.v[6:], truth.tau))
