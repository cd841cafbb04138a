"""Topic ``perception/time``: how far the nodes of the perception are; simulated time waits for them."""

from typing import Any

from std_msgs.msg import Header

from models.nodes import topics
from models.nodes.messages import set_stamp, stamp_ns
from models.nodes.qos import SENSOR_QUEUE, STATE

IDLE = 0  #: Stamp of a node without work, for which time does not wait [ns]
PERIOD = 8_000_000  #: Least time between two reports of a node that is at work [ns]


def progress_message(name: str, stamp: int) -> Header:
    """std_msgs/Header: name of a node, and the time up to which it has done its work, or ``IDLE`` [ns]."""
    message = Header(frame_id=name)
    set_stamp(message.stamp, stamp)
    return message


class Progress:
    """Reports up to which time a node has done its work, until ``cleanup`` of the node."""

    def __init__(self, node: Any) -> None:
        self._name = node.get_name()
        self._publisher = node.announce(Header, topics.PERCEPTION_TIME, STATE)
        self._reported = IDLE

    def reach(self, stamp: int) -> None:
        """Report a stamp [ns]; one less than ``PERIOD`` after the last report is left out."""
        if stamp == IDLE or not 0 <= stamp - self._reported < PERIOD:
            self._reported = stamp
            self._publisher.publish(progress_message(self._name, stamp))


class ProgressOfNodes:
    """Receives these reports, until ``cleanup`` of the node.

    Attributes:
        reached: Time up to which each node at work has done its work [ns], by name.
    """

    def __init__(self, node: Any) -> None:
        self.reached: dict[str, int] = {}
        node.listen(Header, topics.PERCEPTION_TIME, self._on_time, SENSOR_QUEUE)

    def _on_time(self, message: Any) -> None:
        stamp = stamp_ns(message.stamp)
        if stamp == IDLE:
            self.reached.pop(message.frame_id, None)
        else:
            self.reached[message.frame_id] = stamp
