"""Commanded velocity within limits of size and acceleration."""

from __future__ import annotations

from planners.gait.config import VelocityConfig


class VelocityLimiter:
    """Brings a commanded velocity into the limits and changes it no faster than they allow.

    Args:
        config: Limits.

    Attributes:
        wanted: Forward [m/s], left [m/s], turn [rad/s], within the limits of size.
        velocity: The same, within those of acceleration too.
    """

    def __init__(self, config: VelocityConfig) -> None:
        self._config = config
        self.wanted = (0.0, 0.0, 0.0)
        self.velocity = (0.0, 0.0, 0.0)

    @property
    def moving(self) -> bool:
        """Whether any velocity is wanted."""
        return any(abs(value) > 1e-3 for value in self.wanted)

    def reset(self) -> None:
        """Forget the command and stand still."""
        self.wanted = self.velocity = (0.0, 0.0, 0.0)

    def set(self, forward: float, left: float, turn: float) -> None:
        """Take a command [m/s, m/s, rad/s]."""
        config = self._config
        self.wanted = (
            min(max(forward, -config.backward), config.forward),
            min(max(left, -config.lateral), config.lateral),
            min(max(turn, -config.turn), config.turn),
        )

    def step(self, dt: float) -> None:
        """Advance by a time [s]."""
        if self.velocity == self.wanted:
            return
        config = self._config
        rates = (config.acceleration, config.acceleration, config.turn_acceleration)
        self.velocity = tuple(
            now + min(max(goal - now, -rate * dt), rate * dt)
            for now, goal, rate in zip(self.velocity, self.wanted, rates, strict=True)
        )  # type: ignore[assignment]
