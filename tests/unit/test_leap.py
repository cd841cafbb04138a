"""Stamps that leap ahead: a wrong one is left out, a gap is gone on from."""

from __future__ import annotations

from controllers.leap import Leap


def test_a_wrong_stamp_is_not_believed_and_those_after_it_are() -> None:
    leap = Leap(5)
    assert leap.believes(10, 15)
    assert not leap.believes(15, 100)
    assert leap.believes(15, 16)
    assert not leap.believes(16, 101)  # the leap before has been forgotten


def test_a_gap_is_believed_from_its_second_stamp_on() -> None:
    leap = Leap(5)
    assert not leap.believes(10, 100)
    assert not leap.believes(10, 100)  # the same again goes on from nothing
    assert leap.believes(10, 101)
