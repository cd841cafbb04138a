"""Absolute deadlines, with a clock that the test turns."""

import math

import pytest

from bridge.driver.run_loop import Pacer
from models.errors import ConfigError

MS = 1_000_000


class Clock:
    """A monotonic clock [ns] that only moves on request; sleep overshoots by a fixed time, or sleeps a share."""

    def __init__(self, overshoot: int = 0, share: float = 1.0) -> None:
        self.now = 5_000_000_000
        self.share = share
        self.overshoot = overshoot
        self.slept = 0

    def __call__(self) -> int:
        return self.now

    def sleep(self, time: float) -> None:
        self.slept += 1
        self.now += math.ceil(round(time * 1e9 * self.share, 3)) + self.overshoot


def pacer(clock: Clock) -> Pacer:
    return Pacer(0.001, clock=clock, sleep=clock.sleep)


def test_deadlines_do_not_drift() -> None:
    clock = Clock(overshoot=50_000)
    start = clock.now
    pace = pacer(clock)
    for _ in range(1000):
        clock.now += 300_000  # work
        late = pace.wait()
        assert late == pytest.approx(50e-6)
    assert clock.now - start == 1000 * MS + 50_000
    assert pace.skipped == 0


def test_a_late_tick_moves_no_deadline() -> None:
    clock = Clock()
    start = clock.now
    pace = pacer(clock)
    clock.now += MS + MS // 2  # one tick takes 1.5 periods
    assert pace.wait() == pytest.approx(0.5e-3)
    assert pace.wait() == 0.0
    assert clock.now - start == 2 * MS
    assert pace.skipped == 0


def test_long_stall_is_skipped_not_made_up_for() -> None:
    clock = Clock()
    start = clock.now
    pace = pacer(clock)
    clock.now += 100 * MS + MS // 2
    assert pace.wait() == pytest.approx(0.5e-3)
    assert pace.skipped == 99
    assert pace.wait() == 0.0
    assert clock.now - start == 101 * MS
    assert clock.slept == 1


def test_early_wake_ups_are_slept_again() -> None:
    clock = Clock(share=0.6)
    start = clock.now
    pace = pacer(clock)
    pace.wait()
    assert clock.now - start >= MS
    assert clock.slept > 1


def test_real_clock_keeps_the_mean_period() -> None:
    import time

    pace = Pacer(0.002)
    begin = time.monotonic()
    for _ in range(100):
        pace.wait()
    assert time.monotonic() - begin >= 0.2 - 1e-4


@pytest.mark.parametrize("period", [0.0, -1.0])
def test_a_period_that_is_not_positive_is_refused(period: float) -> None:
    with pytest.raises(ConfigError, match="period"):
        Pacer(period)
