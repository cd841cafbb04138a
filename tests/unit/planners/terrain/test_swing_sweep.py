"""Ground that a leg would be in during a step: at the edge of a higher level, and what a plan does about it."""

import numpy as np
import pinocchio as pin
import pytest

from models.leg_shapes import leg_shapes
from models.robot_model import RobotModel
from planners.gait.footsteps import Foothold
from planners.gait.reaction import pose_foot
from planners.gait.route import soles_at
from planners.gait.scaling import load_gait_config
from planners.terrain.elevation_map import Heights
from planners.terrain.footholds import GroundPlanner, GroundQuery
from planners.terrain.leg_extent import extent_at, layer_at, leg_extent, leg_extents
from planners.terrain.swing_sweep import Tops, sweep_limits, sweeps_ground

WAYS, SIDES = 0.01 * np.arange(-100, 150), np.array([-0.1, 0.1])


def meets(
    robot: RobotModel, rise: float, gap: float, ahead: float = 0.0, *, up: bool = True, slope: float = 0.0
) -> bool:
    """Whether a leg meets the ground on a step to ground that is higher from x = 0 on, or down from there.

    ``gap`` is the distance of the toe (down: of the heel) from the edge, and ``ahead`` that by which the stance foot is
    ahead of the other one before the step.
    """
    gait, (heel, toe, *_) = load_gait_config(robot), robot.feet[0].rectangle
    limits = sweep_limits(gait, leg_extents(robot), 0.03, 0.5 * (heel + toe))
    high = np.where(WAYS > 0.0, rise, 0.0) if up else np.where(WAYS < 0.0, rise, 0.0)
    before, place = (-toe - gap, gait.swing.edge - heel) if up else (-toe - gait.swing.edge, gap - heel)
    levels = (0.0, 0.0, rise) if up else (rise, rise, 0.0)
    at = [
        np.array([x, y, z + slope * x])
        for x, y, z in zip((before, before + ahead, place), (0.1, -0.1, 0.1), levels, strict=True)
    ]
    ground = Tops(WAYS, SIDES, np.tile((high + slope * WAYS)[:, None], 2))
    return bool(sweeps_ground(*at, (slope, slope, slope), 0.0, ground, limits, 0.0))


def test_a_knee_that_bends_over_its_sole_meets_a_high_riser_close_to_the_toe(robot: RobotModel) -> None:
    """In the simulation the stance knee of the G1 touched a riser of 18 cm 6 cm ahead of its toe, and none of 15 cm."""
    assert meets(robot, 0.20, 0.03) and not meets(robot, 0.20, 0.13)
    assert not meets(robot, 0.15, 0.05) and not meets(robot, 0.10, 0.03)
    assert not any(meets(robot, rise, 0.05, up=False) for rise in (0.10, 0.15, 0.20))


def test_the_stance_leg_counts_as_well(robot: RobotModel) -> None:
    assert not meets(robot, 0.18, 0.15) and meets(robot, 0.18, 0.15, ahead=0.14)


@pytest.mark.parametrize("over", [0.0, 0.12])
def test_the_swing_foot_meets_a_post_that_it_does_not_know(robot: RobotModel, over: float) -> None:
    """A post of 12 cm between two footholds on the floor, beside the stance leg."""
    gait, (heel, toe, *_) = load_gait_config(robot), robot.feet[0].rectangle
    limits = sweep_limits(gait, leg_extents(robot), 0.03, 0.5 * (heel + toe))
    post = np.where(np.abs(WAYS - 0.04 - toe) < 0.02, 0.12, 0.0)
    ground = Tops(WAYS, SIDES, np.column_stack([np.zeros(len(WAYS)), post]))
    feet = [np.array(at) for at in ((0.0, 0.1, 0.0), (0.0, -0.1, 0.0), (0.1 + toe - heel, 0.1, 0.0))]
    assert bool(sweeps_ground(*feet, (0.0, 0.0, 0.0), over, ground, limits, 0.0)) == (over == 0.0)


