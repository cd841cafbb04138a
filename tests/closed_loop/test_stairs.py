"""Known stairs in the loop, without eyes. Estimator on, sensor noise on, 2 ms delay."""

from types import SimpleNamespace

import numpy as np
import pytest

from bridge.closed_loop import ClosedLoop
from models.terrain import Terrain
from planners.gait.footsteps import middle
from planners.gait.state import GaitPhase
from planners.terrain.stairs import Stairs, stair_footsteps
from tests.support import run_until_still

RISE, TREAD, LANDING = 0.10, 0.30, 0.6  # [m]


def on_stairs(count: int, seed: int) -> tuple[ClosedLoop, int]:
    """A robot on its way over stairs, and how many footsteps it was given."""
    terrain = Terrain(kind="stairs", height=RISE, size=TREAD, count=count, landing=LANDING)
    loop = ClosedLoop("g1", seed=seed, terrain=terrain)
    assert loop.command("walk").accepted
    loop.run(0.2)
    here = middle(loop.gait.footholds)
    stairs = Stairs(terrain.patch - here.x, RISE, TREAD, count, LANDING, 2.0 * terrain.width)
    steps = stair_footsteps(stairs, here, loop.robot, loop.gait.config)
    loop.gait.take_steps(steps)
    return loop, len(steps)


def test_a_base_over_the_upper_tread_has_not_fallen_while_the_soles_are_below(monkeypatch: pytest.MonkeyPatch) -> None:
    loop = ClosedLoop("g1", record=False)
    for width, fallen in ((0.03, False), (1.0, True)):
        tread = SimpleNamespace(height=lambda _, y, width=width: 0.4 if abs(y) < width else 0.0)
        monkeypatch.setattr(loop.plant, "ground", tread)
        loop.run(0.01)
        assert loop.fallen is fallen


def test_it_climbs_three_steps_and_descends_them_along_known_footsteps() -> None:
    loop, count = on_stairs(3, seed=4)
    base, crouch = float(loop.truth.q[2]), loop.gait.route.crouch
    run_until_still(loop, 14.0)
    assert loop.gait.route.outcome == "done" and loop.gait.steps == count
    assert loop.gait.trips == 0
    assert loop.truth.q[0] > 0.4 + 4 * TREAD + LANDING  # on the level behind the stairs
    assert loop.truth.q[2] == pytest.approx(base, abs=0.03)
    assert loop.log.true_q[:, 2].max() == pytest.approx(base + 3 * RISE - crouch, abs=0.03)  # it was on the landing
    tilts = np.degrees(2.0 * np.arcsin(np.hypot(*loop.log.true_q[:, 3:5].T)))
    assert tilts.max() < 20.0


def test_stopped_on_the_way_up_it_lands_on_the_tread_and_stands_there() -> None:
    loop, _ = on_stairs(2, seed=5)
    while loop.gait.steps < 2 or loop.gait.phase is not GaitPhase.SINGLE:
        loop.run(0.01)
    loop.run(0.15)  # the foot is over the first riser
    assert loop.command("stop").accepted
    run_until_still(loop, 5.0)
    assert loop.gait.route.outcome == "stopped"
    for sole in loop.data.site_xpos[list(loop.plant.mujoco.sole_sites)]:
        assert sole[2] == pytest.approx(RISE, abs=0.01)
