"""Slippery ground that no law expects, and slippery ground that is expected."""

import pytest

from bridge.closed_loop import ClosedLoop
from models.terrain import Terrain


@pytest.mark.long
def test_a_walk_over_slippery_ground_feels_its_friction() -> None:
    loop = ClosedLoop("g1", seed=1, record=False, friction=0.25)
    assert loop.command("walk").accepted
    loop.set_velocity(0.3, 0.0, 0.0)
    loop.run(8.0)
    assert not loop.fallen
    assert loop.truth.q[0] > 1.6
    assert 0.17 < loop.state.friction < 0.35
    assert loop.estimator.health.friction == loop.state.friction


@pytest.mark.long
def test_soles_that_turn_over_edges_show_no_slippery_ground() -> None:
    loop = ClosedLoop("g1", seed=719, record=False, terrain=Terrain("tiles", height=0.05, seed=719))
    assert loop.command("walk").accepted
    loop.set_velocity(0.3, 0.0, 0.0)
    loop.run(6.0)
    assert not loop.fallen
    assert loop.truth.q[0] > 0.7  # over two edges
    assert loop.state.friction > 0.7


def test_a_robot_that_expects_slippery_ground_begins_with_short_quick_steps() -> None:
    loop = ClosedLoop("g1", seed=2, record=False, friction=0.2, expected_friction=0.2)
    assert loop.command("walk").accepted
    loop.set_velocity(0.4, 0.0, 0.0)
    loop.run(3.0)
    assert not loop.fallen
    assert loop.gait.state.pace.share > 0.99
    assert loop.gait.state.command.velocity[0] < 0.4
