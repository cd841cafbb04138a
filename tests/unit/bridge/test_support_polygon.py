import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.analysis.stability import distance_along, margin, support_polygon

LEFT = np.array([[0.12, 0.13], [-0.05, 0.13], [-0.05, 0.08], [0.12, 0.08]])
RIGHT = LEFT * [1.0, -1.0]


def test_hull_of_two_feet_is_their_bounding_box() -> None:
    hull = support_polygon([LEFT, RIGHT])
    assert {tuple(v) for v in hull} == {(0.12, 0.13), (-0.05, 0.13), (-0.05, -0.13), (0.12, -0.13)}
    x, y = hull.T
    assert 0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) == pytest.approx(0.17 * 0.26)  # counter-clockwise


def test_margin_is_signed() -> None:
    hull = support_polygon([LEFT, RIGHT])
    assert margin(hull, np.array([0.02, 0.0])) == pytest.approx(0.07)
    assert margin(hull, np.array([0.12, 0.0])) == pytest.approx(0.0)
    assert margin(hull, np.array([0.15, 0.0])) == pytest.approx(-0.03)


@given(st.floats(0.0, 2.0 * np.pi), st.floats(-0.04, 0.11), st.floats(-0.12, 0.12))
def test_the_point_at_the_distance_lies_on_the_edge(angle: float, x: float, y: float) -> None:
    hull = support_polygon([LEFT, RIGHT])
    point, direction = np.array([x, y]), np.array([np.cos(angle), np.sin(angle)])
    reached = point + distance_along(hull, point, direction) * direction
    assert margin(hull, reached) == pytest.approx(0.0, abs=1e-12)


def test_too_few_corners_are_refused() -> None:
    with pytest.raises(ValueError, match="three corners"):
        support_polygon([LEFT[:2]])
