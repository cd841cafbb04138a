"""The way of the CoM height to a new one."""

import numpy as np
import pytest

from planners.gait.reference import approach

DT, RATES, ACCELERATION = 0.001, (-1.0, 0.08), 8.0


def way(start: float, target: float, duration: float = 3.0) -> np.ndarray:
    """Heights and rates from rest (ticks, 2) [m, m/s]."""
    state, states = (start, 0.0), []
    for _ in range(round(duration / DT)):
        state = approach(*state, target, RATES, ACCELERATION, DT)
        states.append(state)
    return np.array(states)


@pytest.mark.parametrize("target", [0.55, 0.699, 0.7, 0.8])
def test_it_comes_to_rest_at_the_target_without_passing_it(target: float) -> None:
    heights, rates = way(0.7, target).T
    assert heights[-1] == pytest.approx(target, abs=1e-6) and rates[-1] == pytest.approx(0.0, abs=1e-6)
    assert heights.min() > min(target, 0.7) - 1e-4 and heights.max() < max(target, 0.7) + 1e-4


def test_rate_and_acceleration_have_limits() -> None:
    for target in (0.2, 1.0):
        _, rates = way(0.7, target).T
        assert RATES[0] - 1e-12 <= rates.min() and rates.max() <= RATES[1] + 1e-12
        assert np.abs(np.diff(rates, prepend=0.0)).max() <= ACCELERATION * DT + 1e-12
        assert rates.min() == pytest.approx(RATES[0]) or rates.max() == pytest.approx(RATES[1])


def test_a_target_that_moves_up_brakes_a_descent() -> None:
    height, rate = approach(0.6, -0.5, 0.7, RATES, ACCELERATION, DT)
    assert rate == pytest.approx(-0.5 + ACCELERATION * DT) and height < 0.6
