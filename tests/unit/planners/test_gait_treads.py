"""Footholds of known height and tilt: what is refused, room on treads, swings over edges, the CoM's way up."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

from models.errors import UnreachableError
from models.robot_model import RobotModel
from planners.gait import dcm
from planners.gait.footsteps import LEFT, PREVIEWED, RIGHT, Foothold, limits_of, side_of
from planners.gait.pace import Pace
from planners.gait.planner import GaitPlanner
from planners.gait.route import Footstep, check_footsteps, footstep_of, route_over, soles_at
from planners.gait.scaling import load_gait_config
from planners.gait.swing import SwingFoot
from planners.gait.tread import Tread, bounds_in, clearance_over, swing_shares
from planners.terrain.stairs import Stairs, stair_footsteps
from tests.pendulum import DOUBLE, OMEGA, SINGLE, touchdown_offset
from tests.support import standing

G1 = RobotModel.load("g1")
GAIT = load_gait_config(G1)
ORIGIN = Foothold(0.0, 0.0, 0.0)
SOLES = soles_at(ORIGIN, GAIT.reach.width)
HALF = 0.5 * GAIT.reach.width
RECTANGLE = G1.feet[LEFT].rectangle
STAIRS = Stairs(ahead=0.4, rise=0.15, tread=0.3, count=3, landing=0.8, width=2.0)


def step(foot: int, x: float, z: float, slope: tuple[float, float] = (0.0, 0.0)) -> Footstep:
    """A step straight ahead onto known ground."""
    return Footstep(foot, Foothold(x, side_of(foot) * HALF, 0.0, z), Tread(slope))


def passing(over: float, x: float = 0.4) -> Footstep:
    """A step over something."""
    return replace(step(LEFT, x, 0.0), tread=Tread(over=over))


@pytest.mark.parametrize(
    ("steps", "reason"),
    [
        ([step(LEFT, 0.2, 0.21)], r"footstep 1 \(left\) refused: 0.210 m above the right sole, at most 0.204 m"),
        ([step(LEFT, 0.2, 0.1), step(RIGHT, 0.2, -0.15)], r"footstep 2 \(right\) refused: 0.250 m below the left sole"),
        ([step(LEFT, 0.2, math.nan)], "nan m below the right sole"),
        ([step(LEFT, 0.2, 0.0, (0.3, 0.0))], r"tilted by 0.291 rad, at most 0.245 rad"),
        ([step(LEFT, 0.2, 0.0, (math.nan, 0.0))], "tilted by nan rad"),
        ([passing(0.3)], "over ground 0.300 m higher than its ends, from 0 to 0.204 m"),
        ([passing(-0.05)], "over ground -0.050 m higher"),
        ([passing(math.nan)], "over ground nan m higher"),
    ],
)
def test_heights_and_tilts_that_the_leg_cannot_do_are_refused(steps: list[Footstep], reason: str) -> None:
    with pytest.raises(UnreachableError, match=reason):
        check_footsteps(steps, SOLES, GAIT)


def test_the_height_of_a_step_without_a_tread_does_not_count() -> None:
    check_footsteps([Footstep(LEFT, Foothold(0.2, HALF, 0.0, 5.0)), step(RIGHT, 0.2, 0.1)], SOLES, GAIT)


def test_steps_survive_as_numbers() -> None:
    for tread in (None, Tread((0.1, -0.2)), Tread((0.0, 0.1), (0.1, 0.2, 0.3, 0.4), 0.1), Tread(over=0.1)):
        made = Footstep(RIGHT, Foothold(1.0, 2.0, 0.3, 0.4), tread)
        assert footstep_of(*made.values) == made


def test_a_step_is_adjusted_within_its_tread() -> None:
    known = Footstep(LEFT, Foothold(0.3, HALF, 0.0), Tread(room=(0.02, 0.03, 0.1, 0.2)))
    bounds = bounds_in(SOLES[RIGHT], known.hold, known.tread)
    assert bounds == pytest.approx(np.array([[0.28, 2 * HALF - 0.1], [0.33, 2 * HALF + 0.2]]))
    assert known.kept(Foothold(0.5, 0.0, 0.1)) == Foothold(pytest.approx(0.33), pytest.approx(HALF - 0.1), 0.1)


@pytest.mark.parametrize("turn", [0.03, 0.1, 0.3])
@pytest.mark.parametrize("long", [0.0, 0.05])
def test_a_tread_hardly_longer_than_the_sole_leaves_a_turned_one_room_to_the_sides(turn: float, long: float) -> None:
    known = Footstep(LEFT, Foothold(0.3, HALF, 0.0), Tread(room=(0.0, long, 0.1, 0.2)))
    stance = Foothold(0.0, 0.0, -turn)
    bounds = bounds_in(stance, known.hold, known.tread)
    assert np.ptp(bounds, axis=0)[1] > min(0.2, 0.012 / turn)
    for x in bounds[:, 0]:
        for y in bounds[:, 1]:
            place = Foothold(*stance.moved(x, y), 0.0)
            there = known.kept(place)
            assert math.hypot(there.x - place.x, there.y - place.y) <= math.sqrt(2.0) * 0.01 + 1e-9


@pytest.mark.parametrize("rise", [0.03, 0.1, 0.2, -0.03, -0.1, -0.2])
@pytest.mark.parametrize("way", [0.3, 0.6])
def test_a_swing_clears_the_edge_between_its_footholds(rise: float, way: float) -> None:
    edge = GAIT.swing.edge if rise > 0.0 else way - GAIT.swing.edge  # as near to the sole as it may be
    path = foot_path(way, rise)
    assert path[-1] == pytest.approx((way, rise), abs=2e-3)
    passing = int(np.argmax(path[:, 0] > edge))
    assert path[passing, 1] - max(rise, 0.0) > 0.9 * min(abs(rise), 0.04)


@pytest.mark.parametrize("rise", [0.0, 0.05, -0.05, 0.1, -0.1])
@pytest.mark.parametrize("over", [0.05, 0.12])
@pytest.mark.parametrize("way", [0.3, 0.4, 0.55])
def test_a_swing_clears_what_is_higher_than_both_ends(over: float, rise: float, way: float) -> None:
    path, edge = foot_path(way, rise, over=over), GAIT.swing.edge
    assert path[-1] == pytest.approx((way, rise), abs=2e-3)
    above = path[(path[:, 0] > edge) & (path[:, 0] < way - edge), 1]
    spare = clearance_over(rise, 0.04, GAIT.swing.edge_clearance, over) - over
    assert above.min() > max(rise, 0.0) + over + 0.8 * 0.5 * min(spare, 2.0 * over)


def foot_path(way: float, rise: float, duration: float = 0.5, over: float = 0.0) -> np.ndarray:
    """Places x, z of a swing (n, 2) [m]."""
    swing = SwingFoot(GAIT.swing)
    foot = swing.lift(np.zeros(4), 0.04, duration, np.zeros(2), target=(way, 0.0), rise=rise, over=over)
    dt, places = 0.001, []
    for k in range(1, round(duration / dt)):
        foot = swing.step(foot, np.array([way, 0.0, rise, 0.0]), np.zeros(2), k * dt, duration, dt)
        places.append(foot.position[[0, 2]])
    return np.array(places)


def test_a_level_swing_is_as_without_known_ground() -> None:
    assert swing_shares(0.0, 0.04, 0.5, 0.45, 0.03, 0.1) == (0.45, 0.0, 0.0)
    up, down = (swing_shares(rise, 0.08, 0.3, 0.5, 0.03, 0.0) for rise in (0.15, -0.15))
    assert up == pytest.approx((1.0 - down[0], down[2], down[1]))  # the same way back
    assert up[0] > 0.5 and up[1] > 0.0


def test_steps_take_the_time_that_they_need_and_those_kept_from_a_route_do_not_change() -> None:
    level = [step(foot, 0.2, 0.0) for foot in (LEFT, RIGHT)]
    passing = [replace(made, hold=structs.replace(made.hold, x=0.6), tread=Tread(over=0.12)) for made in level]
    quick, slow = route_over(level, SOLES, 0.0, GAIT), route_over([*level, *passing], SOLES, 0.0, GAIT)
    assert quick.swing < slow.swing == GAIT.timing.single_max
    kept = route_over([*quick.steps, *passing], SOLES, 0.0, GAIT, kept=2)
    assert [made.time for made in kept.steps] == [quick.swing] * 2 + [slow.swing] * 2


def test_the_dcm_of_a_step_is_ready_for_a_slower_one() -> None:
    pace, steps = Pace(SINGLE, DOUBLE, 0.0, 0.05, 0.0), np.zeros(5, PREVIEWED)
    steps["x"], steps["rise"] = 0.3 * np.arange(5), 0.1 * np.arange(5)
    quick = dcm.height_at_touchdown(steps, False, OMEGA, pace) - 0.1
    steps["time"][3:] = 0.9
    ahead = dcm.height_at_touchdown(steps, False, OMEGA, pace) - 0.1
    after = dcm.height_at_touchdown(steps[1:], False, OMEGA, pace) - 0.2  # one step later: the slow one is next
    share = 1.0 - dcm.transfer_share(OMEGA, DOUBLE)
    assert ahead == pytest.approx(math.exp(-OMEGA * (SINGLE + DOUBLE)) * (after + 0.1) - share * 0.1)
    assert ahead < quick


def test_on_even_stairs_the_com_goes_up_in_proportion_to_its_way() -> None:
    way, rise, pace = 0.3, 0.12, Pace(SINGLE, DOUBLE, 0.0, 0.05, 0.0)
    points = [np.array((i * way, 0.0)) for i in range(5)]
    steps = np.array([(i * way, 0.0, 0.0, i * rise, 0.0, 0.0) for i in range(5)], PREVIEWED)
    height = dcm.height_at_touchdown(steps, False, OMEGA, pace)
    assert height - rise == pytest.approx(rise / way * touchdown_offset(points)[0])


@pytest.mark.parametrize("together", [True, False])
def test_footsteps_over_stairs_can_be_taken_and_are_on_the_treads(together: bool) -> None:
    steps = stair_footsteps(STAIRS, ORIGIN, G1, GAIT, together=together)
    check_footsteps(steps, SOLES, GAIT)
    assert [made.foot for made in steps] == [i % 2 for i in range(len(steps))]
    edges = [0.4, 0.7, 1.0, 1.8, 2.1, 2.4]
    heights = [0.0, 0.15, 0.3, 0.45, 0.3, 0.15, 0.0]
    for made in steps:
        heel, toe = made.hold.x + RECTANGLE[0], made.hold.x + RECTANGLE[1]
        level = sum(edge < heel for edge in edges)
        assert level == sum(edge < toe for edge in edges)
        assert made.hold.z == pytest.approx(heights[level])
    assert {made.foot: made.hold.x for made in steps[-2:]}[LEFT] == steps[-1].hold.x == steps[-2].hold.x
    assert len({(round(made.hold.x, 6), made.foot) for made in steps}) == len(steps)


def test_treads_without_room_are_refused() -> None:
    for fields, reason in (
        ({"tread": 0.2}, "treads of 0.200 m: at least 0.230 m"),
        ({"landing": 0.1}, "a landing of 0.100 m: at least 0.230 m"),
        ({"width": 0.2}, "too narrow for soles"),
    ):
        with pytest.raises(UnreachableError, match=reason):
            stair_footsteps(structs.replace(STAIRS, **fields), ORIGIN, G1, GAIT)


def test_a_route_over_heights_is_lower_and_slower_and_counts_from_the_sole_it_stands_on() -> None:
    level: Sequence[Footstep] = [step(LEFT, 0.2, 0.5), step(RIGHT, 0.2, 0.5)]
    stairs = [
        replace(made, hold=Foothold(made.hold.x, made.hold.y, 0.0, 0.5 + 0.15 * i)) for i, made in enumerate(level)
    ]
    soles = soles_at(Foothold(0.0, 0.0, 0.0, 0.5), GAIT.reach.width)
    plain, high = (route_over(steps, soles, 0.5, GAIT) for steps in (level, stairs))
    assert high.crouch > plain.crouch + 0.05 and high.swing > plain.swing
    assert [made.hold.z for made in high.steps] == pytest.approx([0.0, 0.15])
    assert plain.swing < GAIT.pace.between(GAIT.route.pace, "single")  # a level list is as quick as without heights
    ahead = high.ahead(Foothold(0.2, HALF, 0.0, 0.47), 2, limits_of(GAIT.reach))
    assert ahead[1].z == pytest.approx(0.47 + 0.15)


def test_a_refused_list_of_heights_leaves_the_robot_standing() -> None:
    planner = GaitPlanner(G1)
    planner.reset(standing(G1))
    with pytest.raises(UnreachableError, match="above the right sole"):
        planner.take_steps([step(LEFT, 0.2, 0.4)])
    assert not planner.route.left and not planner.walking
