"""Walking over ground that the laws have no data of: estimator on, sensor noise on, 2 ms delay."""

import numpy as np
import pytest

from bridge.closed_loop import ClosedLoop
from models.terrain import Terrain, terrain_named


@pytest.mark.long
@pytest.mark.parametrize(("ground", "seed"), [("slope_across", 0), ("tiles", 9)])
def test_walks_blindly(ground: str, seed: int) -> None:
    loop = ClosedLoop("g1", seed=seed, record=False, terrain=terrain_named(ground, seed=seed))
    loop.command("walk")
    loop.set_velocity(0.3, 0.0, 0.0)
    loop.run(6.5)
    assert not loop.fallen
    assert loop.truth.q[0] > 1.4
    if ground == "slope_across":
        assert loop.gait.state.soles.slope == pytest.approx([0.0, np.tan(0.1396)], abs=0.03)


@pytest.mark.long
@pytest.mark.parametrize("seed", [702, 716, 720])
def test_a_foot_that_is_caught_by_a_tile_draws_back_and_steps_onto_it(seed: int) -> None:
    ground = Terrain(kind="tiles", height=0.08, size=0.4, seed=seed)
    loop = ClosedLoop("g1", seed=seed, record=False, terrain=ground)
    loop.command("walk")
    loop.set_velocity(0.3, 0.0, 0.0)
    loop.run(5.0)
    assert not loop.fallen
    assert loop.gait.trips > 0
    assert loop.truth.q[0] > 0.8  # beyond the first edge, at 0.4 m
