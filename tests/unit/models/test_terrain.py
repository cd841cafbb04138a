"""Terrain: what the generator lays, that MuJoCo has the same ground as the scores, and what is refused."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from models.config import parse_config
from models.errors import ConfigError
from models.mujoco_model import MujocoModel, build_mujoco
from models.robot_model import RobotModel
from models.terrain import Ground, Terrain, blocks, terrain_named, terrains

UNEVEN = [name for name, terrain in terrains().items() if terrain.kind != "flat"]


def height_in_mujoco(mj: MujocoModel, data: mujoco.MjData, x: float, y: float) -> float:
    """Where a ray from above meets the ground [m]."""
    geom = np.zeros(1, dtype=np.int32)
    groups = np.array([1, 0, 0, 0, 0, 0], dtype=np.uint8)  # the ground's, not the robot's
    fall = mujoco.mj_ray(mj.model, data, np.array([x, y, 5.0]), np.array([0.0, 0.0, -1.0]), groups, True, -1, geom)
    return 5.0 - float(fall)


@pytest.mark.parametrize("name", UNEVEN)
def test_mujoco_has_the_ground_that_the_scores_know(g1: RobotModel, name: str) -> None:
    terrain = terrain_named(name, seed=3)
    mj = build_mujoco(g1, terrain=terrain)
    data, ground = mujoco.MjData(mj.model), Ground(terrain)
    mujoco.mj_forward(mj.model, data)
    side = min(1.5, terrain.width)  # nothing is beyond
    for x, y in np.random.default_rng(0).uniform((-1.0, -side), (8.0, side), (60, 2)):
        assert height_in_mujoco(mj, data, x, y) == pytest.approx(ground.height(x, y), abs=1e-6)


@pytest.mark.parametrize("name", UNEVEN)
def test_the_robot_starts_on_a_level_patch(name: str) -> None:
    ground = Ground(terrain_named(name, seed=1))
    assert {ground.height(x, y) for x in np.linspace(-0.35, 0.35, 8) for y in np.linspace(-0.5, 0.5, 5)} == {0.0}


def test_tiles_have_the_heights_of_their_seed() -> None:
    def heights(seed: int) -> list[float]:
        return [block.top[2] for block in blocks(terrain_named("tiles", seed=seed))[1:]]

    first, largest = heights(0), terrain_named("tiles").height
    assert heights(0) == first and heights(1) != first
    assert 0.0 <= min(first) < 0.05 * largest and 0.95 * largest < max(first) <= largest


def test_slopes_and_stairs_rise_as_they_say() -> None:
    up = Ground(terrain_named("slope_up"))
    assert (up.height(5.0, 0.3) - up.height(4.0, 0.3)) == pytest.approx(np.tan(0.1396))
    across = Ground(terrain_named("slope_across"))
    assert (across.height(5.0, 0.5) - across.height(5.0, -0.5)) == pytest.approx(np.tan(0.1396))
    assert across.height(5.0, 0.0) == across.height(4.0, 0.0)
    assert 0.0 < across.height(0.8, 0.5) < across.height(5.0, 0.5)  # it is reached gradually
    stairs = Ground(terrain_named("stairs_down"))
    assert stairs.height(5.05, 0.0) - stairs.height(4.55, 0.0) == pytest.approx(-0.03)


def test_stairs_lead_up_to_a_landing_and_down_again() -> None:
    terrain = Terrain(kind="stairs", height=0.15, size=0.3, count=3, landing=0.8)
    ground, first = Ground(terrain), terrain.patch
    edges = [first, *(first + np.array([0.3, 0.6, 1.4, 1.7, 2.0]))]
    for k, (level, edge) in enumerate(zip([1, 2, 3, 2, 1, 0], edges, strict=True)):
        assert ground.height(edge + 1e-6, 0.5) == pytest.approx(0.15 * level)
        assert ground.height(edge - 1e-6, 0.5) == pytest.approx(0.15 * [0, 1, 2, 3, 2, 1][k])
    assert ground.height(terrain.length - 0.01, 0.0) == 0.0
    with pytest.raises(ConfigError, match="count"):
        parse_config(Terrain, {"kind": "stairs", "count": 0}, "here")


def test_stones_have_gaps_between_them_and_level_ground_behind() -> None:
    terrain = Terrain(kind="stones", height=0.05, size=0.3, gap=0.15, length=4.0, seed=3)
    ground, first = Ground(terrain), terrain.patch + terrain.gap
    heights = [ground.height(first + 0.45 * i + 0.15, 0.0) for i in range(5)]
    assert len(set(heights)) == 5 and 0.0 <= min(heights) and max(heights) <= 0.05
    stones = [block for block in blocks(terrain) if block.half == (0.15, 0.15)]
    assert len(stones) == 7 * 13 and {ground.height(first + 0.45 * i - 0.07, 0.0) for i in range(5)} == {-0.5}
    assert ground.height(4.0, 0.0) == 0.0


def test_beside_the_terrain_the_ground_is_its_lowest_point() -> None:
    ground = Ground(terrain_named("slope_down"))
    assert ground.height(100.0, 0.0) == ground.lowest < -1.0
    assert Ground(terrain_named("flat")).height(100.0, 0.0) == 0.0


def test_soft_ground_gives_more(g1: RobotModel) -> None:
    hard, soft = build_mujoco(g1), build_mujoco(g1, terrain="soft")
    assert soft.model.geom("floor").solref[0] > hard.model.geom("floor").solref[0]


def test_uneven_ground_touches_the_sole_between_its_corners(g1: RobotModel) -> None:
    """An edge under the middle of a sole must not pass between its contact points."""
    mj = build_mujoco(g1, terrain="tiles")
    body = mj.bodies["l_sole"]
    points = mj.model.geom_pos[mj.model.geom_bodyid == body]
    assert len(np.unique(points[:, 0].round(6))) == 5 and len(np.unique(points[:, 1].round(6))) == 4
    corners = {(round(float(x), 6), round(float(y), 6)) for x, y in points[:, :2]}
    assert {(round(float(x), 6), round(float(y), 6)) for x, y, _ in g1.feet[0].corners} <= corners
    assert len(points) == len(corners) == 14


def test_an_unknown_name_is_refused() -> None:
    with pytest.raises(ConfigError, match="terrain: unknown 'swamp'; known: flat, tiles"):
        terrain_named("swamp")


@pytest.mark.parametrize(
    "change",
    [
        {"kind": "lava"},
        {"height": -0.1},
        {"size": 0.0},
        {"pitch": 1.0},
        {"give": 0.0},
        {"seed": -1},
        {"colour": "red"},
        {"obstacle": {"size": [0.4, 0.0, 1.0]}},
    ],
)
def test_a_bad_terrain_is_refused(change: dict[str, object]) -> None:
    (key,) = change
    with pytest.raises(ConfigError, match=key):
        parse_config(Terrain, {"kind": "tiles", **change}, "here")


def test_another_seed_keeps_everything_else() -> None:
    terrain = Terrain(kind="tiles", height=0.05)
    assert terrain_named(terrain, seed=4) == replace(terrain, seed=4)
    assert terrain_named(terrain) is terrain
