"""Footsteps on a map: on the treads of stairs, on a slope, near unknown ground, and what stops in front of a wall."""

import math
import re
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from msgspec import structs

from models.config import default_config
from models.errors import UnreachableError
from models.robot_model import RobotModel
from planners.gait.footsteps import Foothold
from planners.gait.route import Footstep, check_footsteps, soles_at
from planners.gait.scaling import load_gait_config
from planners.terrain.detour import detour
from planners.terrain.elevation_map import Heights
from planners.terrain.footholds import GroundPlan, GroundPlanner, GroundQuery
from planners.terrain.ground_config import GroundConfig
from planners.terrain.ground_route import Request, answer_request
from planners.terrain.leg_extent import layer_at, leg_extent
from planners.terrain.mapper import TerrainMapper
from planners.terrain.survey import SoleSurvey

G1 = RobotModel.load("g1")
GAIT = load_gait_config(G1)
PLAN = default_config(GroundConfig, "planners", "ground").plan
START = Foothold(0.0, 0.0, 0.0)
X_MIN, X_MAX, Y_MIN, Y_MAX = G1.feet[0].rectangle


@pytest.fixture(scope="module")
def mapper() -> TerrainMapper:
    return TerrainMapper(G1)


def plan_on(
    mapper: TerrainMapper,
    height: Callable[[float, float], float],
    distance: float = 1.2,
    noise: float = 0.002,
    start: Foothold = START,
) -> GroundPlan:
    """Plan along x on a map of a function of x and y, NaN where unknown, with noise [m]."""
    grid = mapper.map
    grid.clear()
    grid.move_to(0.0, 0.0)
    axes = [(grid.origin[k] + np.arange(grid.cells) + 0.5) * grid.cell for k in (0, 1)]
    heights = np.array([[height(x, y) for y in axes[1]] for x in axes[0]])
    grid.height[:] = heights + noise * np.random.default_rng(2).standard_normal(heights.shape)
    grid.variance[:] = np.where(np.isnan(heights), np.inf, 4e-6)
    mapper.reference = 0.0
    query = GroundQuery(START, distance, soles_at(start, GAIT.reach.width))
    return GroundPlanner(G1, GAIT).plan(mapper.ground(), query)


def level(hold: Foothold) -> float:
    return round(hold.z, 2)


def in_turn(steps: list[Footstep]) -> bool:
    return all(first.foot != last.foot for first, last in pairwise(steps))


def test_on_stairs_every_sole_is_on_a_tread_and_the_feet_come_together(mapper: TerrainMapper) -> None:
    def stairs(x: float, _: float) -> float:
        return 0.15 * max(math.floor((x - 0.4) / 0.3) + 1, 0)

    steps, _ = plan_on(mapper, stairs)
    check_footsteps(steps, soles_at(START, GAIT.reach.width), GAIT)
    assert in_turn(steps) and steps[-1].hold.x > 1.0
    for step in steps:
        assert stairs(step.hold.x + X_MIN - 0.01, 0.0) == stairs(step.hold.x + X_MAX + 0.01, 0.0)
        assert step.hold.z == pytest.approx(stairs(step.hold.x, 0.0), abs=0.005)
    heights = [level(step.hold) for step in steps]
    assert heights[-2] == heights[-1] and sorted(heights) == heights
    assert all(heights.count(height) >= 2 for height in heights)  # both feet on each


def heights_of(height: Callable[[float, float], float]) -> Heights:
    """A function of x and y, NaN where unknown, from 1.5 m behind the origin to 1.5 m ahead."""
    axis = 0.02 * np.arange(-75, 75) + 0.01
    return Heights(np.array([[height(x, y) for y in axis] for x in axis]), (-1.5, -1.5), 0.02)


@pytest.fixture(scope="module")
def planner() -> GroundPlanner:
    return GroundPlanner(G1, GAIT)


def correction(planner: GroundPlanner, height: Callable[[float, float], float]) -> float:
    """By how much the feet lower the map [m]."""
    ground = heights_of(height)
    corrected = planner.corrected(ground, GroundQuery(START, 1.2, soles_at(START, GAIT.reach.width)))
    return float(np.nanmean(ground.values - corrected.values))


