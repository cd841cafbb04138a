"""Two robots walk in one world, each by its own laws: apart, seeing each other, bumping into each other."""

import numpy as np
import pytest

from bridge.plants.world import Place
from bridge.shared_world import SharedWorld
from models.errors import ConfigError
from models.types import Mode


def _walk(shared: SharedWorld, velocities: dict[str, tuple[float, float, float]], seconds: float) -> dict[str, float]:
    """Have them walk at once; returns how far each went."""
    start = {name: shared[name].truth.q[:2].copy() for name in velocities}
    for name in velocities:
        assert shared[name].command("walk").accepted
    for name, velocity in velocities.items():
        shared[name].set_velocity(*velocity)
    shared.run(seconds)
    for name in velocities:
        loop = shared[name]
        assert not loop.fallen, f"{name}: {loop.fall_reason}"
        assert loop.mode is Mode.WALK
    return {name: float(np.linalg.norm(shared[name].truth.q[:2] - start[name])) for name in velocities}


@pytest.mark.long
def test_two_stand_and_walk_and_only_the_commanded_one_moves() -> None:
    shared = SharedWorld({"robot_1": "g1", "robot_2": "g1"}, seed=1, record=False)
    first, second = shared["robot_1"], shared["robot_2"]
    assert first.t == second.t  # each has started alone, while the other stood still
    shared.run(0.5)
    assert first.mode is second.mode is Mode.STAND
    still = second.truth.q[:2].copy()
    way = _walk(shared, {"robot_1": (0.4, 0.0, 0.0)}, 3.0)
    assert way["robot_1"] > 0.6
    assert np.linalg.norm(second.truth.q[:2] - still) < 0.01
    assert second.mode is Mode.STAND and second.foot_slip.max() < 0.001
    with pytest.raises(ConfigError, match="unknown robot 'robot_3'; known: robot_1, robot_2"):
        shared["robot_3"]


def test_the_same_arguments_and_calls_give_the_same_run() -> None:
    def run() -> list[np.ndarray]:
        shared = SharedWorld({"a": "g1", "b": "g1"}, seed=7, record=False)
        shared["b"].apply_push((30.0, 0.0, 0.0), 0.1)
        shared.run(0.3)
        return [loop.truth.q for loop in shared.loops.values()]

    first, second = run(), run()
    np.testing.assert_array_equal(first, second)
    assert np.abs(first[0][7:] - first[1][7:]).max() > 1e-4  # another seed and a push


@pytest.mark.slow
@pytest.mark.parametrize("other", ["g1", "talos"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_both_walk_more_than_two_metres_at_velocities_of_their_own(other: str, seed: int) -> None:
    shared = SharedWorld({"robot_1": "g1", "robot_2": other}, seed=seed, record=False)
    way = _walk(shared, {"robot_1": (0.4, 0.0, 0.0), "robot_2": (0.3, 0.0, 0.1)}, 9.0)
    assert way["robot_1"] > 3.0 and way["robot_2"] > 2.0
    for loop in shared.loops.values():
        assert loop.command("stop").accepted
    shared.run(3.0)
    for loop in shared.loops.values():
        assert loop.mode is Mode.STAND and not loop.fallen


@pytest.mark.long
def test_one_stops_before_the_other() -> None:
    places = {"robot_2": Place(1.4, 0.0, np.pi)}
    shared = SharedWorld({"robot_1": "g1", "robot_2": "g1"}, places, seed=3, obstacle_stop=True, record=False)
    first, second = shared["robot_1"], shared["robot_2"]
    shared.run(0.2)
    assert first.command("forward").accepted
    shared.run(6.0)
    assert not first.fallen and not second.fallen
    assert any("obstacle stop: " in text and "free" not in text for _, text in first.events)
    assert not first.gait.walking
    gap = float(np.linalg.norm(first.truth.q[:2] - second.truth.q[:2]))
    assert 0.4 < gap < 1.2
    assert not shared.world.touching("robot_1")


@pytest.mark.long
def test_without_the_scanner_they_meet() -> None:
    """The one that stands feels it: bodies in one world are no ghosts to each other."""
    places = {"robot_2": Place(1.0, 0.0, np.pi)}
    shared = SharedWorld({"robot_1": "g1", "robot_2": "g1"}, places, seed=3, record=False)
    first, second = shared["robot_1"], shared["robot_2"]
    assert first.command("forward").accepted
    moved = 0.0
    for _ in range(4000):
        shared.step()
        if shared.world.touching("robot_1"):
            moved = max(moved, float(np.linalg.norm(second.truth.v[:3])))
        if moved > 0.05:
            break
    assert moved > 0.05
