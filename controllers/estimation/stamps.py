"""Stamps that are refused, as they repeat, go back or jump ahead alone, and those with which a period begins."""

import math

from models.errors import MessageError


class JumpFilter:
    """Accepts a jump ahead of a stamp, beyond ``step_max``, when the next stamp continues from it: a gap, no error."""

    def __init__(self, step_max: float) -> None:
        self._step_max = step_max
        self._pending: float | None = None

    def accepts(self, last: float, stamp: float) -> bool:
        """Whether a stamp follows the last accepted one; it is not before that one."""
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
        """Time since the last stamp [ns], 0 for the first; ``MessageError`` if it is not newer or jumps ahead."""
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

    Ages and timeouts of commands are counted on this clock. If it were set ahead for a moment, the velocity of a
    source that then falls silent would hold for just as long. A jump from which the next time continues is accepted:
    then messages were missing. A clock that has gone back is refused until the robot is at rest; its users receive no
    time until then, and the robot damps. ``step_max`` is the largest step ahead that is accepted at once [ns].
    """

    def __init__(self, step_max: int) -> None:
        self._jumps = JumpFilter(step_max)
        self._last: int | None = None

    def check(self, stamp: int, *, moving: bool) -> None:
        """Accept a time [ns], any while the robot does not move (its plant may be new); ``MessageError`` else."""
        if moving and self._last is not None:
            if stamp < self._last:
                raise MessageError(f"clock: {1e-9 * stamp:.3f} s is before {1e-9 * self._last:.3f} s")
            if not self._jumps.accepts(self._last, stamp):
                raise MessageError(f"clock: {1e-9 * stamp:.3f} s jumps ahead of {1e-9 * self._last:.3f} s")
        self._last = stamp


class Due:
    """Divides stamps into periods of ``period`` [ns] (0: every stamp) and reports when a new one has begun.

    ``phase`` shifts the beginning by a share of the period, so that topics of the same rate share no tick.
    """

    def __init__(self, period: int, phase: float = 0.0) -> None:
        self._period, self._shift = max(period, 1), round(phase * period)
        self._present = -1

    def __call__(self, stamp: int) -> bool:
        """Whether a period has begun since the last stamp [ns]."""
        before, self._present = self._present, (stamp - self._shift) // self._period
        return self._present != before
