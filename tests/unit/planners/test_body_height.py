"""The height of the body: within reach of both legs, and on the way there the feet keep bearing."""

import numpy as np
import pytest
from msgspec import structs

from models.constants import GRAVITY
from models.robot_model import RobotModel
from planners.gait.planner import GaitPlanner
from planners.gait.reference import ReferenceBuilder
from planners.gait.scaling import load_gait_config
from planners.gait.state import GaitPhase

DT = 0.001


def heights(robot: RobotModel, *, urgent: bool) -> np.ndarray:
    """Height of the body, its rate and acceleration after a touchdown far to the side (n, 3) [m]."""
    config = load_gait_config(robot)
    builder, gait = ReferenceBuilder(robot, config), GaitPlanner(robot).state.copy()
    left, right = gait.soles.holds
    gait.soles = structs.replace(gait.soles, holds=(left.shifted(0.0, 0.4), right))
    gait.phase, gait.step = GaitPhase.DOUBLE, structs.replace(gait.step, urgent=urgent)
    rows = []
    for i in range(400):
        gait.elapsed = (i + 1) * DT
        gait.body = builder.advance_body(gait, 0.0, 3.8, DT)
        rows.append((gait.body.height, gait.body.rate, gait.body.acceleration))
    return np.array(rows)


@pytest.mark.parametrize("robot", ["g1", "talos"])
def test_a_wide_step_lowers_the_body_and_leaves_half_of_the_weight_on_the_feet(robot: str) -> None:
    model = RobotModel.load(robot)
    rows, urgent = heights(model, urgent=False), heights(model, urgent=True)
    assert rows[-1, 0] < rows[0, 0] - 0.02
    assert np.abs(rows[:, 2]).max() < 0.5 * GRAVITY  # at 0.8 of it TALOS' feet lost all load
    assert urgent[50, 0] < rows[50, 0] - 5e-3  # a leg has to reach far in little time
    assert np.abs(urgent[:, 2]).max() < GRAVITY
