"""The step plan: its compiled preview is the law written out, and an adjustment is that law in the world."""

from __future__ import annotations

import math

import numpy as np
import pytest

from models.robot_model import RobotModel
from planners.gait import dcm
from planners.gait.footsteps import Foothold, preview_footholds
from planners.gait.gait import GaitPlanner
from planners.gait.plan import StepPlan
from planners.gait.reaction import whole_swing

OMEGA = 3.7


@pytest.fixture(scope="module", params=["g1", "talos"])
def planner(request: pytest.FixtureRequest) -> GaitPlanner:
    return GaitPlanner(RobotModel.load(request.param))


def told(planner: GaitPlanner, foot: int, steps_left: int | None, urgent: bool = False) -> StepPlan:
    """The plan of a walk that moves ahead, sideways and round, from a stance that is somewhere."""
    plan = planner._step.plan
    plan.stance, plan.foot, plan.steps_left = Foothold(1.2, -0.4, 2.3, 0.02), foot, steps_left
    plan.lifted = Foothold(*plan.stance.moved(-0.2, 0.2 if foot == 0 else -0.2), 2.25)
    plan.velocity, plan.omega, plan.urgent = (0.5, 0.1, 0.3), OMEGA, urgent
    return plan


def points_of(planner: GaitPlanner, plan: StepPlan) -> list[np.ndarray]:
    """ZMP points of the stance and of the coming footholds."""
    config, soles, foot = planner.config, planner._soles, plan.foot
    steps = preview_footholds(
        plan.stance, foot, plan.velocity, config.period, config.reach, config.preview, plan.steps_left
    )
    points = [soles.point_of(1 - foot, plan.stance)]
    return points + [soles.point_of(foot if i % 2 == 0 else 1 - foot, hold) for i, hold in enumerate(steps)]


def offset_of(planner: GaitPlanner, plan: StepPlan) -> np.ndarray:
    """The recursion of ``dcm.touchdown_offset`` in numpy, with the reactions of the legs."""
    points, timing = points_of(planner, plan), planner.config.timing
    share = 1.0 - dcm.transfer_share(OMEGA, timing.double)
    swing, period = planner._step.swing, planner.config.period
    offset = np.zeros(2) if plan.steps_left is None else 0.5 * (points[-2] - points[-1])
    for before, here, after in reversed(list(zip(points, points[1:], points[2:], strict=False))):
        way = tuple(after - before)
        used = whole_swing(OMEGA, timing.single, period, way, plan.stance.yaw, swing.shape, planner._reaction.lever)
        offset = math.exp(-OMEGA * period) * (offset + after - here) - share * (here - before)
        offset = offset + math.exp(-OMEGA * timing.double) * np.array(used)
    return offset


@pytest.mark.parametrize("steps_left", [None, 2, 1])
@pytest.mark.parametrize("foot", [0, 1])
def test_the_preview_is_the_recursion_written_out(planner: GaitPlanner, foot: int, steps_left: int | None) -> None:
    plan = told(planner, foot, steps_left)
    step, offset = plan.nominal()
    np.testing.assert_allclose(planner._soles.point_of(foot, step), points_of(planner, plan)[1], atol=1e-12)
    np.testing.assert_allclose(offset, offset_of(planner, plan), atol=1e-12)
    assert step.z == plan.stance.z


def test_a_route_is_previewed_in_place_of_the_velocity(planner: GaitPlanner) -> None:
    plan = told(planner, 0, None)
    free, _ = plan.nominal()
    soles = [plan.lifted, plan.stance]
    planner.route.towards(Foothold(*plan.stance.moved(0.8, 0.1), 2.3), soles, 0)
    try:
        first, other = planner.route.ahead(plan.stance, 2)
        step, offset = plan.nominal()
    finally:
        planner.route.end("of the test")
    assert (step.x, step.y, step.yaw) == pytest.approx((first.x, first.y, first.yaw))
    assert math.hypot(step.x - free.x, step.y - free.y) > 0.02
    # Half of what comes next shows in the offset: it points towards the foothold after it.
    here, after = planner._soles.point_of(0, first), planner._soles.point_of(1, other)
    assert float(np.dot(offset, after - here)) > 0.0


@pytest.mark.parametrize("foot", [0, 1])
def test_an_undisturbed_step_lands_where_it_is_planned(planner: GaitPlanner, foot: int) -> None:
    """From the DCM that the coming single support is to begin at."""
    plan, single = told(planner, foot, None), planner.config.timing.single
    swing = planner._step.swing
    swing.lift(np.array([plan.lifted.x, plan.lifted.y, plan.lifted.z, plan.lifted.yaw]), single, np.zeros(2))
    nominal, offset = plan.nominal()
    point, landing = planner._soles.point_of(1 - foot, plan.stance), planner._soles.point_of(foot, nominal)
    start = dcm.single_support(point, landing + np.array(offset), OMEGA, single)[0]
    start = start + planner._reaction.rest(OMEGA, single, swing, (nominal.x, nominal.y))
    step, time, end = plan.adjust(start, 0.0, single, nominal)
    assert (step.x, step.y, step.yaw, step.z) == pytest.approx((nominal.x, nominal.y, nominal.yaw, nominal.z), abs=1e-6)
    assert time == pytest.approx(single, abs=1e-6)
    np.testing.assert_allclose(end, landing + np.array(offset), atol=1e-6)


@pytest.mark.parametrize("urgent", [False, True])
@pytest.mark.parametrize("foot", [0, 1])
def test_a_pushed_step_ends_in_the_corner_of_its_box(planner: GaitPlanner, foot: int, urgent: bool) -> None:
    """Ahead and outwards in the frame of the stance; an urgent step may be wider."""
    plan, reach, out = told(planner, foot, None, urgent), planner.config.reach, 1.0 if foot == 0 else -1.0
    swing = planner._step.swing
    x, y = plan.stance.moved(reach.forward, out * reach.width_urgent)
    swing.lift(np.array([x, y, 0.0, 2.3]), 0.34, np.zeros(2))
    pushed = np.array(plan.stance.moved(1.0, out * 1.5))
    step, _, _ = plan.adjust(pushed, 0.1, 0.3, plan.lifted)
    widest = reach.width_urgent if urgent else reach.width_max
    assert plan.stance.relative(step.x, step.y) == pytest.approx((reach.forward, out * widest), abs=1e-6)
