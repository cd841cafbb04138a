"""Times of the plant's clock: what is believed while the robot moves, and what is not."""

from __future__ import annotations

import pytest

from controllers.clock_guard import ClockGuard
from models.errors import MessageError

HOUR = 3_600_000_000_000
TICK = 10_000_000
LEAP = 500_000_000


def guard_at(stamp: int) -> ClockGuard:
    guard = ClockGuard(LEAP)
    guard.judge(stamp, moving=True)
    return guard


def test_a_clock_that_goes_on_or_stands_is_believed() -> None:
    guard = guard_at(HOUR)
    for stamp in (HOUR, HOUR + TICK, HOUR + TICK + LEAP):
        guard.judge(stamp, moving=True)


def test_a_second_clock_between_the_times_of_the_first_is_refused_each_time() -> None:
    guard = guard_at(0)
    for tick in range(1, 5):
        guard.judge(tick * TICK, moving=True)
        with pytest.raises(MessageError, match="leaps ahead"):
            guard.judge(HOUR + tick * TICK, moving=True)


def test_a_leap_that_is_gone_on_from_is_believed() -> None:
    guard = guard_at(0)
    with pytest.raises(MessageError, match="leaps ahead"):
        guard.judge(HOUR, moving=True)
    guard.judge(HOUR + TICK, moving=True)


def test_a_step_back_is_refused_while_the_robot_moves_and_only_then() -> None:
    guard = guard_at(HOUR)
    for stamp in (0, TICK, 2 * TICK):
        with pytest.raises(MessageError, match="is before"):
            guard.judge(stamp, moving=True)
    guard.judge(3 * TICK, moving=False)
    guard.judge(4 * TICK, moving=True)
