"""What the drivers are told: joint commands, each judged by its stamp, and the mode."""

from __future__ import annotations

from collections.abc import Callable

from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from bridge.ros.driven_robot import DrivenRobot
from bridge.ros.latency_probe import LatencyProbe
from controllers.driver_orders import check_stamp
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.messages import JointCommandCodec
from models.nodes.modes import mode_named
from models.nodes.qos import COMMAND, LATCHED


class CommandInput:
    """Takes commands that answer recent sensors; refuses the rest by name.

    Args:
        node: Node that listens.
        driven: Robot to command.
        period: Length of a tick [ns].
        max_age: Age of the sensors a command answers above which it is refused [ns].
        probe: Notes when a command arrives; None for nobody.
        tell: Called when a mode may have changed the state of the drivers.

    Attributes:
        now: Stamp of the present tick [ns]; kept up to date by the node.
        stamp: Of the newest command in force [ns].
    """

    def __init__(
        self,
        node: PoiseNode,
        driven: DrivenRobot,
        period: int,
        max_age: int,
        probe: LatencyProbe | None,
        tell: Callable[[], None],
    ) -> None:
        self._node, self._driven, self._probe, self._tell = node, driven, probe, tell
        self._period, self._max_age = period, max_age
        self._codec = JointCommandCodec(node.model)
        self.now = period
        self.stamp = 0  # a zero stamp means "now" in a command
        node.listen(JointTrajectory, topics.JOINT_COMMAND, self.on_command, COMMAND, raw=True)
        node.listen(String, topics.MODE, self.on_mode, LATCHED)

    def on_command(self, data: bytes) -> None:
        """Have the drivers follow a command, or refuse it."""
        if not self._node.active:
            return
        if self._probe is not None:
            self._probe.arrive()
        try:
            stamp, command = self._codec.decode(data)
            check_stamp(stamp, self.stamp, self.now, self._max_age, self._node.counters)
            if self._driven.command(command):
                self.stamp = stamp or self.stamp
                if stamp and self._probe is not None:
                    self._probe.receive(stamp // self._period)
        except PoiseError as error:
            self._node.refuse(topics.JOINT_COMMAND, error)

    def on_mode(self, message: String) -> None:
        """Have the drivers follow the supervisor's mode."""
        if not self._node.active:
            return
        try:
            self._driven.set_mode(mode_named(message.data))
        except PoiseError as error:
            self._node.refuse(topics.MODE, error)
        self._tell()
