"""Hull, distance and projection of the support polygon against SciPy and brute force."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from controllers.balance.support import cmp_command, edge_distance
from models.numerics.hull import convex_hull

SQUARE = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0], [0.2, 0.1]])
coordinate = st.floats(-3.0, 3.0)


def hull_of(points: np.ndarray) -> tuple[np.ndarray, int]:
    hull = np.zeros((2 * len(points) + 2, 2))
    return hull, convex_hull(points, hull)


@settings(deadline=None)  # the first example compiles
@given(st.integers(0, 10_000), st.integers(4, 8))
def test_hull_equals_scipy(seed: int, count: int) -> None:
    points = np.random.default_rng(seed).normal(size=(count, 2))
    hull, n = hull_of(points)
    expected = points[ConvexHull(points).vertices]
    assert {tuple(p) for p in hull[:n]} == {tuple(p) for p in expected}
    edges = np.roll(hull[:n], -1, axis=0) - hull[:n]
    turns = edges[:, 0] * np.roll(edges, -1, axis=0)[:, 1] - edges[:, 1] * np.roll(edges, -1, axis=0)[:, 0]
    assert (turns > 0).all()


@settings(max_examples=300, deadline=None)
@given(coordinate, coordinate, st.floats(0.0, 0.5))
def test_distance_to_a_square(x: float, y: float, margin: float) -> None:
    hull, n = hull_of(SQUARE)
    out = np.zeros(4)
    distance = edge_distance(hull, n, x, y, margin, out)
    half = 1.0 - margin
    outside = np.hypot(max(abs(x) - half, 0.0), max(abs(y) - half, 0.0))
    expected = outside if outside > 0 else max(abs(x), abs(y)) - half
    np.testing.assert_allclose(distance, expected, atol=1e-9)
    np.testing.assert_allclose(np.hypot(x - out[0], y - out[1]), abs(expected), atol=1e-9)
    assert max(abs(out[0]), abs(out[1])) <= half + 1e-9
    np.testing.assert_allclose(np.hypot(out[2], out[3]), 1.0, atol=1e-9)


def command(
    dcm: tuple[float, float], desired: tuple[float, float], shape: np.ndarray = SQUARE, **changes: float
) -> tuple[np.ndarray, float]:
    hull, n = hull_of(shape)
    settings = {"margin": 0.0, "momentum_margin": 0.1, "momentum_gain": 2.0, "momentum_reach_max": 0.5} | changes
    out = np.zeros(2)
    inside = cmp_command(hull, n, np.array(dcm), np.array(desired), *settings.values(), out)
    return out, inside


def test_cmp_inside_is_left_alone() -> None:
    out, margin = command((0.0, 0.0), (0.3, -0.2))
    np.testing.assert_allclose(out, [0.3, -0.2])
    np.testing.assert_allclose(margin, 1.0)


def test_cmp_outside_comes_to_the_edge_while_the_dcm_is_deep_inside() -> None:
    out, _ = command((0.5, 0.0), (4.0, 0.5))
    np.testing.assert_allclose(out, [1.0, 0.5])


def test_cmp_reaches_beyond_the_edge_when_the_dcm_nears_it() -> None:
    near, _ = command((0.95, 0.0), (4.0, 0.0))
    passed, margin = command((1.1, 0.0), (4.0, 0.0))
    far, _ = command((3.0, 0.0), (4.0, 0.0))
    np.testing.assert_allclose(near, [1.1, 0.0])
    np.testing.assert_allclose(passed, [1.4, 0.0])
    np.testing.assert_allclose(far, [1.5, 0.0])
    np.testing.assert_allclose(margin, -0.1)


@settings(deadline=None)
@given(st.floats(-0.85, 0.85), st.floats(-0.85, 0.85), coordinate, coordinate)
def test_cmp_is_a_centre_of_pressure_while_the_dcm_is_inside(dx: float, dy: float, x: float, y: float) -> None:
    out, _ = command((dx, dy), (x, y))
    assert np.abs(out).max() <= 1.0 + 1e-9


@settings(deadline=None)
@given(st.floats(0.01, 0.5), st.floats(0.0, 0.2), st.floats(-0.6, 0.6), st.floats(-0.6, 0.6))
def test_cmp_moves_no_faster_than_the_dcm_times_the_gain(half: float, margin: float, first: float, last: float) -> None:
    """It jumped where the nearest edge changes: a robot with weak ankles rocked between those of its soles at 26 Hz."""
    strip = SQUARE[:4] * (half, 1.0)
    (x, _), (y, _) = (command((at, 0.0), (0.0, 0.0), strip, momentum_margin=margin)[0] for at in (first, last))
    assert abs(y - x) <= 2.0 * abs(last - first) + 1e-9
