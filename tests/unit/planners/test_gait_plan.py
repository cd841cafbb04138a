"""The step plan: its compiled preview is the law written out, and an adjustment is that law in the world."""

import math

import numpy as np
import pytest

from models.numerics.unboxed import unbox
from planners.gait import dcm
from planners.gait.adjustment import PlannedStep, Walk
from planners.gait.commands import CommandState
from planners.gait.footsteps import Foothold, limits_of, preview_footholds
from planners.gait.pace import Pace
from planners.gait.reaction import SwingLeg, whole_swing
from planners.gait.regions import Region
from planners.gait.route import Route, plan_to_pose, route_of
from tests.gaits import Planned

OMEGA, PACE = 3.7, Pace(single=0.34, double=0.06, crouch=0.0, clearance=0.05, share=0.5)


@pytest.fixture(scope="module", params=["g1", "talos"])
def planned(request: pytest.FixtureRequest) -> Planned:
    return Planned(request.param)


def walk_of(foot: int, steps_left: int | None, urgent: bool = False, route: Route | None = None) -> Walk:
    """A walk that moves ahead, sideways and round, from a stance that is somewhere."""
    stance = Foothold(1.2, -0.4, 2.3, 0.02)
    liftoff = Foothold(*stance.moved(-0.2, 0.2 if foot == 0 else -0.2), 2.25)
    velocity = (0.5, 0.1, 0.3)
    command = CommandState(velocity, velocity, route=route or Route(), steps_left=steps_left)
    return Walk(stance, foot, liftoff, command, PACE, OMEGA, urgent)


def points_of(planned: Planned, walk: Walk) -> list[np.ndarray]:
    """ZMP points of the stance and of the coming footholds."""
    config, soles, foot = planned.config, planned.soles, walk.foot
    steps = preview_footholds(
        walk.stance, foot, walk.command.velocity, PACE.period, config.reach, config.preview, walk.command.steps_left
    )
    points = [soles.point_of(1 - foot, walk.stance)]
    return points + [soles.point_of(foot if i % 2 == 0 else 1 - foot, hold) for i, hold in enumerate(steps)]


def offset_of(planned: Planned, walk: Walk) -> np.ndarray:
    """The recursion of ``dcm.touchdown_offset`` in numpy, with the reactions of the legs."""
    points, leg = points_of(planned, walk), SwingLeg(planned.swing.shape, planned.lever)
    share = 1.0 - dcm.transfer_share(OMEGA, PACE.double)
    offset = np.zeros(2) if walk.command.steps_left is None else 0.5 * (points[-2] - points[-1])
    for before, here, after in reversed(list(zip(points, points[1:], points[2:], strict=False))):
        way = tuple(after - before)
        used = whole_swing(OMEGA, PACE, way, walk.stance.yaw, leg)
        offset = math.exp(-OMEGA * PACE.period) * (offset + after - here) - share * (here - before)
        offset = offset + math.exp(-OMEGA * PACE.double) * np.array(used)
    return offset


@pytest.mark.parametrize("steps_left", [None, 2, 1])
@pytest.mark.parametrize("foot", [0, 1])
def test_the_preview_is_the_recursion_written_out(planned: Planned, foot: int, steps_left: int | None) -> None:
    walk = walk_of(foot, steps_left)
    step, offset = planned.plan.nominal(walk)
    np.testing.assert_allclose(planned.soles.point_of(foot, step), points_of(planned, walk)[1], atol=1e-12)
    np.testing.assert_allclose(offset, offset_of(planned, walk), atol=1e-12)
    assert step.z == walk.stance.z


def test_a_route_is_previewed_in_place_of_the_velocity(planned: Planned) -> None:
    walk = walk_of(0, None)
    free, _ = planned.plan.nominal(walk)
    goal = Foothold(*walk.stance.moved(0.8, 0.1), 2.3)
    route = route_of(plan_to_pose(goal, [walk.liftoff, walk.stance], planned.config, 0), goal)
    first, other = route.ahead(walk.stance, 2, limits_of(planned.config.reach))
    step, offset = planned.plan.nominal(walk_of(0, None, route=route))
    assert (step.x, step.y, step.yaw) == pytest.approx((first.x, first.y, first.yaw))
    assert math.hypot(step.x - free.x, step.y - free.y) > 0.02
    # Half of what comes next shows in the offset: it points towards the foothold after it.
    here, after = planned.soles.point_of(0, first), planned.soles.point_of(1, other)
    assert float(np.dot(offset, after - here)) > 0.0


@pytest.mark.parametrize("foot", [0, 1])
def test_an_undisturbed_step_lands_at_its_planned_place(planned: Planned, foot: int) -> None:
    """From the DCM at which the coming single support begins."""
    walk, single = walk_of(foot, None), PACE.single
    pose = np.array([walk.liftoff.x, walk.liftoff.y, walk.liftoff.z, walk.liftoff.yaw])
    nominal, offset = planned.plan.nominal(walk)
    target = nominal.x, nominal.y
    swing = planned.swing.lift(pose, PACE.clearance, single, np.zeros(2), target=target)
    point, landing = planned.soles.point_of(1 - foot, walk.stance), planned.soles.point_of(foot, nominal)
    start, leg = landing + offset, unbox(SwingLeg(planned.swing.shape, planned.lever))
    moving = swing.towards(*target)
    for _ in range(20):  # the reaction depends on the CoM, which is at the DCM here
        at = planned.with_dcm(start)
        body = at.com, at.com_velocity
        out = np.empty((3, 2))
        dcm.single_support(point, landing + offset, OMEGA, single, moving, body, leg, out)
        start = out[0]
    last = PlannedStep(nominal, single, landing + offset)
    step = planned.plan.adjust(walk, planned.with_dcm(start), 0.0, last, swing)
    assert step.solved and step.region is Region.OWN and step.via is None
    assert step.hold.place == pytest.approx(nominal.place, abs=1e-6)
    assert step.time == pytest.approx(single, abs=1e-6)
    np.testing.assert_allclose(step.end, landing + offset, atol=1e-6)


@pytest.mark.parametrize("urgent", [False, True])
@pytest.mark.parametrize("foot", [0, 1])
def test_a_pushed_step_ends_in_the_corner_of_its_box(planned: Planned, foot: int, urgent: bool) -> None:
    """Ahead and outwards in the frame of the stance; an urgent step may be wider."""
    walk, reach, out = walk_of(foot, None, urgent), planned.config.reach, 1.0 if foot == 0 else -1.0
    x, y = walk.stance.moved(reach.forward, out * reach.width_urgent)
    swing = planned.swing.lift(np.array([x, y, 0.0, 2.3]), PACE.clearance, 0.34, np.zeros(2))
    pushed = planned.with_dcm(np.array(walk.stance.moved(1.0, out * 1.5)))
    step = planned.plan.adjust(walk, pushed, 0.1, PlannedStep(walk.liftoff, 0.3, np.zeros(2)), swing).hold
    widest = reach.width_urgent if urgent else reach.width_max
    assert walk.stance.relative(step.x, step.y) == pytest.approx((reach.forward, out * widest), abs=1e-6)
