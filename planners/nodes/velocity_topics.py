"""Who commands the walk: ``cmd_vel`` as Twist, ``cmd_vel_stamped`` as TwistStamped, and the supervisor's words."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import Twist, TwistStamped
from std_msgs.msg import String

from models.errors import CommandError, MessageError, PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS
from models.nodes.messages import stamp_ns
from models.nodes.qos import COMMAND, EVENT, LATCHED
from models.nodes.velocity import require_base_frame, velocity_from_twist
from models.types import Mode
from planners.gait.command import VelocityCommand


class VelocityTopics:
    """Fills the velocity command from topics; the newest one counts, whoever sent it.

    Velocities of ``cmd_vel`` and ``cmd_vel_stamped`` are taken in mode ``walk`` only and must be repeated; those of the
    supervisor hold, and may come just before the mode that they belong to. Leaving ``walk`` forgets both.

    Args:
        node: Node that subscribes.
        command: What is filled.
        now: Stamp of the newest state [ns].
        timeout: Age from which on a stamped velocity is refused [s].
        stop: Called where the supervisor wants a standstill.
        left: Called when mode ``walk`` has been left.
    """

    def __init__(
        self,
        node: PoiseNode,
        command: VelocityCommand,
        now: Callable[[], int],
        timeout: float,
        stop: Callable[[], None],
        left: Callable[[], None],
    ) -> None:
        self._node, self._command, self._now = node, command, now
        self._stop, self._left = stop, left
        self._timeout = round(timeout * NANOSECONDS)
        self._last_stamp = 0
        self.mode = ""
        node.listen(Twist, topics.CMD_VEL, lambda message: self._repeat(topics.CMD_VEL, message, 0), COMMAND)
        node.listen(TwistStamped, topics.CMD_VEL_STAMPED, self._on_stamped, COMMAND)
        node.listen(Twist, topics.GAIT_VELOCITY, self._on_request, EVENT)
        node.listen(String, topics.MODE, self._on_mode, LATCHED)

    @property
    def walking(self) -> bool:
        """Whether the robot is in mode ``walk``."""
        return self.mode == Mode.WALK.value

    def _on_stamped(self, message: Any) -> None:
        self._repeat(topics.CMD_VEL_STAMPED, message.twist, stamp_ns(message.header.stamp), message.header.frame_id)

    def _repeat(self, topic: str, twist: Any, stamp: int, frame_id: str = "") -> None:
        if not self._node.active:
            return
        try:
            if not self.walking:
                raise CommandError(f"no walking in mode '{self.mode}': request mode/walk first")
            require_base_frame(frame_id)
            velocity = velocity_from_twist(twist)
            if stamp:
                self._judge_stamp(stamp)
            self._command.repeat(velocity, self._now() / NANOSECONDS)
        except PoiseError as error:
            self._node.refuse(topic, error)

    def _judge_stamp(self, stamp: int) -> None:
        """Refuse what is old, repeated, or of another clock than the graph's. A stamp of zero means now."""
        age = self._now() - stamp
        if age > self._timeout:
            raise MessageError(f"header.stamp: {age / NANOSECONDS:.3f} s old; a stamp is of /clock, or zero for now")
        if -age > self._timeout:
            raise MessageError(f"header.stamp: {-age / NANOSECONDS:.3f} s ahead; a stamp is of /clock, or zero for now")
        if stamp <= self._last_stamp:
            raise MessageError(f"header.stamp: {stamp} ns is not after {self._last_stamp} ns")
        self._last_stamp = stamp

    def _on_request(self, message: Any) -> None:
        try:
            velocity = velocity_from_twist(message)
            self._command.hold(velocity)
            if not any(velocity):
                self._stop()
        except MessageError as error:
            self._node.refuse(topics.GAIT_VELOCITY, error)

    def _on_mode(self, message: Any) -> None:
        if self.walking and message.data != self.mode:
            self._command.forget()
            self._left()
        self.mode = message.data
