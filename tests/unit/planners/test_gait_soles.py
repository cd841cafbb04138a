"""Soles of the gait: where a foot is expected to land, which planted soles are followed, when standing is lost."""

import math

import numpy as np
import pytest
from msgspec import structs
from scipy.spatial import Delaunay

from models.config import default_config
from models.robot_model import RobotModel
from planners.gait.config import GaitConfig
from planners.gait.contact import Soles, SoleState
from planners.gait.footsteps import Foothold
from planners.gait.measurement import Measurement
from planners.gait.route import Footstep
from planners.gait.state import GaitPhase
from planners.gait.tread import Tread
from tests.gaits import DT, caught, in_single_support
from tests.support import standing

CONFIG = default_config(GaitConfig, "planners", "gait")


def measured(
    left_z: float = 0.0,
    right_z: float = 0.0,
    loads: tuple[float, float] = (0.5, 0.5),
    tilt: tuple[float, float] = (0.0, 0.0),
) -> Measurement:
    still, flat = np.zeros((2, 2)), np.zeros(3)
    soles = Foothold(0.0, 0.1, 0.0, left_z), Foothold(0.0, -0.1, 0.0, right_z)
    forces = np.array([(0.0, 0.0, load) for load in loads])
    return Measurement(flat, flat, soles, np.array([tilt, tilt]), still, still, loads, (True, True), forces)


@pytest.fixture(scope="module")
def law() -> Soles:
    return Soles(RobotModel.load("g1"), CONFIG)


@pytest.fixture
def soles(law: Soles) -> SoleState:
    return law.planted(measured())


@pytest.mark.parametrize("drift", [0.0, 0.003])
def test_errors_of_known_heights_do_not_come_back_with_later_plans(law: Soles, soles: SoleState, drift: float) -> None:
    """On level ground whose estimated height drifts with each step; every plan begins two footsteps later."""
    levels, errors = [0.02, 0.0], []  # known heights of the next footsteps; the first one is wrong [m]
    for i in range(30):
        foot, before, now = i % 2, drift * (i - 1), drift * i
        soles = structs.replace(soles, landing=Footstep(foot, Foothold(0.0, 0.0, 0.0, levels.pop(0)), Tread()))
        errors.append(before + soles.landing.hold.z - soles.levels[1 - foot] - now)
        soles = law.landed(soles, foot, measured(now, before) if foot == 0 else measured(before, now))
        levels.append(soles.levels[foot])  # as high as this sole
    assert errors[0] == pytest.approx(0.02, abs=drift + 1e-9)
    assert np.abs(errors[-6:]).max() < 0.001 + 3.0 * drift


@pytest.mark.parametrize(("height", "rough"), [(0.004, 0.0), (0.04, 0.03), (-0.04, 0.03), (0.3, 0.05)])
def test_ground_is_rough_where_a_foot_lands_off_its_height(
    law: Soles, soles: SoleState, height: float, rough: float
) -> None:
    assert (CONFIG.ground.even, CONFIG.ground.rough_max) == (0.01, 0.05)
    soles = law.landed(soles, 0, measured(left_z=height))
    assert soles.roughness == pytest.approx(rough)
    for _ in range(round(3 * CONFIG.ground.rough_steps)):
        soles = law.landed(soles, 1, measured())
    assert soles.roughness < 0.06 * rough + 1e-9


def test_a_foot_that_is_caught_goes_higher_at_once_and_so_do_the_next(g1: RobotModel) -> None:
    planner = in_single_support(g1)
    lifted, level = planner.state.swing.clearance, planner.state.pace.clearance
    while planner.trips == 0:
        planner.step(caught(planner), DT)
    trip = CONFIG.ground.rough_trip
    assert planner.state.swing.clearance == pytest.approx(lifted + trip)
    planner.step(standing(g1), DT)
    assert planner.state.pace.clearance == pytest.approx(level + trip, abs=0.002)


