"""Topic ``perception/time``: up to which time the perception nodes have done their work. Simulated time waits."""

from std_msgs.msg import Header

from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.messages import set_stamp, stamp_ns
from models.nodes.qos import EVENT_QUEUE, STATE

IDLE = 0  #: Stamp of a node without work, for which time does not wait [ns]
PERIOD = 8_000_000  #: Least time between two reports of a node at work [ns]


def progress_message(name: str, stamp: int) -> Header:
    """std_msgs/Header: name of a node, and the time up to which it has done its work, or ``IDLE`` [ns]."""
    message = Header(frame_id=name)
    set_stamp(message.stamp, stamp)
    return message


class Progress:
    """Reports up to which time a node has done its work, until ``cleanup`` of ``node``.

    ``worker`` is the name of the node that does the work, by default ``node``.
    """

    def __init__(self, node: PoiseNode, worker: str = "") -> None:
        self._name = worker or node.get_name()
        self._publisher = node.announce(Header, topics.PERCEPTION_TIME, STATE)
        self._reported = IDLE

    def report(self, stamp: int) -> None:
        """Report a stamp [ns]; one less than ``PERIOD`` after the last reported one is skipped.

        A repeated stamp is reported again: while time waits, the driver repeats the states.
        """
        if not 0 < stamp - self._reported < PERIOD:
            self._reported = stamp
            self._publisher.publish(progress_message(self._name, stamp))

    def report_idle(self) -> None:
        """Report that the node has no work."""
        self.report(IDLE)


class ProgressOfNodes:
    """Receives the reports of all perception nodes, until ``cleanup`` of the node.

    Attributes:
        reached: Time up to which each node at work has done its work [ns], by name.
    """

    def __init__(self, node: PoiseNode) -> None:
        self.reached: dict[str, int] = {}
        node.listen(Header, topics.PERCEPTION_TIME, self._on_report, EVENT_QUEUE)

    def forget(self, name: str) -> None:
        """Ignore a node until its next report."""
        self.reached.pop(name, None)

    def _on_report(self, message: Header) -> None:
        if (stamp := stamp_ns(message.stamp)) == IDLE:
            self.forget(message.frame_id)
        else:
            self.reached[message.frame_id] = stamp
