"""Real time: absolute deadlines on the monotonic clock, and the count of those that were missed."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from models.errors import ConfigError

_NANO = 1e-9


@dataclass(frozen=True, slots=True)
class PacingStatistics:
    """How well the deadlines were kept since ``start``.

    Attributes:
        ticks: Deadlines that came, kept or not.
        overruns: Of these, the ones that had passed before ``wait`` was called: the tick's work took too long.
        skipped: Deadlines dropped because the backlog was longer than allowed; not among ``ticks``.
        lateness_max: Longest time from a deadline to the return of its ``wait`` [s].
    """

    ticks: int
    overruns: int
    skipped: int
    lateness_max: float

    @property
    def missed_fraction(self) -> float:
        """Share of deadlines missed: (overruns + skipped) / (ticks + skipped); 0 before the first."""
        return (self.overruns + self.skipped) / max(self.ticks + self.skipped, 1)


class Pacer:
    """Keeps a loop at a fixed period without drift: deadline k is at start + k period, whatever the ticks took.

    A tick that is late does not move the deadlines after it; the loop catches up by not sleeping. When more than
    ``backlog`` deadlines have passed, the missed ones are skipped and counted, so that a long stall is not followed by
    a burst.

    Args:
        period: [s].
        backlog: Deadlines that may be caught up with [1].
        spin: Last part of each wait that is spent polling the clock instead of sleeping, to wake on time [s].
        clock: Monotonic clock [ns].
        sleep: Sleeps for a time [s].

    Raises:
        ConfigError: ``period`` is not positive, or ``backlog`` or ``spin`` is negative.
    """

    def __init__(
        self,
        period: float,
        *,
        backlog: int = 10,
        spin: float = 0.0,
        clock: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        if not 0.0 < period < float("inf"):
            raise ConfigError(f"period: {period} s is not positive")
        if backlog < 0:
            raise ConfigError(f"backlog: {backlog} is negative")
        if not spin >= 0.0:
            raise ConfigError(f"spin: {spin} s is negative")
        self._period = round(period / _NANO)
        self._backlog = backlog * self._period
        self._spin = round(spin / _NANO)
        self._clock, self._sleep = clock, sleep
        self.start()

    def start(self) -> None:
        """Count from now: the first deadline is one period away."""
        self._deadline = self._clock() + self._period
        self._ticks = self._overruns = self._skipped = self._lateness = 0

    def wait(self) -> float:
        """Sleep until the next deadline, or return at once when it has passed.

        Returns:
            How late it returns after that deadline [s].
        """
        now = self._clock()
        behind = now - self._deadline
        if behind > self._backlog:
            missed = behind // self._period
            self._skipped += missed
            self._deadline += missed * self._period
            behind -= missed * self._period
        if behind > 0:
            self._overruns += 1
        else:
            asleep = -behind - self._spin
            if asleep > 0:
                self._sleep(asleep * _NANO)
            now = self._clock()
            while now < self._deadline:
                if self._deadline - now > self._spin:  # woken early
                    self._sleep((self._deadline - now - self._spin) * _NANO)
                now = self._clock()
        late = now - self._deadline
        self._ticks += 1
        self._lateness = max(self._lateness, late)
        self._deadline += self._period
        return late * _NANO

    @property
    def statistics(self) -> PacingStatistics:
        """How well the deadlines were kept since ``start``."""
        return PacingStatistics(self._ticks, self._overruns, self._skipped, self._lateness * _NANO)
