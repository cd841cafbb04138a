"""A process that listens to every topic of the tick and does nothing with it: what one more subscriber costs."""

import sys
from typing import Any

from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import Imu, JointState
from trajectory_msgs.msg import JointTrajectory

from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.qos import COMMAND, SENSOR
from models.nodes.spin import run

#: Sensors and command: type, topic, quality of service
TICK_TOPICS: tuple[tuple[type, str, Any], ...] = (
    (Imu, topics.IMU_RAW, SENSOR),
    *((WrenchStamped, topic, SENSOR) for topic in topics.FOOT_WRENCHES),
    (JointState, topics.JOINT_STATES, SENSOR),
    (JointTrajectory, topics.JOINT_COMMAND, COMMAND),
)


class Listener(PoiseNode):
    """Takes every message, serialised."""

    AUTOSTART = True

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("listener", **kwargs)

    def configure(self) -> None:
        """Subscribe."""
        for kind, topic, qos in TICK_TOPICS:
            self.listen(kind, topic, lambda data: None, qos, raw=True)


if __name__ == "__main__":
    sys.exit(run([Listener]))
