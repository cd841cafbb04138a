"""Commands of the supervisor to the gait: a velocity, repeated while the robot walks, and a standstill."""

from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import Twist
from std_msgs.msg import Empty, String

from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS
from models.nodes.odometry import velocity_from_twist
from models.nodes.qos import COMMAND, EVENT, LATCHED
from models.types import Mode
from planners.gait.commands import VelocityCommand


class VelocityTopics:
    """Fills the velocity ``command``. The supervisor arbitrates its sources (``controllers/commands/arbitration.py``).

    A velocity may come just before its mode; leaving mode ``walk`` discards it. ``now`` returns the stamp of the newest
    state [ns], ``stop`` is called for a standstill and ``left`` after mode ``walk``; ``mode`` is empty before the first
    message.
    """

    def __init__(
        self,
        node: PoiseNode,
        command: VelocityCommand,
        now: Callable[[], int],
        stop: Callable[[], None],
        left: Callable[[], None],
    ) -> None:
        self._command, self._now = command, now
        self._stop, self._left = stop, left
        self.mode = ""
        node.listen(Twist, topics.GAIT_VELOCITY, self._on_velocity, COMMAND, while_active=True)
        node.listen(Empty, topics.GAIT_STOP, lambda message: self._stop(), EVENT)
        node.listen(String, topics.MODE, self._on_mode, LATCHED)

    @property
    def walking(self) -> bool:
        """Whether the robot is in mode ``walk``."""
        return self.mode == Mode.WALK.value

    def _on_velocity(self, message: Any) -> None:
        self._command.repeat(velocity_from_twist(message), self._now() / NANOSECONDS)

    def _on_mode(self, message: Any) -> None:
        if self.walking and message.data != self.mode:
            self._command.forget()
            self._left()
        self.mode = message.data
