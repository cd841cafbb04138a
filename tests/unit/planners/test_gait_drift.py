"""The estimated place of the robot may jump: the whole plan moves with it."""

import numpy as np
import pytest

from models.robot_model import RobotModel
from models.types import Reference, RobotState
from planners.gait.planner import GaitPlanner
from planners.gait.state import GaitPhase
from tests.gaits import DT, on_one_foot
from tests.support import standing

JUMP = np.array([0.02, -0.03])


def references(model: RobotModel, jump_at: int) -> list[Reference]:
    """Start, swing and touchdown of a robot whose estimated place jumps at a tick."""
    planner = GaitPlanner(model)

    def state(tick: int) -> RobotState:
        q = model.standing_configuration()
        if tick >= jump_at:
            q[:2] += JUMP
        if planner.phase is not GaitPhase.SINGLE or tick >= 500:
            return standing(model, tick * DT, q=q)
        return standing(model, tick * DT, q=q, shares=on_one_foot(planner.stance))

    planner.reset(state(0))
    planner.set_velocity(0.3, 0.0, 0.0)
    out = [planner.step(state(tick), DT) for tick in range(560)]
    assert planner.steps == 1
    return out


@pytest.mark.parametrize("jump_at", [100, 400, 520])
def test_a_jump_of_the_estimate_moves_every_reference_alike(jump_at: int) -> None:
    """In the start, in single support and in double support."""
    model = RobotModel.load("g1")
    for tick, (still, jumped) in enumerate(zip(references(model, 10**6), references(model, jump_at), strict=True)):
        moved = JUMP if tick >= jump_at else np.zeros(2)
        assert still.dcm is not None and jumped.dcm is not None
        assert still.contacts == jumped.contacts
        np.testing.assert_allclose(jumped.dcm, still.dcm + moved, atol=1e-6)
        np.testing.assert_allclose(jumped.sole_positions[:, :2], still.sole_positions[:, :2] + moved, atol=1e-6)
