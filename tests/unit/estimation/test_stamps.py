"""Stamps: a single jump ahead is refused, a gap is continued; a clock does not go back while the robot moves."""

import pytest

from controllers.estimation.stamps import ClockFilter, JumpFilter
from models.errors import MessageError

HOUR = 3_600_000_000_000
TICK = 10_000_000
LEAP = 500_000_000


def guard_at(stamp: int) -> ClockFilter:
    guard = ClockFilter(LEAP)
    guard.check(stamp, moving=True)
    return guard


def test_a_clock_that_goes_on_or_stands_is_accepted() -> None:
    guard = guard_at(HOUR)
    for stamp in (HOUR, HOUR + TICK, HOUR + TICK + LEAP):
        guard.check(stamp, moving=True)


def test_a_second_clock_between_the_times_of_the_first_is_refused_each_time() -> None:
    guard = guard_at(0)
    for tick in range(1, 5):
        guard.check(tick * TICK, moving=True)
        with pytest.raises(MessageError, match="jumps ahead"):
            guard.check(HOUR + tick * TICK, moving=True)


def test_a_jump_that_is_continued_is_accepted() -> None:
    guard = guard_at(0)
    with pytest.raises(MessageError, match="jumps ahead"):
        guard.check(HOUR, moving=True)
    guard.check(HOUR + TICK, moving=True)


def test_a_step_back_is_refused_while_the_robot_moves_and_only_then() -> None:
    guard = guard_at(HOUR)
    for stamp in (0, TICK, 2 * TICK):
        with pytest.raises(MessageError, match="is before"):
            guard.check(stamp, moving=True)
    guard.check(3 * TICK, moving=False)
    guard.check(4 * TICK, moving=True)


def test_a_wrong_stamp_is_refused_and_those_after_it_are_accepted() -> None:
    jumps = JumpFilter(5)
    assert jumps.accepts(10, 15)
    assert not jumps.accepts(15, 100)
    assert jumps.accepts(15, 16)
    assert not jumps.accepts(16, 101)  # the jump before has been forgotten


def test_a_gap_is_accepted_from_its_second_stamp_on() -> None:
    jumps = JumpFilter(5)
    assert not jumps.accepts(10, 100)
    assert not jumps.accepts(10, 100)  # the same again goes on from nothing
    assert jumps.accepts(10, 101)
