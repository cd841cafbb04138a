"""A walking robot maps the ground with its own sensors and its own estimate."""

import numpy as np
import pytest

from benchmarks.stability.terrain_map import Area, score
from bridge.closed_loop import ClosedLoop
from models.errors import ConfigError, PoiseError
from models.terrain import Ground, terrain_named


@pytest.mark.long
@pytest.mark.parametrize("name", ["tiles", "slope_up"])
def test_the_ground_ahead_of_a_walk_is_known_to_a_centimetre(name: str) -> None:
    terrain = terrain_named(name, seed=11)
    loop = ClosedLoop("g1", seed=11, terrain=terrain, terrain_map=True, record=False)
    loop.command("walk")
    loop.set_velocity(0.4, 0.0, 0.0)
    loop.run(2.0)
    area, errors = Area(loop.robot, margin=0.04), []
    for _ in range(10):
        loop.run(0.2)
        errors.append(score(loop, Ground(terrain), area))
    found = np.concatenate(errors)
    assert not loop.fallen and np.isfinite(found).mean() > 0.95
    depth = loop.robot.profile.sensors.depth
    assert depth is not None and min(loop.ground_view.delays) >= depth.latency - 1e-9
    assert np.sqrt(np.nanmean(found**2)) < 0.01


@pytest.mark.long
def test_the_map_changes_nothing_about_the_walk() -> None:
    def walk(*, maps: bool) -> np.ndarray:
        loop = ClosedLoop("g1", seed=3, terrain_map=maps, record=False)
        loop.command("walk")
        loop.set_velocity(0.3, 0.0, 0.0)
        loop.run(1.0)
        return np.concatenate([loop.truth.q, loop.state.q])

    np.testing.assert_array_equal(walk(maps=True), walk(maps=False))


def test_a_reset_forgets_the_ground_and_a_robot_without_sensors_is_refused() -> None:
    loop = ClosedLoop("g1", terrain_map=True, record=False)
    loop.run(0.5)
    view = loop.ground_view
    assert view.mapper.map.known.sum() > 1000
    first = view.mapper.map.height.copy()
    loop.reset()
    loop.run(0.5)
    np.testing.assert_array_equal(view.mapper.map.height, first)
    with pytest.raises(PoiseError, match="terrain_map=True"):
        _ = ClosedLoop("g1", record=False).ground_view
    with pytest.raises(ConfigError, match="terrain_map: talos_hardware has neither"):
        ClosedLoop("talos_hardware", terrain_map=True)


@pytest.mark.long
def test_a_box_that_appears_is_in_the_map_within_a_second_and_gone_within_another() -> None:
    """Its near face is 0.8 m ahead; once it is gone the rays that pass there say so."""
    loop = ClosedLoop("g1", seed=4, terrain="box", terrain_map=True, record=False)
    grid = loop.ground_view.mapper.map
    across = np.arange(-0.15, 0.15, 0.02)
    face = np.array([[x, y] for x in (0.77, 0.79, 0.81, 0.83) for y in across])
    floor = np.array([[0.6, y] for y in across])
    loop.run(1.0)
    assert np.nanmax(np.abs(grid.at(np.concatenate([face, floor])))) < 0.03
    loop.plant.obstacle.place(1.0, 0.0)
    loop.run(1.0)
    highest = np.nanmax(grid.at(face).reshape(4, -1), axis=0)
    assert highest.min() > 0.3 and np.nanmax(np.abs(grid.at(floor))) < 0.03
    loop.plant.obstacle.remove()
    loop.run(1.0)
    assert np.nanmax(np.abs(grid.at(face))) < 0.03
    assert (grid.known & (grid.height > 0.1)).sum() < 5


@pytest.mark.long
def test_a_walk_without_sight_keeps_the_map_true() -> None:
    """Up a slope: the rise of steps that no cloud shows is in the map."""
    terrain = terrain_named("slope_up", seed=5)
    loop = ClosedLoop("g1", seed=5, terrain=terrain, terrain_map=True, record=False)
    view, area, ground = loop.ground_view, Area(loop.robot, 0.04), Ground(terrain)
    loop.command("walk")
    loop.set_velocity(0.3, 0.0, 0.0)
    loop.run(3.0)
    for duration in (1.0, 1.4, 1.8):  # either foot stands when it sees again
        view.blind = True
        loop.run(0.1)  # clouds on their way
        clouds = len(view.delays)
        loop.run(duration)
        assert len(view.delays) == clouds
        view.blind = False
        loop.run(0.05)  # the first cloud cannot replace a height
        seen = score(loop, ground, area)
        assert 1 <= len(view.delays) - clouds <= 2 and np.isfinite(seen).mean() > 0.9
        assert np.sqrt(np.nanmean(seen**2)) < 0.015
        loop.run(0.5)
    assert not loop.fallen and np.sqrt(np.nanmean(score(loop, ground, area) ** 2)) < 0.01
