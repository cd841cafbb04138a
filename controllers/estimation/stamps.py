"""Checks of stamps (repeated, backward and single jumps ahead), and division of stamps into periods."""

import math

from models.errors import MessageError


class JumpFilter:
    """Refuses a stamp that jumps ahead by more than ``step_max`` unless the next one continues from it (a gap)."""

    def __init__(self, step_max: float) -> None:
        self._step_max = step_max
        self._pending: float | None = None

    def accepts(self, last: float, stamp: float) -> bool:
        """Whether a stamp follows the last accepted one; ``stamp`` must not be before ``last``."""
        pending, self._pending = self._pending, None
        if stamp - last <= self._step_max or (pending is not None and 0.0 < stamp - pending <= self._step_max):
            return True
        self._pending = stamp
        return False


class StampFilter:
    """Accepts stamps of one source in ascending order, without single jumps by more than ``step_max`` [ns]."""

    def __init__(self, step_max: float = math.inf, name: str = "header.stamp") -> None:
        self._jumps, self._name = JumpFilter(step_max), name
        self.last: int | None = None

    def step(self, stamp: int) -> int:
        """Accept a stamp; returns the time since the last one [ns], 0 for the first. ``MessageError`` if refused."""
        last = stamp if self.last is None else self.last
        if self.last is not None:
            if stamp <= last:
                kind = "repeats" if stamp == last else "is before"
                raise MessageError(f"{self._name}: {1e-9 * stamp:.6f} s {kind} {1e-9 * last:.6f} s")
            if not self._jumps.accepts(last, stamp):
                raise MessageError(f"{self._name}: {1e-9 * stamp:.3f} s jumps ahead of {1e-9 * last:.3f} s")
        self.last = stamp
        return stamp - last


class ClockFilter:
    """Refuses implausible times of the plant's clock: a single jump ahead, and any step back while the robot moves.

    Ages and timeouts of commands are measured on this clock. After a momentary jump ahead, the velocity of a source
    that then falls silent would hold for as long. A jump is accepted if the next time continues from it: then messages
    were lost. A clock that has gone back is refused until the robot is at rest; until then its users receive no time,
    and the robot damps. ``step_max`` is the largest step ahead that is accepted at once [ns].
    """

    def __init__(self, step_max: int) -> None:
        self._jumps = JumpFilter(step_max)
        self._last: int | None = None

    def check(self, stamp: int, *, moving: bool) -> None:
        """Accept a time [ns] or raise ``MessageError``; a robot at rest accepts any (its plant may be new)."""
        if moving and self._last is not None:
            if stamp < self._last:
                raise MessageError(f"clock: {1e-9 * stamp:.3f} s is before {1e-9 * self._last:.3f} s")
            if not self._jumps.accepts(self._last, stamp):
                raise MessageError(f"clock: {1e-9 * stamp:.3f} s jumps ahead of {1e-9 * self._last:.3f} s")
        self._last = stamp


class Due:
    """Divides stamps into periods of ``period`` [ns] (0: every stamp) and reports the start of a new one.

    ``phase`` shifts the start by a share of the period, so that topics of the same rate use different ticks.
    """

    def __init__(self, period: int, phase: float = 0.0) -> None:
        self._period, self._shift = max(period, 1), round(phase * period)
        self._present = -1

    def __call__(self, stamp: int) -> bool:
        """Whether a period has begun since the last stamp [ns]."""
        before, self._present = self._present, (stamp - self._shift) // self._period
        return self._present != before
