"""Footsteps to a pose: inside the limits, there at the end, mirrored; and lists that are refused with the reason."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from models.config import default_config
from models.errors import CommandError, UnreachableError
from models.robot_model import RobotModel
from planners.gait.config import GaitConfig
from planners.gait.footsteps import LEFT, RIGHT, Foothold, limits_of, middle, wrap
from planners.gait.planner import GaitPlanner
from planners.gait.route import Footstep, check_footsteps, plan_to_pose, route_of, soles_at
from planners.gait.state import GaitPhase
from tests.gaits import DT
from tests.support import standing

GAIT = default_config(GaitConfig, "planners", "gait")
REACH = GAIT.reach
HALF = 0.5 * REACH.width
ORIGIN = soles_at(Foothold(0.0, 0.0, 0.0), REACH.width)

poses = st.builds(Foothold, st.floats(-3, 3), st.floats(-3, 3), st.floats(-math.pi, math.pi))


def mirrored(hold: Foothold) -> Foothold:
    return Foothold(hold.x, -hold.y, -hold.yaw)


@settings(max_examples=200, deadline=None)
@given(goal=poses, start=poses, foot=st.sampled_from([LEFT, RIGHT, None]))
def test_a_plan_can_be_taken_and_ends_at_the_goal(goal: Foothold, start: Foothold, foot: int | None) -> None:
    soles = list(soles_at(start, REACH.width))
    steps = plan_to_pose(goal, soles, GAIT, foot)
    if steps:
        assert foot in (None, steps[0].foot)
        check_footsteps(steps, soles, GAIT)
    for step in steps:
        soles[step.foot] = step.hold
    end = middle(soles)
    assert math.hypot(end.x - goal.x, end.y - goal.y) <= GAIT.route.position_tolerance + 1e-9
    assert abs(wrap(end.yaw - goal.yaw)) <= GAIT.route.turn_tolerance + 1e-9
    (x, left), (other_x, right) = (end.relative(sole.x, sole.y) for sole in soles)
    ahead, out = x - other_x, left - right
    assert abs(ahead) <= GAIT.route.position_tolerance and REACH.width_min <= out <= REACH.width_max


@settings(max_examples=100, deadline=None)
@given(goal=poses, foot=st.sampled_from([LEFT, RIGHT]))
@example(goal=Foothold(0.009765625, 0.015625, 0.015625), foot=LEFT)  # there within the tolerance, one sole turned
def test_a_mirrored_goal_gives_the_mirrored_steps(goal: Foothold, foot: int) -> None:
    steps = plan_to_pose(goal, ORIGIN, GAIT, foot)
    others = plan_to_pose(mirrored(goal), ORIGIN, GAIT, 1 - foot)
    # Bit by bit: rounding that differed would be taken for a difference where a bound decides.
    assert others == [Footstep(1 - step.foot, mirrored(step.hold)) for step in steps]


def test_half_a_turn_is_made_in_place() -> None:
    steps = plan_to_pose(Foothold(0.0, 0.0, math.pi), ORIGIN, GAIT)
    centres = [middle((a.hold, b.hold)) for a, b in zip(steps[1:], steps[:-1], strict=True)]
    assert max(math.hypot(centre.x, centre.y) for centre in centres) < 0.04
    assert len(steps) * GAIT.period < 1.3 * math.pi / GAIT.route.turn


@pytest.mark.parametrize(
    ("goal", "turned"),
    [((2.0, 0.0, 0.0), 0.0), ((-0.5, 0.0, 0.0), 0.0), ((0.0, 0.2, 0.0), 0.0), ((0.0, 2.0, 0.0), 1.0)],
)
def test_it_turns_towards_a_goal_only_where_that_is_quicker(goal: tuple[float, float, float], turned: float) -> None:
    steps = plan_to_pose(Foothold(*goal), ORIGIN, GAIT)
    largest = max(abs(step.hold.yaw) for step in steps)
    assert (largest > turned) if turned else (largest < 1e-6)


def test_standing_there_takes_no_steps() -> None:
    assert plan_to_pose(Foothold(0.005, 0.0, 0.01), ORIGIN, GAIT) == []
    assert plan_to_pose(Foothold(0.0, 0.0, 0.0), soles_at(Foothold(0.0, 0.0, 0.0), 0.25), GAIT) == []
    apart = (Foothold(0.1, HALF, 0.0), Foothold(-0.1, -HALF, 0.0))  # one foot ahead of the other
    assert len(plan_to_pose(Foothold(0.0, 0.0, 0.0), apart, GAIT)) == 2


@pytest.mark.parametrize("goal", [(math.nan, 0.0, 0.0), (0.0, math.inf, 0.0), (0.0, 0.0, math.nan)])
def test_a_goal_that_is_no_number_is_refused(goal: tuple[float, float, float]) -> None:
    with pytest.raises(CommandError, match="not finite"):
        plan_to_pose(Foothold(*goal), ORIGIN, GAIT)


def test_a_goal_too_far_away_is_refused() -> None:
    with pytest.raises(UnreachableError, match=r"21\.0 m away, at most 20 m"):
        plan_to_pose(Foothold(21.0, 0.0, 0.0), ORIGIN, GAIT)
    short = replace(GAIT, route=replace(GAIT.route, steps_max=5))
    with pytest.raises(UnreachableError, match="more than 5 steps"):
        plan_to_pose(Foothold(2.0, 0.0, 0.0), ORIGIN, short)


@pytest.mark.parametrize(
    ("steps", "reason"),
    [
        ([], "0 footsteps"),
        ([(LEFT, 0.2, math.nan, 0.0)], r"footstep 1 \(left\) refused: \(0.2, nan, 0.0\) is not finite"),
        ([(LEFT, 0.1, HALF, 0.0), (LEFT, 0.2, HALF, 0.0)], r"footstep 2 \(left\) refused: the same foot"),
        ([(LEFT, 0.6, HALF, 0.0)], "0.600 m ahead of the right sole, at most 0.550 m"),
        ([(RIGHT, -0.4, -HALF, 0.0)], "0.400 m behind the left sole, at most 0.350 m"),
        ([(LEFT, 0.1, -HALF - 0.1, 0.0)], "legs would cross or touch: -0.100 m outwards of the right sole"),
        ([(RIGHT, 0.1, HALF - 0.1, 0.0)], "legs would cross or touch: 0.100 m outwards of the left sole"),
        ([(LEFT, 0.0, -HALF + 0.45, 0.0)], "0.450 m outwards of the right sole, at most 0.420 m"),
        ([(LEFT, 0.0, HALF, 0.7)], "turned out by 0.700 rad"),
        ([(RIGHT, 0.0, -HALF, 0.2)], "turned in by 0.200 rad"),
        ([(LEFT, 0.5, HALF, 0.0), (RIGHT, 0.9, -HALF, 0.0)], r"footstep 2 \(right\) refused: moves the body along"),
    ],
)
def test_lists_that_cannot_be_taken_are_refused(steps: list[tuple[int, float, float, float]], reason: str) -> None:
    with pytest.raises((CommandError, UnreachableError), match=reason):
        check_footsteps([Footstep(foot, Foothold(x, y, yaw)) for foot, x, y, yaw in steps], ORIGIN, GAIT)


def test_the_next_steps_correct_what_one_step_misses() -> None:
    route = route_of([Footstep(LEFT, Foothold(0.2, HALF, 0.0)), Footstep(RIGHT, Foothold(0.4, -HALF, 0.0))])
    landed, limits = Foothold(-0.1, HALF + 0.02, 0.0), limits_of(REACH)
    route = route.landed([landed, ORIGIN[1]], GAIT)
    assert route.left == 1
    again = route.ahead(landed, 4, limits)
    assert [(hold.x, hold.y) for hold in again] == [pytest.approx((0.4, -HALF))]
    far = route.ahead(Foothold(-0.3, HALF, 0.0), 4, limits)[0]
    assert far.x == pytest.approx(-0.3 + REACH.forward)  # out of reach: as far as it goes


def test_a_route_to_a_goal_is_planned_anew_after_a_miss_and_ends_there() -> None:
    goal, soles = Foothold(1.0, 0.0, 0.0), list(ORIGIN)
    route = route_of(plan_to_pose(goal, soles, GAIT), goal)
    planned = route.left
    for taken in range(50):
        foot = route.foot
        hold = route.ahead(soles[1 - foot], 1, limits_of(REACH))[0]
        soles[foot] = Foothold(hold.x - 0.2 * (taken == 2), hold.y + 0.05 * (taken == 2), hold.yaw)
        route = route.landed(soles, GAIT)
        if not route.left:
            break
    assert route.outcome == "done"
    assert taken + 1 > planned
    end = middle(soles)
    assert (end.x, end.y, end.yaw) == pytest.approx((1.0, 0.0, 0.0), abs=GAIT.route.position_tolerance)


def test_a_goal_is_given_up_when_every_foot_lands_off_its_place() -> None:
    goal, soles = Foothold(1.0, 0.0, 0.0), list(ORIGIN)
    route = route_of(plan_to_pose(goal, soles, GAIT), goal, GAIT.route.steps_more)
    most = 2 * route.left + GAIT.route.steps_more
    for taken in range(most):
        assert route.left, f"ended after {taken} of {most} footsteps"
        hold = route.steps[0].hold
        soles[route.foot] = Foothold(hold.x - 0.05, hold.y, hold.yaw)
        route = route.landed(soles, GAIT)
    assert route.left == 0
    assert route.outcome == "the feet miss their footholds: error of the last one 0.050 m"


def test_a_refused_list_leaves_the_route_as_it_was(g1: RobotModel) -> None:
    planner = GaitPlanner(g1)
    planner.reset(standing(g1))
    planner.walk_to(Foothold(1.0, 0.0, 0.0))
    left = planner.route.left
    with pytest.raises(UnreachableError):
        planner.take_steps([Footstep(LEFT, Foothold(2.0, HALF, 0.0))])
    assert planner.route.left == left > 0
    planner.stop()
    assert (planner.route.left, planner.route.outcome) == (0, "stopped")


@pytest.mark.parametrize("phase", [GaitPhase.STAND, GaitPhase.START])
@pytest.mark.parametrize("push", [1.0, -1.0])
@pytest.mark.parametrize("listed", [False, True])
def test_after_a_push_a_route_begins_with_the_foot_that_steps(
    g1: RobotModel, phase: GaitPhase, push: float, listed: bool
) -> None:
    planner, moving = GaitPlanner(g1), np.zeros(g1.nv)
    planner.reset(standing(g1))
    steps = plan_to_pose(Foothold(1.0, 0.0, 0.0), planner.footholds, planner.config, LEFT)
    planner.take_steps(steps) if listed else planner.walk_to(Foothold(1.0, 0.0, 0.0))
    while planner.phase is not phase:
        planner.step(standing(g1), DT)
    assert planner.route.foot == LEFT
    moving[1] = push  # [m/s]
    planner.step(standing(g1, v=moving), DT)
    swings = 1 - planner.stance
    assert planner.phase is GaitPhase.SINGLE and swings == (LEFT if push > 0.0 else RIGHT)
    if listed and swings == RIGHT:
        assert planner.route.outcome == "the right foot had to step first to keep the balance"
    else:
        assert planner.route.foot == swings
