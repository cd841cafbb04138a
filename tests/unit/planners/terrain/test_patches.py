"""Planar patches: normals, insets, edges between levels, convexity, and what is no plane."""

import math

import numpy as np
import pytest
from matplotlib.path import Path

from models.config import default_config
from models.terrain import Ground, terrain_named
from planners.terrain.config import TerrainMapConfig
from planners.terrain.elevation_map import ElevationMap
from planners.terrain.patches import Patch, find_patches

INSET = 0.025
CONFIG = default_config(TerrainMapConfig, "planners", "terrain_map")


def mapped(height: object, noise: float = 0.0, x: float = 0.0) -> ElevationMap:
    """A map of a function of x and y, known everywhere."""
    grid = ElevationMap(CONFIG)
    grid.move_to(x, 0.0)
    axes = [(grid.origin[k] + np.arange(grid.cells) + 0.5) * grid.cell for k in (0, 1)]
    grid.height[:] = np.array([[height(a, b) for b in axes[1]] for a in axes[0]])  # type: ignore[operator]
    grid.height += noise * np.random.default_rng(1).standard_normal(grid.height.shape)
    grid.variance[:] = 4e-6
    return grid


def on(patches: list[Patch], x: float, y: float) -> list[Patch]:
    return [patch for patch in patches if Path(patch.vertices[:, :2]).contains_point((x, y))]


@pytest.mark.parametrize(("pitch", "roll"), [(0.0, 0.0), (0.2, 0.0), (0.1, -0.15)])
def test_a_tilted_plane_is_one_patch_with_its_normal(pitch: float, roll: float) -> None:
    a, b = math.tan(pitch), math.tan(roll)
    patches = find_patches(mapped(lambda x, y: 0.3 + a * x + b * y, 0.002), CONFIG.patches, INSET)
    assert len(patches) == 1
    (patch,) = patches
    normal = np.array([-a, -b, 1.0]) / math.sqrt(1.0 + a * a + b * b)
    assert math.acos(min(float(patch.normal @ normal), 1.0)) < 0.002
    assert patch.height(0.7, -0.4) == pytest.approx(0.3 + 0.7 * a - 0.4 * b, abs=1e-3)
    edge = 1.5 - np.abs(patch.vertices[:, :2]).max()
    assert INSET - 1e-9 <= edge <= INSET + 2 * CONFIG.cell
    assert patch.area == pytest.approx((3.0 - 2 * edge) ** 2, rel=0.02)


@pytest.mark.parametrize("rise", [0.03, 0.15, -0.2])
def test_a_step_separates_two_patches_that_keep_their_distance(rise: float) -> None:
    patches = find_patches(mapped(lambda x, y: rise * (x > 0.4), 0.002), CONFIG.patches, INSET)
    assert len(patches) == 2
    low, high = sorted(patches, key=lambda patch: patch.vertices[:, 0].mean())
    assert low.height(0.0, 0.0) == pytest.approx(0.0, abs=1e-3) and high.height(0.8, 0.0) == pytest.approx(
        rise, abs=1e-3
    )
    assert INSET - 0.006 <= 0.4 - low.vertices[:, 0].max() <= INSET + 0.05
    assert INSET - 0.006 <= high.vertices[:, 0].min() - 0.4 <= INSET + 0.05


def test_stairs_are_a_patch_for_each_tread() -> None:
    grid = mapped(lambda x, y: 0.15 * math.floor(x / 0.3), 0.002)
    patches = find_patches(grid, CONFIG.patches, INSET)
    for k in range(-4, 4):
        found = on(patches, 0.3 * k + 0.15, 0.2)
        assert len(found) == 1 and found[0].height(0.3 * k + 0.15, 0.2) == pytest.approx(0.15 * k, abs=2e-3)
        width = np.ptp(found[0].vertices[:, 0])
        assert 0.2 < width <= 0.3 - 2 * INSET + 0.012


def test_polygons_are_convex_and_on_their_ground() -> None:
    """Tiles of random heights: every polygon lies on ground of its height, and turns left at each corner."""
    ground = Ground(terrain_named("tiles_high", seed=4))
    patches = find_patches(mapped(ground.height, 0.002, x=2.0), CONFIG.patches, INSET)
    assert len(patches) > 30
    rng, wrong, tried = np.random.default_rng(5), 0, 0
    for patch in patches:
        edges = np.roll(patch.vertices, -1, axis=0)[:, :2] - patch.vertices[:, :2]
        following = np.roll(edges, -1, axis=0)
        assert (edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0] > 0.0).all()
        assert math.acos(patch.normal[2]) < 0.15
        for _ in range(20):
            weights = rng.dirichlet(np.ones(len(patch.vertices)))
            x, y, z = weights @ patch.vertices
            tried += 1
            wrong += abs(ground.height(float(x), float(y)) - z) > 0.01
    assert wrong <= 0.01 * tried


def test_rough_steep_and_unknown_ground_is_none() -> None:
    rng = np.random.default_rng(2)
    grid = mapped(lambda x, y: 0.0, 0.002)
    grid.height[:60] += rng.uniform(0.0, 0.05, (60, 150))  # rubble
    grid.variance[100:] = np.inf
    patches = find_patches(grid, CONFIG.patches, INSET)
    assert on(patches, 0.0, 0.0) and not on(patches, -1.0, 0.0) and not on(patches, 1.0, 0.0)
    known = (grid.origin[0] + 100) * grid.cell
    assert max(patch.vertices[:, 0].max() for patch in patches) <= known - INSET + 0.001
    steep = mapped(lambda x, y: 0.8 * x)
    assert not find_patches(steep, CONFIG.patches, INSET)


def test_a_ring_becomes_convex_parts_that_leave_out_its_hole() -> None:
    grid = mapped(lambda x, y: -0.3 if abs(x) < 0.3 and abs(y) < 0.3 else 0.0, 0.001)
    patches = find_patches(grid, CONFIG.patches, INSET)
    level = [patch for patch in patches if abs(patch.height(*patch.vertices[0, :2])) < 0.01]
    assert len(level) > 3
    for x, y in ((0.9, 0.0), (-0.9, 0.2), (0.1, 0.9), (0.0, -0.8)):
        assert on(level, x, y)
    inside = np.random.default_rng(1).uniform(-0.25, 0.25, (200, 2))
    assert sum(bool(on(level, *point)) for point in inside) == 0
    covered = np.random.default_rng(1).uniform(-1.4, 1.4, (2000, 2))
    covered = covered[np.abs(covered).max(axis=1) > 0.4]
    assert np.mean([bool(on(level, *point)) for point in covered]) > 0.85
