"""The heading rate of a walk reaches the orientation tasks."""

import pytest
from msgspec.structs import replace

from controllers.balance.controller import BalanceController
from models.robot_model import RobotModel
from tests.support import standing


@pytest.mark.parametrize("name", ["base_orientation", "torso_orientation"])
def test_the_heading_rate_is_a_feed_forward(g1: RobotModel, name: str) -> None:
    controller = BalanceController(g1)
    controller.step(standing(g1), 1e-3)
    task, terms = controller.whole_body.tasks[name], controller.whole_body.terms
    turning = replace(controller.reference, heading_rate=0.5)
    task.update(terms, controller.reference)
    before = task.target.copy()
    task.update(terms, turning)
    assert task.target - before == pytest.approx([0.0, 0.0, 14.0 * 0.5], abs=0.2)
