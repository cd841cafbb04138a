"""The velocity that is commanded, by somebody who repeats it and may fall silent."""

from __future__ import annotations

from planners.gait.footsteps import Velocity

STILL: Velocity = (0.0, 0.0, 0.0)


class VelocityCommand:
    """Newest command, which must be repeated.

    Args:
        timeout: Silence after which it counts as zero [s].

    Attributes:
        velocity: What is commanded: forward [m/s], left [m/s], turn [rad/s].
    """

    def __init__(self, timeout: float) -> None:
        self._timeout = timeout
        self.forget()

    def forget(self) -> None:
        """Stand still, and expect nobody."""
        self.velocity, self._until = STILL, float("inf")
        self._superseded: Velocity | None = None

    def supersede(self) -> None:
        """Something else moves the robot now: this velocity, repeated on, counts for nothing until it has changed."""
        self._superseded, self.velocity = self.velocity, STILL

    def repeat(self, velocity: Velocity, t: float) -> None:
        """Take a command that must be repeated within ``timeout``.

        Args:
            velocity: Forward [m/s], left [m/s], turn [rad/s].
            t: Stamp of now [s].
        """
        if velocity != self._superseded:
            self._superseded, self.velocity = None, velocity
        self._until = t + self._timeout

    def lapsed(self, t: float) -> bool:
        """Whether the command has just fallen silent, told once [stamp in s]; it is zero from then on."""
        if t <= self._until:
            return False
        self.forget()
        return True
