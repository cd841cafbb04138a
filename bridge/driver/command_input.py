"""Subscriptions of the driver: joint commands, each checked by its stamp, and the mode."""

from __future__ import annotations

from collections.abc import Callable

from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from bridge.driver.drivers import Drivers
from bridge.driver.latency_probe import LatencyProbe
from controllers.joints.motor_driver import check_stamp
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.messages import JointCommandCodec, mode_named
from models.nodes.qos import COMMAND, LATCHED


class CommandInput:
    """Accepts commands computed from recent sensors; refuses the rest by name.

    A command is refused when its sensors are older than ``max_age`` [ns]; ``period`` is the tick [ns]. ``probe``
    records arrivals, optional; ``on_mode_change`` is called when a mode may have changed the state of the drivers.
    ``now`` is the stamp of the present tick [ns], set by the node, ``stamp`` that of the command in force [ns].
    """

    def __init__(
        self,
        node: PoiseNode,
        drivers: Drivers,
        period: int,
        max_age: int,
        probe: LatencyProbe | None,
        on_mode_change: Callable[[], None],
    ) -> None:
        self._node, self._drivers, self._probe, self._on_mode_change = node, drivers, probe, on_mode_change
        self._period, self._max_age = period, max_age
        self._codec = JointCommandCodec(node.model)
        self.now = period
        self.stamp = 0  # a zero stamp means "now" in a command
        node.listen(JointTrajectory, topics.JOINT_COMMAND, self.on_command, COMMAND, raw=True)
        node.listen(String, topics.MODE, self.on_mode, LATCHED)

    def on_command(self, data: bytes) -> None:
        """Pass a command to the drivers, or refuse it."""
        if not self._node.active:
            return
        if self._probe is not None:
            self._probe.arrive()
        try:
            stamp, command = self._codec.decode(data)
            check_stamp(stamp, self.stamp, self.now, self._max_age, self._node.counters)
            if self._drivers.command(command):
                self.stamp = stamp or self.stamp
                if stamp and self._probe is not None:
                    self._probe.receive(stamp // self._period)
        except PoiseError as error:
            self._node.refuse(topics.JOINT_COMMAND, error)

    def on_mode(self, message: String) -> None:
        """Apply the supervisor's mode."""
        if not self._node.active:
            return
        try:
            self._drivers.set_mode(mode_named(message.data))
        except PoiseError as error:
            self._node.refuse(topics.MODE, error)
        self._on_mode_change()
