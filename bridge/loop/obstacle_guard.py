"""Scanner and obstacle stop of the closed loop, between the commanded velocity and the gait."""

from collections.abc import Callable

from bridge.loop.lockstep import Lockstep
from bridge.plants.scanner import LaserScanner
from controllers.commands.obstacle_stop import ObstacleStop
from models.types import STILL, Mode

LIMIT_PERIOD = 0.02  #: Update period of the velocity, as in the graph [s]


class ObstacleGuard:
    """Limits velocity commands to the gait by the obstacle stop; ``reason`` is the cause of the limit."""

    def __init__(self, lockstep: Lockstep, seed: int, noise: float, note: Callable[[str], None]) -> None:
        self._lockstep, self._note = lockstep, note
        self.law = ObstacleStop(lockstep.plant.robot)
        self.scanner = LaserScanner(lockstep.plant, seed, noise)
        self.reset()

    def reset(self, seed: int | None = None) -> None:
        """Discard command and scans; ``seed``, if given, replaces the current seed."""
        self.law.reset()
        self.scanner.reset(seed)
        self.reason = ""
        self._wanted = self._given = STILL
        self._t = self._next_scan = self._next_limit = 0.0

    def set_velocity(self, forward: float, left: float, turn: float) -> None:
        """Command a velocity [m/s, m/s, rad/s]; see ``GaitPlanner.set_velocity`` for refusals."""
        self._lockstep.stack.set_velocity(forward, left, turn)
        self._wanted = self._given = (forward, left, turn)
        self._look()
        self._limit()

    def stop(self) -> None:
        """Stop the walk."""
        self._wanted = self._given = STILL
        self._lockstep.stack.stop()

    def step(self) -> None:
        """Update after each tick."""
        self._look()
        if self._t >= self._next_limit:
            self._next_limit = self._t + LIMIT_PERIOD
            self._limit()

    def _look(self) -> None:
        self._t = self._lockstep.plant.t
        if self._t >= self._next_scan:
            self._next_scan = self._t + 1.0 / self.scanner.config.rate
            scan = self._lockstep.plant.transmit_scan(self.scanner.scan(self._t))
            if scan is not None:
                self.law.update(scan)

    def _limit(self) -> None:
        """Send the allowed velocity to the gait when it changes; outside mode 'walk' the command is discarded."""
        if self._lockstep.stack.mode is not Mode.WALK:
            self._wanted = self._given = STILL
        allowed, reason = self.law.limit(self._wanted, self._t)
        if allowed != self._given:
            self._given = allowed
            self._lockstep.stack.set_velocity(*allowed)
        if reason != self.reason:
            self.reason = reason
            self._note(f"obstacle stop: {reason or 'free'}")
