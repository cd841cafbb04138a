"""What the simulated robot publishes beside its sensors: time, truth, the state of its drivers, its description."""

from __future__ import annotations

from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

from bridge.ros.driven_robot import DrivenRobot
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.messages import set_stamp
from models.nodes.odometry import OdometryCodec
from models.nodes.qos import LATCHED, SENSOR


class SlowTopics:
    """Publishers of ``/clock``, ``ground_truth/odom``, ``driver_state`` and ``robot_description``.

    Args:
        node: Node that publishes.
        driven: Robot to report on.
    """

    def __init__(self, node: PoiseNode, driven: DrivenRobot) -> None:
        self._driven, self._said = driven, ""
        self._codec = OdometryCodec()
        self._time = node.announce(Clock, topics.CLOCK, SENSOR)
        self._truth = node.announce(Odometry, topics.GROUND_TRUTH, SENSOR)
        self._state = node.announce(String, topics.DRIVER_STATE, LATCHED)
        self._description = node.announce(String, topics.ROBOT_DESCRIPTION, LATCHED)

    def publish_latched(self, description: str) -> None:
        """Publish the description and the state; to be called once the node is active."""
        self._said = ""
        self._description.publish(String(data=description))
        self.publish_state()

    def publish_time(self, stamp: int) -> None:
        """Publish the simulated time [ns]."""
        message = Clock()
        set_stamp(message.clock, stamp)
        self._time.publish(message)

    def publish_truth(self, stamp: int) -> None:
        """Publish the exact base pose and twist; for scoring and display only."""
        self._truth.publish(self._codec.encode(stamp, self._driven.plant.truth))

    def publish_state(self) -> None:
        """Publish the state of the drivers, if it has changed."""
        if self._said != self._driven.state:
            self._said = self._driven.state
            self._state.publish(String(data=self._said))
