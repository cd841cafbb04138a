"""Where a walk ends: in a stance that the robot can stay in."""

import pytest

from models.robot_model import RobotModel
from models.types import RobotState
from planners.gait.planner import GaitPlanner
from planners.gait.state import GaitPhase
from tests.gaits import DT, in_single_support, on_one_foot
from tests.support import standing


def straddling(model: RobotModel, angle: float, shares: tuple[float, float]) -> RobotState:
    """One leg of the G1 swung back by an angle [rad], the other one as far ahead, the soles level."""
    q = model.standing_configuration()
    for foot, sign in zip(model.feet, (1.0, -1.0), strict=True):
        hip, ankle = foot.joint_ids_v[0], foot.joint_ids_v[4]  # about y both
        q[hip + 1] += sign * angle
        q[ankle + 1] -= sign * angle
    return standing(model, q=q, shares=shares)


def one_step(planner: GaitPlanner, angle: float) -> None:
    """Through the double support, if any, and a single support that ends with the legs swung apart."""
    steps = planner.steps
    while planner.phase is GaitPhase.DOUBLE:
        planner.step(straddling(planner.model, angle, (0.5, 0.5)), DT)
    assert planner.phase is GaitPhase.SINGLE
    for _ in range(round(planner.state.pace.single / DT)):
        planner.step(straddling(planner.model, angle, on_one_foot(planner.stance)), DT)
    planner.step(straddling(planner.model, angle, (0.5, 0.5)), DT)
    assert planner.steps == steps + 1


def apart(planner: GaitPlanner) -> float:
    """How far the right sole is ahead of the left one [m]."""
    left, right = planner.footholds
    return right.x - left.x


@pytest.mark.parametrize(("angle", "more"), [(0.25, False), (0.34, True)])
def test_a_walk_does_not_end_far_astride(g1: RobotModel, angle: float, more: bool) -> None:
    """Stopped in its first step it would end with the second one, which lands too far ahead to stay there."""
    planner = in_single_support(g1)
    planner.stop()
    one_step(planner, 0.0)
    assert planner.phase is GaitPhase.DOUBLE
    one_step(planner, angle)
    assert (apart(planner) > planner.config.astride_max) == more
    assert not planner.must_step  # it is no fall that has it step again
    assert planner.phase is (GaitPhase.DOUBLE if more else GaitPhase.FINISH)
    if more:
        one_step(planner, 0.0)
        assert planner.phase is GaitPhase.FINISH and abs(apart(planner)) < 0.12