@pytest.mark.parametrize("error", [-0.03, 0.03, 0.045])
def test_an_error_of_the_map_is_that_of_the_ground_under_the_feet(planner: GroundPlanner, error: float) -> None:
    """Also close in front of a riser, on a slope, and where only level ground ahead is known."""
    assert correction(planner, lambda x, _: error + 0.15 * (x > 0.3)) == pytest.approx(error)
    assert correction(planner, lambda x, _: error + 0.15 * (x > X_MAX + 0.05)) == pytest.approx(error)
    assert correction(planner, lambda x, _: error + 0.1 * x) == pytest.approx(error, abs=2e-3)
    assert correction(planner, lambda x, _: math.nan if x < 0.3 else error) == pytest.approx(error)


def test_what_may_be_the_ground_is_no_error(planner: GroundPlanner) -> None:
    assert correction(planner, lambda x, _: math.nan if x < 0.3 else 0.08) == 0.0  # a kerb
    assert correction(planner, lambda x, _: math.nan if x < 0.2 else 0.1 * max(x - 0.3, 0.0)) == 0.0  # a ramp begins
    assert correction(planner, lambda x, _: math.nan if x < 0.6 else 0.03) == 0.0  # too little is known
    assert correction(planner, lambda _, y: 0.03 * (y > 0.0)) == 0.0  # under one foot alone
    assert correction(planner, lambda x, _: 0.05 * (x > 0.0)) == 0.0  # they stand half on an edge


@pytest.mark.parametrize("high", [0.1, 0.2, 0.5])
@pytest.mark.parametrize("begin", [0.1, 0.2, 0.35])
def test_what_appears_under_planned_footholds_is_no_error(planner: GroundPlanner, high: float, begin: float) -> None:
    feet = list(soles_at(START, GAIT.reach.width))
    steps = tuple(planner.plan(heights_of(lambda x, y: 0.0), GroundQuery(START, 1.2, (feet[0], feet[1]))).steps)
    for step in steps[:2]:
        feet[step.foot] = step.hold
    query = GroundQuery(START, 1.2, (feet[0], feet[1]), steps[2].foot, steps[2:])
    ground = planner.corrected(heights_of(lambda x, _: high * (x > begin)), query)
    assert np.nanmax(ground.values) == high and planner.blocked(ground, query)


