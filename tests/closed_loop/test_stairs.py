"""Known stairs in the loop, without eyes. Estimator on, sensor noise on, 2 ms delay."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.stability.stairs import climb, walk_on_sight
from bridge.closed_loop import ClosedLoop
from models.terrain import Terrain
from planners.gait.footsteps import Foothold, middle, side_of
from planners.gait.route import Footstep
from planners.gait.state import GaitPhase
from planners.gait.tread import Tread
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


@pytest.mark.long
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


@pytest.mark.long
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


def seeing(rise: float, seed: int, **terrain: Any) -> ClosedLoop:
    """A robot that maps the stairs a metre ahead of it."""
    ground = Terrain(kind="stairs", height=rise, size=TREAD, patch=1.0, **terrain)
    loop = ClosedLoop("g1", seed=seed, terrain=ground, terrain_map=True)
    assert loop.command("walk").accepted
    return loop


@pytest.mark.long
def test_it_climbs_and_descends_what_it_sees_without_a_stop() -> None:
    loop = seeing(0.15, 21, count=2, landing=0.6)
    base, begin = float(loop.truth.q[2]), loop.t
    way = 1.0 + 2 * TREAD + 0.6
    route = walk_on_sight(loop, way + 0.4)
    assert route.outcome == "done" and not loop.fallen
    assert loop.truth.q[0] > way and loop.truth.q[2] == pytest.approx(base, abs=0.03)
    assert route.plans > 8  # most of them on the way
    steps = loop.gait.steps
    assert loop.t - begin < 3.0 + 0.75 * steps  # it looked once, and was at rest at the beginning and the end only


@pytest.mark.long
def test_in_front_of_a_riser_that_is_too_high_it_stands_and_says_so() -> None:
    loop = seeing(0.3, 22, count=1)
    route = walk_on_sight(loop, 3.0)
    assert "m higher, at most 0.20 m" in route.outcome
    assert not loop.fallen and loop.gait.settled
    soles = [float(loop.data.site_xpos[site][0]) for site in loop.plant.mujoco.sole_sites]
    toe = loop.robot.feet[0].rectangle[1]
    assert 0.6 < max(soles) + toe < 1.0 - loop.gait.config.swing.edge + 0.02
    assert abs(soles[0] - soles[1]) < 0.06


@pytest.mark.long
@pytest.mark.parametrize("robot", ["g1", "talos"])
def test_a_beam_that_it_sees_is_stepped_over_without_a_touch(robot: str) -> None:
    case = climb(robot, 24, "seen_beam")
    assert case["survived"] and case["trips"] == 0, case["reason"]


@pytest.mark.long
@pytest.mark.parametrize("other", ["stop", "velocity", "goal"])
def test_a_foot_on_its_way_over_something_gets_there_whatever_is_commanded(other: str) -> None:
    loop = ClosedLoop("g1", seed=26)
    assert loop.command("walk").accepted
    loop.run(0.2)
    here = middle(loop.gait.footholds)
    steps = [Footstep(i, Foothold(*here.moved(0.4, side_of(i) * 0.1), here.yaw), Tread(over=0.12)) for i in (0, 1)]
    loop.gait.take_steps(steps)
    while not (loop.gait.phase is GaitPhase.SINGLE and loop.gait.state.elapsed > 0.2):
        loop.run(0.002)
    if other == "stop":
        assert loop.command("stop").accepted
    elif other == "velocity":
        loop.set_velocity(0.2, 0.0, 0.0)
    else:
        loop.gait.walk_to(Foothold(*here.moved(0.6, 0.0), here.yaw))
    count = loop.gait.steps
    while loop.gait.steps == count:
        loop.run(0.002)
        assert not loop.fallen
    assert loop.gait.footholds[0].x - here.x == pytest.approx(0.4, abs=0.03)
    loop.run(3.0)
    assert not loop.fallen


@pytest.mark.long
def test_it_crosses_stones_on_a_map_that_it_is_given() -> None:
    case = climb("g1", 25, "given_stones")
    assert case["survived"], case["reason"]


@pytest.mark.long
@pytest.mark.parametrize(
    ("scenario", "seed"), [("seen_high", 23), ("seen_shift", 23), ("seen_appears", 23), ("seen_ahead", 662)]
)
def test_with_a_fault_of_its_sight_it_does_not_fall(scenario: str, seed: int) -> None:
    case = climb("g1", seed, scenario)
    assert case["survived"], case["reason"]


@pytest.mark.long
@pytest.mark.parametrize("scenario", ["seen_15", "seen_stones"])
def test_talos_climbs_stairs_and_crosses_stones_that_it_sees(scenario: str) -> None:
    case = climb("talos", 300, scenario)
    assert case["survived"], case["reason"]
