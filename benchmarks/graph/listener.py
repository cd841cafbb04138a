"""Process that subscribes to every topic of the tick and discards the messages: cost of one more subscriber.

With the argument ``slow`` it subscribes with the usual depth of 10 and sleeps in its callbacks.
"""

import sys
import time
from functools import partial
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
    (JointTrajectory, topics.JOINT_SETPOINTS, COMMAND),
)

DEPTH, SLEEP = 10, 0.1  #: Slow subscriber: queue depth, and time in each callback [s]


class Listener(PoiseNode):
    """Receives every message: serialised, or slowly with default QoS."""

    AUTOSTART = True

    def __init__(self, *, slow: bool = False, **kwargs: Any) -> None:
        super().__init__("listener", **kwargs)
        self._slow = slow

    def configure(self) -> None:
        for kind, topic, qos in TICK_TOPICS:
            if self._slow:
                self.listen(kind, topic, lambda message: time.sleep(SLEEP), DEPTH)
            else:
                self.listen(kind, topic, lambda data: None, qos, raw=True)


if __name__ == "__main__":
    sys.exit(run([partial(Listener, slow="slow" in sys.argv)]))
