"""Samples of two feet: when they make a pair, and who counts as silent."""

import numpy as np
import pytest

from controllers.estimation.assembler import FootPairs
from models.errors import MessageError

MS = 1_000_000
LEFT, RIGHT = 0, 1


def _wrench(load: float) -> np.ndarray:
    return np.array([0.0, 0.0, load, 0.0, 0.0, 0.0])


def test_a_pair_is_complete_with_the_second_foot() -> None:
    pairs = FootPairs(5 * MS, 50 * MS)
    assert pairs.add(LEFT, 10 * MS, _wrench(1.0)) is None
    assert pairs.add(RIGHT, 10 * MS, _wrench(2.0)) == 0.0
    assert pairs.add(RIGHT, 11 * MS, _wrench(3.0)) is None
    assert pairs.add(LEFT, 11 * MS, _wrench(4.0)) == pytest.approx(0.001)
    np.testing.assert_array_equal(pairs.wrenches[:, 2], [4.0, 3.0])
    assert (pairs.silent, pairs.stamp) == ([False, False], 11 * MS)


@pytest.mark.parametrize("other_spoke", [False, True])
def test_a_silent_foot_is_not_waited_for(other_spoke: bool) -> None:
    pairs = FootPairs(5 * MS, 50 * MS)
    if other_spoke:
        pairs.add(RIGHT, 10 * MS, _wrench(1.0))
    steps = [pairs.add(LEFT, stamp * MS, _wrench(1.0)) for stamp in range(10, 20)]
    assert pairs.silent == [False, True]
    assert [step is None for step in steps] == [not other_spoke, *[True] * 5, *[False] * 4]
    assert steps[-1] == pytest.approx(0.001)
    pairs.add(RIGHT, 20 * MS, _wrench(1.0))
    assert pairs.add(LEFT, 20 * MS, _wrench(1.0)) == pytest.approx(0.001)
    assert pairs.silent == [False, False]


def test_stamps_that_are_refused_leave_no_trace() -> None:
    pairs = FootPairs(5 * MS, 50 * MS)
    pairs.add(LEFT, 10 * MS, _wrench(1.0))
    for stamp, culprit in ((10, "repeats"), (9, "is before"), (1000, "jumps ahead")):
        with pytest.raises(MessageError, match=culprit):
            pairs.add(LEFT, stamp * MS, _wrench(9.0))
    assert pairs.wrenches[LEFT, 2] == 1.0
