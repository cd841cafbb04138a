"""The velocity that is commanded: held until further notice, or repeated by somebody who may fall silent."""

from __future__ import annotations

from planners.gait.footsteps import Velocity

STILL: Velocity = (0.0, 0.0, 0.0)


class VelocityCommand:
    """Newest command of two kinds: one that holds, and one that must be repeated.

    Args:
        timeout: Silence after which a repeated command counts as zero [s].
    """

    def __init__(self, timeout: float) -> None:
        self._timeout = timeout
        self.forget()

    def forget(self) -> None:
        """Stand still."""
        self._velocity, self._until = STILL, float("inf")

    def hold(self, velocity: Velocity) -> None:
        """Take a command that holds until another one comes."""
        self._velocity, self._until = velocity, float("inf")

    def repeat(self, velocity: Velocity, t: float) -> None:
        """Take a command that must be repeated within ``timeout``.

        Args:
            velocity: Forward [m/s], left [m/s], turn [rad/s].
            t: Stamp of now [s].
        """
        self._velocity, self._until = velocity, t + self._timeout

    def at(self, t: float) -> Velocity:
        """What is commanded at a stamp [s]; zero once a repeated command has fallen silent."""
        if t > self._until:
            self.forget()
        return self._velocity