@pytest.mark.parametrize("rise", [0.15, -0.15, -0.18])
def test_a_plan_does_not_end_on_a_tread_while_the_next_is_in_reach(robot: RobotModel, rise: float) -> None:
    """Whatever a step costs for its length, crouch and edges, it costs less than the way that it saves."""
    gait, toe = load_gait_config(robot), robot.feet[0].rectangle[1]
    middles = 0.02 * np.arange(-75, 75) + 0.01
    risers = np.maximum(np.floor((middles - toe - 0.05) / 0.3) + 1.0, 0.0)
    ground = Heights(np.repeat(rise * risers[:, None], 150, axis=1), (-1.5, -1.5), 0.02)
    query = GroundQuery(START, 2.0, soles_at(START, gait.reach.width))
    steps, why = GroundPlanner(robot, gait).plan(ground, query)
    assert why == "the ground ahead is not known, perhaps an edge"  # the map ends 1.5 m ahead
    assert [level(step.hold) for step in steps] == [round(rise * (1 + i // 2), 2) for i in range(8)]


@pytest.mark.parametrize(
    ("rise", "reason"), [(0.3, "0.30 m higher, at most 0.20 m"), (-0.4, "0.40 m lower, at most 0.20 m")]
)
def test_it_stops_in_front_of_what_it_cannot_step_on(mapper: TerrainMapper, rise: float, reason: str) -> None:
    steps, why = plan_on(mapper, lambda x, _: rise if x > 0.7 else 0.0)
    assert reason in why
    assert max(step.hold.x for step in steps) + X_MAX + GAIT.swing.edge <= 0.7 + 0.02
    assert steps[-1].hold.x == pytest.approx(steps[-2].hold.x, abs=0.04) and in_turn(steps)
    assert all(level(step.hold) == 0.0 for step in steps)


def test_a_trench_that_no_sole_fits_into_is_stepped_over(mapper: TerrainMapper) -> None:
    steps, why = plan_on(mapper, lambda x, _: -0.5 if 0.5 < x < 0.6 else 0.0)
    assert why == "" and steps[-1].hold.x > 1.0
    for step in steps:
        assert step.hold.x + X_MAX < 0.5 or step.hold.x + X_MIN > 0.6


@pytest.mark.parametrize("high", [0.08, 0.11])
def test_a_beam_is_stepped_over_with_both_feet_beside_each_other(mapper: TerrainMapper, high: float) -> None:
    steps, reason = plan_on(mapper, lambda x, _: high * (0.5 <= x < 0.6), distance=1.0)
    assert not reason and in_turn(steps)
    over = [i for i, step in enumerate(steps) if step.tread is not None and step.tread.over > 0.0]
    assert len(over) == 2 and over[1] == over[0] + 1
    for step in steps:
        assert step.hold.x + X_MAX < 0.5 - GAIT.swing.edge + 0.02 or step.hold.x + X_MIN > 0.6 + GAIT.swing.edge - 0.02
    for i in over:
        tread = steps[i].tread
        assert tread is not None and tread.over == pytest.approx(high, abs=0.01)
    before, after = ([steps[i].hold.x for i in pair] for pair in ((over[0] - 2, over[0] - 1), over))
    assert abs(before[1] - before[0]) <= 0.1 + 1e-9 and abs(after[1] - after[0]) <= 0.1 + 1e-9


def test_a_foot_whose_toe_is_at_a_beam_does_not_step_over_it(mapper: TerrainMapper) -> None:
    steps, _ = plan_on(mapper, lambda x, _: 0.1 * (X_MAX + 0.01 <= x < X_MAX + 0.11), distance=1.0)
    assert not steps
    steps, _ = plan_on(mapper, lambda x, _: 0.1 * (X_MAX + 0.06 <= x < X_MAX + 0.16), distance=1.0)
    assert steps


def test_talos_steps_over_what_its_level_swing_does_not_clear(talos: RobotModel) -> None:
    gait = load_gait_config(talos)
    middles = 0.02 * np.arange(-75, 75) + 0.01
    heights = np.repeat(0.05 * ((middles > 0.5) & (middles < 0.6))[:, None], 150, axis=1)
    ground = Heights(heights, (-1.5, -1.5), 0.02)
    query = GroundQuery(START, 1.2, soles_at(START, gait.reach.width))
    planner = GroundPlanner(talos, gait)
    plan = planner.plan(ground, query)
    assert [step.tread.over for step in plan.steps if step.tread and step.tread.over] == pytest.approx([0.05, 0.05])
    assert not planner.blocked(ground, structs.replace(query, planned=tuple(plan.steps)))


def test_a_beam_that_is_too_high_to_step_over_ends_the_plan(mapper: TerrainMapper) -> None:
    steps, reason = plan_on(mapper, lambda x, _: 0.19 * (0.5 <= x < 0.6), distance=1.0)
    assert all(step.hold.x + X_MAX < 0.5 for step in steps)
    assert re.fullmatch(
        r"no room for a sole up to 0.55 m ahead, and it is 0.1\d m higher, at most 0.12 m to step over", reason
    )


def test_near_the_feet_unknown_ground_is_felt_and_beyond_what_is_seen_it_ends_the_plan(mapper: TerrainMapper) -> None:
    steps, why = plan_on(mapper, lambda x, _: 0.0 if 0.4 < x < 1.0 else math.nan)
    felt = [step.tread is None for step in steps]
    assert felt[0] and not felt[-1] and felt == sorted(felt, reverse=True)
    assert why == "the ground ahead is not known, perhaps an edge" and steps[-1].hold.x + X_MAX < 1.0


def test_where_nothing_at_all_is_known_a_plan_says_so(robot: RobotModel) -> None:
    gait = load_gait_config(robot)
    dark = Heights(np.full((150, 150), np.nan), (-1.5, -1.5), 0.02)
    steps, reason = GroundPlanner(robot, gait).plan(dark, GroundQuery(START, 2.0, soles_at(START, gait.reach.width)))
    assert reason == "the ground ahead is not known, perhaps an edge"
    assert steps and all(step.tread is None for step in steps)  # felt


def test_no_step_is_felt_towards_a_wall(mapper: TerrainMapper) -> None:
    steps, why = plan_on(mapper, lambda x, _: 0.3 if x > 0.55 else math.nan)
    assert "higher" in why and all(step.hold.x + X_MAX < 0.55 for step in steps)


def test_soles_take_the_slope_of_the_ground(mapper: TerrainMapper) -> None:
    steps, why = plan_on(mapper, lambda x, y: 0.1 * x - 0.05 * y)
    assert why == "" and steps[-1].hold.x == pytest.approx(1.2, abs=0.02)
    for step in steps:
        assert step.tread is not None and step.tread.slope == pytest.approx((0.1, -0.05), abs=0.03)
        assert step.hold.z == pytest.approx(0.1 * step.hold.x - 0.05 * step.hold.y, abs=0.004)


def stones(x: float, y: float) -> float:
    """Squares of 30 cm in rows 45 cm apart, from 0.55 on, the middle ones around the x axis; a pit between them."""
    return 0.0 if x < 0.4 or ((x - 0.55) % 0.45 < 0.3 and (y + 0.15) % 0.45 < 0.3) else -0.5


@pytest.mark.parametrize("aside", [-0.04, 0.0, 0.05])
def test_on_stones_it_comes_back_to_its_line_and_ends_side_by_side(mapper: TerrainMapper, aside: float) -> None:
    """A plan that takes what is nearest step by step loses the stones after some of them, or ends astride a gap."""
    steps, why = plan_on(mapper, stones, start=Foothold(0.0, aside, 0.0))
    left, right = sorted((step.hold for step in steps[-2:]), key=lambda hold: -hold.y)
    assert why == "" or left.x > 0.9, why
    assert abs(left.x - right.x) <= 0.03 and left.y - right.y == pytest.approx(GAIT.reach.width, abs=0.08)
    for step in steps:
        for x, y in [(step.hold.x + x, step.hold.y + y) for x in (X_MIN, X_MAX) for y in (Y_MIN, Y_MAX)]:
            assert stones(x, y) == 0.0


@pytest.mark.parametrize("pole", [False, True])
def test_wide_soles_cross_stones_in_two_columns_unless_something_high_stands_there(pole: bool) -> None:
    """Both feet of TALOS do not fit on a stone; columns differ by 5 cm. The body might not pass beside a pole."""
    talos = RobotModel.load("talos")
    gait, (x_min, x_max, y_min, y_max) = load_gait_config(talos), talos.feet[0].rectangle

    def height(x: float, y: float) -> float:
        if pole and 0.6 < x < 0.64 and abs(y) < 0.03:
            return 0.6
        return stones(x, y) + (0.05 if x > 0.4 and (y + 0.15) % 0.9 > 0.45 else 0.0)

    middles = 0.02 * np.arange(-75, 75) + 0.01
    ground = Heights(np.array([[height(x, y) for y in middles] for x in middles]), (-1.5, -1.5), 0.02)
    steps, _ = GroundPlanner(talos, gait).plan(ground, GroundQuery(START, 2.0, soles_at(START, gait.reach.width)))
    farthest = max(step.hold.x for step in steps)
    assert farthest < 0.4 if pole else farthest > 1.0
    for step in steps:
        for x, y in [(step.hold.x + x, step.hold.y + y) for x in (x_min, x_max) for y in (y_min, y_max)]:
            assert stones(x, y) == 0.0 and step.hold.z == pytest.approx(height(x, y), abs=0.005)


def test_soles_keep_away_from_the_riser_that_shin_or_heel_may_meet(mapper: TerrainMapper) -> None:
    """And steps down are no longer than a tread: farther ones take the rear ankle to its stop."""
    for sign in (1.0, -1.0):
        steps, _ = plan_on(mapper, lambda x, _, s=sign: s * 0.15 * max(math.floor((x - 0.4) / 0.3) + 1, 0))
        on_treads = [(step.hold.x - 0.4) % 0.3 for step in steps if 0.4 < step.hold.x < 1.0]
        for place in on_treads:
            wall = 0.3 - place - X_MAX if sign > 0.0 else place + X_MIN
            assert wall > 0.045 and 0.13 - wall > GAIT.swing.edge
        assert len(on_treads) >= 4
        for before, after in pairwise(steps):
            if abs(after.hold.z - before.hold.z) > 0.1:
                assert after.hold.x - before.hold.x <= 0.3


def boxed(high: float, face: float, side: float = -2.0) -> Heights:
    """Level ground with a box of a height from x = ``face`` on, to the left of y = ``side`` [m]."""
    middles = 0.02 * np.arange(-75, 75) + 0.01
    return Heights(np.where((middles[:, None] > face) & (middles > side), high, 0.0), (-1.5, -1.5), 0.02)


@pytest.mark.parametrize("high", [0.10, 0.30, 0.50])
@pytest.mark.parametrize("side", [-2.0, 0.02])
def test_a_sole_does_not_fit_where_its_leg_would_be_in_a_box(robot: RobotModel, high: float, side: float) -> None:
    """Above the shin the leg reaches farther ahead than the sole does; the box may be ahead of a part of its width."""
    gait, (_, toe, *_) = load_gait_config(robot), robot.feet[0].rectangle
    ways, face = 0.01 * np.arange(70), 0.7
    fits = SoleSurvey(robot, gait, PLAN.sole).survey(boxed(high, face, side), START, ways, np.zeros(1)).fits[:, 0] == 1
    extent = leg_extent(robot, gait.pace.fast.crouch)
    ahead = max(extent[layer_at(high, len(extent)), 1], toe + gait.swing.edge)
    last = ways[np.flatnonzero(fits)[-1]]
    assert fits[ways <= last].all() and face - ahead - 0.03 < last <= face - ahead + 0.01
    assert (ahead > toe + 0.08) == (high > 0.2)


def test_a_plan_is_blocked_by_what_appears_where_its_legs_would_be(robot: RobotModel) -> None:
    planner, gait = GroundPlanner(robot, load_gait_config(robot)), load_gait_config(robot)
    query = GroundQuery(START, 0.6, soles_at(START, gait.reach.width))
    steps, _ = planner.plan(boxed(0.0, 1.0), query)
    end = max(step.hold.x for step in steps)
    known = structs.replace(query, planned=tuple(steps))
    knee = leg_extent(robot, gait.pace.fast.crouch)[-1, 1]
    assert planner.blocked(boxed(0.5, end + knee - 0.06), known)
    assert not planner.blocked(boxed(0.5, end + knee + 0.02), known)


def test_the_extent_of_a_leg_is_that_of_its_links(robot: RobotModel) -> None:
    x_min, x_max, *_ = robot.feet[0].rectangle
    straight, bent = leg_extent(robot, 0.0), leg_extent(robot, 0.06)
    for extent in (straight, bent):
        assert extent[0].tolist() == [x_min, x_max]  # the sole alone
        assert (np.diff(extent[:, 0]) <= 0.0).all() and (np.diff(extent[:, 1]) >= 0.0).all()
    assert 0.04 < bent[-1, 1] - straight[-1, 1] < 0.12


def test_cells_on_an_edge_do_not_take_the_room_across() -> None:
    """A cell that is met half on a tread is lower by some centimetre: the sole may still be moved sideways to it."""
    heights = np.zeros((40, 60))  # a tread from x = 0.06 to 0.3
    heights[:4], heights[15], heights[15, :24], heights[15, 36:], heights[16:] = 0.15, -0.01, -0.018, -0.018, -0.15
    survey = SoleSurvey(G1, GAIT, PLAN.sole)
    ways, sides = np.arange(0.08, 0.2, 0.01), np.arange(-0.3, 0.31, 0.02)
    found = survey.survey(Heights(heights, (-0.02, -0.6), 0.02), START, ways, sides)
    fits = np.flatnonzero(found.fits[:, 15] == 1)
    assert ways[fits] == pytest.approx([0.15])  # X_MAX and the margin ahead of the edge
    assert found.room[fits, 15, 2:].min() >= 0.2
    assert (found.fits[ways > 0.155] == 0).all()  # beyond is no rough ground


@pytest.mark.parametrize(("begin", "height", "blocked"), [(0.9, 0.5, True), (1.6, 0.5, False), (0.9, 0.01, False)])
def test_a_plan_is_blocked_by_what_appears_on_its_way(
    mapper: TerrainMapper, begin: float, height: float, blocked: bool
) -> None:
    steps, _ = plan_on(mapper, lambda x, y: 0.0)
    plan_on(mapper, lambda x, y: height if begin < x < begin + 0.15 else 0.0)
    query = GroundQuery(START, 1.2, soles_at(START, GAIT.reach.width), planned=tuple(steps))
    assert GroundPlanner(G1, GAIT).blocked(mapper.ground(), query) is blocked


def test_a_detour_passes_on_the_nearer_free_side(mapper: TerrainMapper) -> None:
    def box(x: float, y: float) -> float:
        return 0.3 if 0.6 < x < 1.0 and -0.5 < y < 0.3 else 0.0

    plan_on(mapper, box)
    assert detour(mapper.ground(), START, 0.1, 0.3, PLAN) == []
    planner, query = GroundPlanner(G1, GAIT), GroundQuery(START, 0.1, soles_at(START, GAIT.reach.width))
    around = answer_request(planner, Request(1, query, around=True), mapper.ground(), clearance=0.3)
    assert around.poses == () and not around.reason
    first, last = detour(mapper.ground(), START, 1.4, 0.3, PLAN)
    assert detour(mapper.ground(), START, 1e12, 0.3, PLAN) == [first, last]  # beyond the map nothing is known
    assert first.y == last.y == pytest.approx(0.6, abs=0.06)
    assert first.x == pytest.approx(0.3, abs=0.05) and last.x == pytest.approx(1.3, abs=0.05)
    plan_on(mapper, lambda x, _: 0.3 if x > 0.6 else 0.0)
    with pytest.raises(UnreachableError, match="no way around"):
        detour(mapper.ground(), START, 1.4, 0.3, PLAN)


def test_what_is_level_is_known_and_needs_no_plan(mapper: TerrainMapper) -> None:
    def level_ahead(height: Callable[[float, float], float], distance: float) -> bool | None:
        plan_on(mapper, height)
        query = GroundQuery(START, distance, soles_at(START, GAIT.reach.width))
        return GroundPlanner(G1, GAIT).level(mapper.ground(), query)

    riser: Callable[[float, float], float] = lambda x, _: 0.15 if x > 0.9 else 0.0  # noqa: E731
    assert level_ahead(lambda x, _: 0.01 * x if x > 0.4 else math.nan, 1.0)
    assert level_ahead(riser, 0.6) and not level_ahead(riser, 0.9)
    assert not level_ahead(lambda x, y: -0.4 if x > 0.9 and y < 0.0 else 0.0, 0.9)  # under one foot
    narrow: Callable[[float, float, float], float] = lambda x, y, z: z if 0.6 < x < 0.64 and 0.0 < y < 0.04 else 0.0  # noqa: E731
    assert not level_ahead(lambda x, y: narrow(x, y, 0.5), 0.9)  # a post
    assert level_ahead(lambda x, y: narrow(x, y, -0.5), 0.9)  # a hole that a sole spans
    assert level_ahead(lambda *_: math.nan, 0.9) is None
    assert level_ahead(lambda x, _: 0.0 if x < -0.3 else math.nan, 0.9) is None
    assert level_ahead(lambda x, _: -0.6 if x < -0.3 else math.nan, 0.9) is False  # perhaps on a landing


def test_the_reason_is_what_comes_first(mapper: TerrainMapper) -> None:
    """A wall, and lower ground behind it."""
    _, why = plan_on(mapper, lambda x, _: 0.0 if x < 0.5 else 0.4 if x < 0.56 else -0.4)
    assert "0.40 m higher, at most" in why


@pytest.mark.parametrize(
    ("change", "culprit"),
    [
        ({"distance": math.nan}, "not finite"),
        ({"distance": math.inf}, "not finite"),
        ({"line": Foothold(0.0, math.nan, 0.0)}, "not finite"),
        ({"planned": (Footstep(0, Foothold(math.inf, 0.0, 0.0)),)}, "not finite"),
        ({"foot": 7}, "foot 7 is neither"),
    ],
)
def test_a_malformed_query_is_refused(change: dict[str, Any], culprit: str) -> None:
    query = GroundQuery(START, 1.0, soles_at(START, GAIT.reach.width))
    with pytest.raises(ValueError, match=culprit):
        structs.replace(query, **change)


def test_a_plan_that_the_gait_refuses_ends_with_its_reason() -> None:
    """The feet are turned from the line by a radian."""
    ground = Heights(np.zeros((200, 200)), (-2.0, -2.0), 0.02)
    turned = Foothold(0.0, 0.0, 1.0)
    steps, reason = GroundPlanner(G1, GAIT).plan(ground, GroundQuery(START, 1.0, soles_at(turned, GAIT.reach.width)))
    assert not steps and "footstep 1 (left) refused: legs would cross" in reason


@pytest.mark.parametrize(
    ("rise", "cells", "free"),
    [
        (0.04, (1, 4), True),
        (0.04, (1, 5), False),
        (0.2, (1, 1), False),
        (-0.04, (2, 20), True),
        (-0.04, (3, 3), False),
    ],
)
def test_a_detour_passes_over_low_ground_and_holes_that_a_sole_spans(
    rise: float, cells: tuple[int, int], free: bool
) -> None:
    heights = np.zeros((100, 100))
    heights[60 : 60 + cells[0], 48 : 48 + cells[1]] = rise  # 0.2 m ahead
    assert (detour(Heights(heights, (-1.0, -1.0), 0.02), START, 0.8, 0.2, PLAN) == []) is free


@pytest.mark.parametrize(("deviation", "free"), [(0.005, False), (0.015, True), (math.inf, False), (math.nan, False)])
def test_ground_that_may_be_level_by_its_deviation_does_not_bar_a_detour(deviation: float, free: bool) -> None:
    """A strip 5 cm high exceeds the tolerance of 3 cm by 2 cm; an unknown deviation is taken as zero."""
    heights = np.zeros((100, 100))
    heights[60:64, 40:60] = 0.05
    ground = Heights(heights, (-1.0, -1.0), 0.02, np.full(heights.shape, deviation))
    assert (detour(ground, START, 0.8, 0.2, PLAN) == []) is free


@pytest.mark.parametrize(("behind", "is_level"), [(-0.15, False), (0.15, True), (0.0, True)])
def test_where_lower_ground_is_known_unknown_ground_may_be_an_edge(
    mapper: TerrainMapper, behind: float, is_level: bool
) -> None:
    """Ahead of a landing, for instance, that is known up to 0.6 m ahead."""
    plan_on(mapper, lambda x, _: math.nan if x > 0.6 else behind if x < -0.3 else 0.0)
    for distance, expected in ((0.4, True), (0.7, is_level)):
        query = GroundQuery(START, distance, soles_at(START, GAIT.reach.width))
        assert GroundPlanner(G1, GAIT).level(mapper.ground(), query) == expected


def test_ahead_of_a_foot_on_known_ground_nothing_is_felt(mapper: TerrainMapper) -> None:
    """As on stairs: what is not seen beside a foot that stands on the map may be an edge."""
    steps, why = plan_on(mapper, lambda x, _: 0.0 if x < 0.3 or x > 0.8 else math.nan)
    assert why == "the ground ahead is not known, perhaps an edge"
    assert all(step.tread is not None and step.hold.x + X_MAX < 0.3 for step in steps)
