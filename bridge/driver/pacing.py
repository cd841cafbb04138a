"""Real time: absolute deadlines on the monotonic clock, and the count of missed ones."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from models.errors import ConfigError

_NANO = 1e-9


@dataclass(frozen=True, slots=True)
class PacingStatistics:
    """Statistics of the deadlines."""

    ticks: int  #: Deadlines passed, kept or not
    overruns: int  #: Of these, deadlines that had passed before ``wait``: the tick's work took too long
    skipped: int  #: Deadlines dropped after a delay of whole periods; not among ``ticks``
    lateness_max: float  #: Longest time from a deadline to the return of its ``wait`` [s]

    @property
    def missed_fraction(self) -> float:
        """Share of deadlines missed: (overruns + skipped) / (ticks + skipped); 0 before the first."""
        return (self.overruns + self.skipped) / max(self.ticks + self.skipped, 1)


class Pacer:
    """Keeps a loop at a fixed period [s] without drift: deadline k is at start + k period.

    A late tick does not move the deadlines after it. Lost whole periods are skipped and counted, so that no burst
    follows a long stall. ``clock`` is monotonic [ns], ``sleep`` sleeps for a time [s]. Raises ``ConfigError`` unless
    ``period`` is positive.
    """

    def __init__(
        self,
        period: float,
        *,
        clock: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        if not 0.0 < period < float("inf"):
            raise ConfigError(f"period: {period} s is not positive")
        self._period = round(period / _NANO)
        self._clock, self._sleep = clock, sleep
        self._deadline = clock() + self._period
        self._ticks = self._overruns = self._skipped = self._lateness = 0

    def wait(self) -> float:
        """Sleep until the next deadline, or return at once when it has passed; returns how late it is [s]."""
        now = self._clock()
        if now > self._deadline:
            missed = (now - self._deadline) // self._period
            self._skipped += missed
            self._deadline += missed * self._period
            self._overruns += now > self._deadline
        while now < self._deadline:  # again after waking early
            self._sleep((self._deadline - now) * _NANO)
            now = self._clock()
        late = now - self._deadline
        self._ticks += 1
        self._lateness = max(self._lateness, late)
        self._deadline += self._period
        return late * _NANO

    @property
    def statistics(self) -> PacingStatistics:
        """Statistics of the deadlines so far."""
        return PacingStatistics(self._ticks, self._overruns, self._skipped, self._lateness * _NANO)