@pytest.mark.parametrize(("aside", "up"), [(0.0, 0.0), (1.0, 1.1)])
def test_a_foot_that_only_lags_or_has_ground_under_it_has_not_tripped(g1: RobotModel, aside: float, up: float) -> None:
    """In shares of the force of a foot that is caught."""
    planner, lags = in_single_support(g1), [0.0]
    while planner.state.elapsed < 0.4 * planner.state.step.time:
        state = caught(planner)
        lags.append(
            math.dist(planner.state.swing.position[:2], planner.state.measured.soles[1 - planner.stance].place[:2])
        )
        force = state.contacts[1 - planner.stance].wrench
        force[2] = up * np.linalg.norm(force[:2])
        force[:2] *= aside
        planner.step(state, DT)
    assert max(lags) > 2.0 * CONFIG.swing.trip_lag
    assert planner.trips == 0 and planner.phase is GaitPhase.SINGLE


def test_a_foot_is_expected_to_land_in_the_slope_of_the_last_soles(law: Soles, soles: SoleState) -> None:
    inclined = measured(right_z=0.2, tilt=(0.1, -0.05))
    for i in range(CONFIG.ground.slope_steps):
        assert bool(soles.slope[0] > 0.05) is (i > CONFIG.ground.slope_steps // 2)
        soles = law.landed(soles, i % 2, inclined)
    assert soles.slope == pytest.approx([0.1, -0.05])
    level = structs.replace(soles, holds=(Foothold(0.2, 0.1, 0.0), soles.holds[1]))
    assert law.landing_height(level, 0, inclined) == pytest.approx(0.2 + 0.2 * 0.1 - 0.2 * 0.05)
    for _ in range(3):
        soles = law.landed(soles, 0, measured(tilt=(5.0, 0.0)))
    assert soles.slope[0] == CONFIG.ground.slope_max


def test_one_sole_on_an_edge_is_no_slope(law: Soles, soles: SoleState) -> None:
    for i, tilt in enumerate((0.0, 0.2, 0.01, 0.0)):
        soles = law.landed(soles, i % 2, measured(tilt=(tilt, 0.0)))
        assert soles.slope[0] <= 0.01


def test_the_stance_sole_counts_for_the_slope_before_the_next_landing(law: Soles, soles: SoleState) -> None:
    inclined = measured(tilt=(-0.1, 0.0))
    assert not law.standing_on(soles, 1, inclined).slope.any()  # one sole may lie on an edge
    landed = law.landed(soles, 0, inclined)
    after = law.standing_on(landed, 0, inclined)
    assert after.slope == pytest.approx([-0.1, 0.0])
    assert after.samples is landed.samples  # it counts once, at the landing


def test_a_sole_on_an_edge_does_not_count_for_the_slope(law: Soles, soles: SoleState) -> None:
    for _ in range(CONFIG.ground.slope_steps):
        soles = law.landed(soles, 0, measured(tilt=(0.2, 0.0)), flat=False)
    assert not soles.slope.any()


def test_a_sole_that_has_just_landed_lies_down_and_one_that_tips_does_not(law: Soles, soles: SoleState) -> None:
    tipped = measured(loads=(0.5, 0.5), tilt=(0.1, 0.0))
    after, _ = law.followed(soles, tipped, None, 0, CONFIG.ground.settle_time)
    assert after.tilts[0] == pytest.approx([0.1, 0.0])
    assert after.tilts[1, 0] == pytest.approx(0.1 * CONFIG.ground.settle_time / CONFIG.anchor_time)
    assert not soles.tilts.any()  # the state before is left alone


def test_only_planted_soles_that_bear_are_followed(law: Soles, soles: SoleState) -> None:
    moved = measured(left_z=0.01, right_z=0.01)
    soles, _ = law.followed(soles, moved, 0, None, CONFIG.anchor_time)
    assert [hold.z for hold in soles.holds] == [0.0, 0.01]
    light = measured(left_z=0.01, loads=(0.5 * CONFIG.anchor_load, 1.0))
    assert law.followed(soles, light, None, None, CONFIG.anchor_time)[0].holds[0].z == 0.0


def test_standing_is_lost_near_the_edge_of_the_hull_of_both_soles(law: Soles, soles: SoleState) -> None:
    middle = law.middle(soles.holds)
    x_edge = float(law.half[0, 0]) * CONFIG.step_share
    y_edge = (0.1 + float(law.half[0, 1])) * CONFIG.step_share
    for edge, lost in ((-1e-3, False), (1e-3, True)):
        assert law.beyond_standing(soles.holds, middle + np.array([x_edge + edge, 0.0])) is lost
        assert law.beyond_standing(soles.holds, middle + np.array([0.0, y_edge + edge])) is lost


@pytest.mark.parametrize("seed", range(5))
def test_standing_support_is_the_hull_of_both_soles(law: Soles, seed: int) -> None:
    rng, yaw = np.random.default_rng(seed), 0.4 * seed
    holds = tuple(Foothold(*rng.uniform(-0.3, 0.3, 2), yaw) for _ in range(2))
    rows = [
        hold.moved(*(law.centres[foot] + law.half[foot] * (x, y)))
        for foot, hold in enumerate(holds)
        for x in (-1.0, 1.0)
        for y in (-1.0, 1.0)
    ]
    hull = Delaunay(np.array(rows))
    for dcm in rng.uniform(-0.5, 0.5, (200, 2)):
        places, half = law.standing_support(holds, dcm)
        inside = all(place < extent for place, extent in zip(places, half, strict=True))
        assert inside == (hull.find_simplex(dcm) >= 0)


def test_beside_the_line_between_feet_apart_standing_is_lost(law: Soles) -> None:
    holds = Foothold(0.2, 0.1, 0.0), Foothold(-0.2, -0.1, 0.0)
    middle, (length, width) = law.middle(holds), law.half[0]
    ahead_of_the_rear_foot = law.point_of(1, holds[1]) - law.points[1] + law.centres[1] + np.array((length, -width))
    corner_of_the_box = middle + np.array((0.2 + length, -0.1 - width))
    for edge, beyond in ((ahead_of_the_rear_foot, False), (corner_of_the_box, True)):
        assert law.beyond_standing(holds, middle + 0.99 * CONFIG.step_share * (edge - middle)) is beyond


def test_the_weight_is_shared_by_the_place_of_the_zmp(law: Soles, soles: SoleState) -> None:
    left, right = (law.point_of(foot, soles.holds[foot]) for foot in range(2))
    assert law.shares(soles.holds, left) == pytest.approx((1.0, 0.0))
    assert law.shares(soles.holds, 0.75 * left + 0.25 * right) == pytest.approx((0.75, 0.25))
    assert law.shares(soles.holds, right + (right - left)) == pytest.approx((0.0, 1.0))


def test_the_zmp_of_single_support_is_between_the_ankle_and_the_middle_of_the_sole(law: Soles) -> None:
    assert law.points == pytest.approx(CONFIG.zmp * law.centres)
    assert law.point_of(0, Foothold(1.0, 2.0, 0.0)) == pytest.approx([1.0 + law.points[0, 0], 2.0])


@pytest.mark.parametrize(("aside", "lands"), [(0.0, True), (0.9, True), (1.1, False), (2.5, False)])
def test_a_force_from_aside_is_no_landing(g1: RobotModel, aside: float, lands: bool) -> None:
    """The riser of a step pushes a foot that meets it back, and by friction up."""
    planner = in_single_support(g1)
    while planner.state.elapsed < 0.7 * planner.state.step.time:
        planner.step(standing(g1, shares=(0.0, 1.0)), DT)
    state = standing(g1, shares=(0.1, 0.9))
    state.contacts[0].wrench[0] = -aside * state.contacts[0].wrench[2]
    planner.step(state, DT)
    assert planner.steps == int(lands)
