import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.core.benchmark import settings
from benchmarks.core.loops import Search, largest
from benchmarks.stability.push import PushConfig
from benchmarks.stability.push_bounds import ankle_bound
from models.constants import GRAVITY

CONFIG = settings(PushConfig, "push")
SEARCH = Search(CONFIG.first_ratio, CONFIG.largest_ratio, CONFIG.stride, CONFIG.resolution)


@given(st.floats(0.3, 1.2), st.floats(0.02, 0.2), st.floats(0.02, 0.5))
def test_the_ankle_bound_leaves_the_dcm_on_the_edge(height: float, distance: float, duration: float) -> None:
    """Integrates x'' = w^2 (x - p) + F / m with the centre of pressure p held on the edge."""
    mass = 33.0
    omega = math.sqrt(GRAVITY / height)
    force = ankle_bound(mass, height, distance, duration)
    dcm, steps = 0.0, 400
    step = duration / steps
    for _ in range(steps):  # midpoint rule on the DCM: xi' = w (xi - p) + F / (m w)
        slope = omega * (dcm - distance) + force / (mass * omega)
        middle = dcm + 0.5 * step * slope
        dcm += step * (omega * (middle - distance) + force / (mass * omega))
    assert dcm == pytest.approx(distance, rel=1e-4)


@given(st.floats(0.02, 2.9))
def test_the_search_brackets_the_limit(limit: float) -> None:
    tried: list[float] = []

    def holds(ratio: float) -> bool:
        tried.append(ratio)
        return ratio <= limit

    found, count = largest(holds, SEARCH)
    assert found <= limit < found + CONFIG.resolution
    assert count == len(tried) <= 14
    assert found == 0.0 or found in tried


def test_the_search_ends_at_its_largest_ratio_and_at_nothing() -> None:
    assert largest(lambda ratio: True, SEARCH)[0] == CONFIG.largest_ratio
    assert largest(lambda ratio: False, SEARCH)[0] == 0.0
