"""Toe-off: the rear sole turns about its edge, which stays where it is, and the swing begins as the sole turns."""

import numpy as np
import pytest

from models.robot_model import RobotModel
from models.types import Reference
from planners.gait.footing import FLAT, Footing, ToeOff
from planners.gait.pace import pace_at
from planners.gait.planner import GaitPlanner
from planners.gait.reference import ReferenceBuilder
from planners.gait.scaling import load_gait_config
from planners.gait.state import GaitPhase
from planners.gait.swing import SwingFoot
from tests.support import standing

DT, DOUBLE, TURN = 1e-4, 0.06, 0.8


@pytest.fixture(scope="module")
def footing(g1: RobotModel) -> Footing:
    return Footing(g1, load_gait_config(g1).footing)


def turned(footing: Footing, time: float, ahead: float = 0.3) -> ToeOff:
    return footing.toe_off(0, ahead, TURN, time, DOUBLE)


@pytest.fixture(scope="module")
def planner(g1: RobotModel) -> GaitPlanner:
    planner = GaitPlanner(g1)
    planner.reset(standing(g1))
    return planner


def reference(planner: GaitPlanner, toe_off: ToeOff) -> Reference:
    state = planner.state.copy()
    state.phase, state.toe_off = GaitPhase.DOUBLE, toe_off
    return ReferenceBuilder(planner.model, planner.config).build(state, (0.5, 0.5), None)


@pytest.mark.parametrize("ahead", [0.3, -0.3])
def test_it_turns_about_the_edge_towards_the_other_foot(planner: GaitPlanner, footing: Footing, ahead: float) -> None:
    flat, edge = reference(planner, FLAT), planner.model.feet[0].rectangle[1 if ahead > 0.0 else 0]
    point = np.array([edge, 0.0, 0.0])
    place = flat.sole_positions[0] + flat.sole_rotations[0] @ point
    for time in (0.02, 0.04, 0.06):
        found = reference(planner, turned(footing, time, ahead))
        assert found.sole_positions[0] + found.sole_rotations[0] @ point == pytest.approx(place, abs=1e-12)
        assert found.sole_positions[0][2] > flat.sole_positions[0][2]
        np.testing.assert_array_equal(found.sole_positions[1], flat.sole_positions[1])
    turn = flat.sole_rotations[0].T @ found.sole_rotations[0]
    assert np.arctan2(turn[0, 2], turn[0, 0]) == pytest.approx(TURN * ahead)


def test_its_motion_is_the_derivative_of_its_pose(planner: GaitPlanner, footing: Footing) -> None:
    before, here, after = (reference(planner, turned(footing, 0.05 + i * DT)) for i in (-1, 0, 1))
    speed = (after.sole_positions[0] - before.sole_positions[0]) / (2.0 * DT)
    rate = (after.sole_velocities[0] - before.sole_velocities[0]) / (2.0 * DT)
    assert here.sole_velocities[0][:3] == pytest.approx(speed, abs=1e-4)
    assert here.sole_accelerations[0] == pytest.approx(rate, abs=1e-2)
    turning = (after.sole_rotations[0] - before.sole_rotations[0]) / (2.0 * DT) @ here.sole_rotations[0].T
    axis = np.array([turning[2, 1], turning[0, 2], turning[1, 0]])
    assert here.sole_velocities[0][3:] == pytest.approx(axis, abs=1e-3)


def test_feet_side_by_side_lie_flat(footing: Footing) -> None:
    assert turned(footing, DOUBLE, 0.01) == FLAT


def test_it_bears_on_its_edge_alone(planner: GaitPlanner, footing: Footing) -> None:
    state = planner.state
    found = footing.update(state.footing, state.measured, None, np.zeros(2), 0.001, toe_off=turned(footing, 0.03))
    assert found.areas[0, 0] == found.areas[0, 1] == planner.model.feet[0].rectangle[1]
    np.testing.assert_array_equal(found.areas[1], state.footing.areas[1])


def test_a_robot_that_starts_over_stands_on_its_whole_soles(planner: GaitPlanner, footing: Footing) -> None:
    planner.state.phase, planner.state.toe_off = GaitPhase.DOUBLE, turned(footing, 0.03)
    planner.reset(standing(planner.model))
    areas = planner.step(standing(planner.model), 0.001).sole_areas
    np.testing.assert_array_equal(areas, [foot.rectangle for foot in planner.model.feet])


def test_the_swing_begins_where_and_as_the_sole_turns(planner: GaitPlanner, footing: Footing) -> None:
    toe_off, hold = turned(footing, DOUBLE), planner.footholds[0]
    expected, law = reference(planner, toe_off), SwingFoot(planner.config.swing)
    pose = np.array([hold.x, hold.y, hold.z, hold.yaw])
    foot = law.lift(pose, 0.05, 0.4, planner.state.soles.tilts[0], toe_off=toe_off)
    assert foot.motion[0, :3] == pytest.approx(expected.sole_positions[0], abs=1e-3)
    assert foot.motion[1, :3] == pytest.approx(expected.sole_velocities[0, :3], abs=0.02)
    assert foot.tilt[0] == pytest.approx(-np.tan(toe_off.angle), abs=0.01)
    assert foot.floor == hold.z


def test_a_disturbed_walk_keeps_its_rear_sole_flat(planner: GaitPlanner) -> None:
    config = planner.config.pace
    assert pace_at(1.0, config).toe_off == config.fast.toe_off
    assert pace_at(1.0, config, urgency=1.0).toe_off == 0.0