@pytest.mark.parametrize("slope", [0.1, 0.2])
def test_a_riser_on_a_slope_up_is_nearer_to_an_upright_leg(robot: RobotModel, slope: float) -> None:
    """The leg stays upright where the sole is tilted. On a slope down the knee is farther from the riser."""
    gaps = 0.005 * np.arange(40)

    def farthest(tilt: float) -> float:
        return max((gap for gap in gaps if meets(robot, 0.18, gap, slope=tilt)), default=0.0)

    assert farthest(slope) > farthest(0.0) + 0.01 > farthest(-slope) + 0.01


def test_no_leg_meets_a_plane(robot: RobotModel) -> None:
    for slope in (-0.2, -0.1, 0.0, 0.1, 0.2):
        assert not meets(robot, 0.0, 0.03, slope=slope)


@pytest.mark.parametrize("ahead", [-0.13, 0.02, 0.16])
@pytest.mark.parametrize("lower", [0.08, 0.17])
def test_extents_between_their_positions_are_those_of_the_posed_leg(
    robot: RobotModel, ahead: float, lower: float
) -> None:
    extents, foot, data = leg_extents(robot), robot.feet[0], robot.data()
    stand = robot.standing_configuration()
    pin.framesForwardKinematics(robot.pin, data, stand)
    target = data.oMf[foot.frame_id].copy()
    target.translation = target.translation + np.array([-ahead, 0.0, lower])
    pin.framesForwardKinematics(robot.pin, data, pose_foot(robot, data, stand, foot, target))
    sole, ankle = data.oMf[foot.frame_id], robot.pin.frames[foot.frame_id].parentJoint
    leg = set(robot.pin.supports[ankle]) - {ankle}
    points = []
    for body in leg_shapes(robot).geometryObjects:
        if body.parentJoint in leg:
            place = sole.actInv(data.oMi[body.parentJoint] * body.placement)
            points.append(body.geometry.vertices() @ place.rotation.T + place.translation)
    x, _, z = np.concatenate(points).T
    for height in (0.10, 0.15, 0.20, 0.4, 0.6):
        layer, below = layer_at(height, extents.table.shape[2]), [*foot.rectangle[:2], *x[z <= height]]
        ends = [extent_at(extents, ahead, lower, layer, end) for end in (0, 1)]
        np.testing.assert_allclose(ends, [min(below), max(below)], atol=0.03)


def test_under_the_hip_the_extents_are_those_at_a_foothold(robot: RobotModel) -> None:
    extents = leg_extents(robot)
    for crouch in (0.0, 0.06, 0.1):
        row = [[extent_at(extents, 0.0, crouch, layer, end) for end in (0, 1)] for layer in range(80)]
        np.testing.assert_allclose(row, leg_extent(robot, crouch), atol=0.012)


@pytest.mark.parametrize(("rise", "near", "back"), [(0.20, True, True), (0.20, False, False), (0.10, True, False)])
def test_feet_step_back_first_where_a_knee_would_meet_the_riser(
    robot: RobotModel, rise: float, near: bool, back: bool
) -> None:
    gap = 0.14 if not near else 0.09 if robot.name == "g1" else 0.05
    gait, (_, toe, *_), start = load_gait_config(robot), robot.feet[0].rectangle, Foothold(0.0, 0.0, 0.0)
    axis = 0.02 * np.arange(-75, 75) + 0.01
    ground = Heights(np.where(np.tile(axis[:, None], len(axis)) > toe + gap, rise, 0.0), (-1.5, -1.5), 0.02)
    steps, reason = GroundPlanner(robot, gait).plan(ground, GroundQuery(start, 1.0, soles_at(start, gait.reach.width)))
    places = [step.hold.x for step in steps]
    assert not reason and steps[-1].hold.z > 0.9 * rise
    assert (min(places) < -0.01) == back and min(places) > -0.11
