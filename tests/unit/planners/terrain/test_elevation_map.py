"""The grid: fusion and its variances, what is replaced, emptied and forgotten, and cells at the right places."""

from dataclasses import replace

import numpy as np
import pytest

from models.config import default_config
from planners.terrain.config import TerrainMapConfig
from planners.terrain.elevation_map import ElevationMap, Heights

EYE = np.array([0.0, 0.0, 1.3])


@pytest.fixture
def config() -> TerrainMapConfig:
    return default_config(TerrainMapConfig, "planners", "terrain_map")


@pytest.fixture
def grid(config: TerrainMapConfig) -> ElevationMap:
    grid = ElevationMap(config)
    grid.move_to(0.0, 0.0)
    return grid


def measure(
    grid: ElevationMap, t: float, points: list[list[float]], deviation: float = 0.01, common: float = 0.0
) -> int:
    cloud = np.array(points)
    return grid.fuse(t, cloud, np.full(len(cloud), deviation), np.full(len(cloud), common), EYE)


def test_a_cell_gets_the_mean_of_its_points_and_its_variance(grid: ElevationMap) -> None:
    assert measure(grid, 1.0, [[0.501, 0.301, 0.10], [0.519, 0.319, 0.12], [0.41, 0.3, 0.0]]) == 2
    assert grid.at(np.array([[0.51, 0.31], [0.7, 0.7]])) == pytest.approx([0.11, np.nan], nan_ok=True)
    index, inside = grid.index(np.array([[0.51, 0.31]]))
    i, j = index[0]
    assert inside.all() and grid.seen[i, j] == 1.0
    floor = default_config(TerrainMapConfig, "planners", "terrain_map").fusion.floor
    assert grid.variance[i, j] == pytest.approx(0.01**2 / 2 + floor**2)
    measure(grid, 2.0, [[0.51, 0.31, 0.13]], 0.005, 0.004)
    p, v = 0.01**2 / 2 + floor**2, 0.005**2 + floor**2 + 0.004**2
    assert grid.height[i, j] == pytest.approx(0.11 + p / (p + v) * 0.02)
    assert grid.variance[i, j] == pytest.approx(p * v / (p + v))
    measure(grid, 1.5, [[0.51, 0.31, 0.12]])
    assert grid.seen[i, j] == 2.0  # the cloud of another sensor came late


def test_errors_average_out_down_to_the_floor(config: TerrainMapConfig, grid: ElevationMap) -> None:
    rng = np.random.default_rng(1)
    places = rng.uniform(-0.5, 0.5, (4000, 2))
    for k in range(30):
        measure(grid, float(k), np.column_stack([places, 0.05 + 0.01 * rng.standard_normal(4000)]).tolist())
    known = grid.height[grid.known]
    assert np.sqrt(np.mean((known - 0.05) ** 2)) < 0.003
    assert grid.variance.min() == pytest.approx(config.fusion.floor**2)


def test_the_upper_of_two_levels_counts(grid: ElevationMap) -> None:
    measure(grid, 1.0, [[0.5, 0.3, 0.2], [0.51, 0.31, 0.0], [0.515, 0.305, 0.01]])
    assert grid.at(np.array([[0.51, 0.31]])) == pytest.approx([0.2])


@pytest.mark.parametrize("rise", [0.06, 0.15, 0.7, -0.3])
def test_a_wrong_height_is_replaced_only_if_it_stays(grid: ElevationMap, rise: float) -> None:
    i, j = grid.index(np.array([[0.51, 0.31]]))[0][0]
    for k in range(5):
        measure(grid, float(k), [[0.51, 0.31, 0.0]], 0.005)
    measure(grid, 5.0, [[0.51, 0.31, rise]], 0.005)
    assert grid.height[i, j] == pytest.approx(0.0) and grid.seen[i, j] == 4.0
    measure(grid, 6.0, [[0.51, 0.31, 0.0]], 0.005)  # it was an outlier
    assert grid.known[i, j] and grid.height[i, j] == pytest.approx(0.0)
    for k in range(7, 13):
        measure(grid, float(k), [[0.51, 0.31, rise]], 0.005)
    assert grid.known[i, j] and grid.height[i, j] == pytest.approx(rise, abs=0.005) and grid.seen[i, j] == 12.0


def test_a_ray_below_a_height_empties_the_cell_and_one_above_does_not(grid: ElevationMap) -> None:
    place, wall = np.array([[0.51, 0.01]]), [[0.51, 0.01, 0.4]]
    measure(grid, 1.0, wall, 0.005)
    ahead = 0.51 + 0.45 * 0.51 / (1.3 - 0.45)  # where the ray ends that passes 5 cm above
    measure(grid, 2.0, [[ahead, 0.01, 0.0]], 0.005)
    assert grid.at(place) == pytest.approx([0.4])
    ahead = 0.51 + 0.2 * 0.51 / (1.3 - 0.2)
    measure(grid, 3.0, [[ahead, 0.01, 0.0], *wall], 0.005)
    assert grid.at(place) == pytest.approx([0.4])  # seen in the same cloud
    measure(grid, 4.0, [[ahead, 0.01, 0.0]], 0.005)
    assert np.isnan(grid.at(place)).all()
    assert grid.at(np.array([[ahead, 0.01]])) == pytest.approx([0.0])


@pytest.mark.parametrize("step", [(0.3, 0.0), (-0.3, 0.5), (0.013, -0.21), (5.0, 0.0)])
def test_places_stay_when_the_map_moves(grid: ElevationMap, step: tuple[float, float]) -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform(-1.4, 1.4, (500, 2))
    measure(grid, 1.0, np.column_stack([points, points @ (0.1, 0.2)]).tolist(), 0.002)
    before = grid.at(points)
    grid.move_to(*step)
    after = grid.at(points)
    _, inside = grid.index(points)
    np.testing.assert_array_equal(after[inside], before[inside])
    assert np.isnan(after[~inside]).all()
    assert np.abs(grid.centre - step).max() <= 0.5 * grid.cell + 1e-9
    unknown = rng.uniform(-1.4, 1.4, (2000, 2)) + step
    new = (np.abs(unknown) > 1.5).any(axis=1)
    assert np.isnan(grid.at(unknown[new])).all()


def test_old_heights_become_unknown(config: TerrainMapConfig, grid: ElevationMap) -> None:
    measure(grid, 1.0, [[0.51, 0.31, 0.0]], 0.005)
    grid.age(0.9 * config.fusion.variance_max)
    assert grid.known.sum() == 1
    grid.age(0.2 * config.fusion.variance_max)
    assert not grid.known.any() and np.isnan(grid.at(np.array([[0.51, 0.31]]))).all()


def test_the_map_has_the_cells_of_its_size(config: TerrainMapConfig) -> None:
    grid = ElevationMap(replace(config, cell=0.05, length=2.0))
    assert grid.height.shape == (40, 40)


def test_holes_between_the_rays_are_closed_on_level_ground_only() -> None:
    values = np.zeros((7, 9))
    values[:, 6:] = 0.1
    values[2, 2], values[4, 6], values[:2, 4] = np.nan, np.nan, np.nan
    closed = Heights(values, (1.0, 2.0), 0.02).closed()
    assert closed.values[2, 2] == 0.0
    assert np.isnan(closed.values[4, 6])  # at an edge
    assert np.isnan(closed.values[0, 4])  # too little is known around it
    found = closed.at(np.array([[1.05, 2.05], [1.05, 2.13], [0.99, 2.05], [1.05, 2.19]]))
    assert found == pytest.approx([0.0, 0.1, np.nan, np.nan], nan_ok=True)
