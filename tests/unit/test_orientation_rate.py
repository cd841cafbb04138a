"""The heading rate of a walk reaches the orientation tasks, by either of their ways into the QP."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from controllers.balance import BalanceController
from models.robot_model import RobotModel
from tests.support import standing


@pytest.mark.parametrize("name", ["base_orientation", "torso_orientation"])
def test_the_heading_rate_is_a_feed_forward(g1: RobotModel, name: str) -> None:
    controller = BalanceController(g1)
    controller.step(standing(g1), 1e-3)
    task, terms = controller.whole_body.tasks[name], controller.whole_body.terms
    turning = replace(controller.reference, heading_rate=0.5)
    before = task.acceleration(terms, controller.reference).copy()
    after = task.acceleration(terms, turning).copy()
    assert after - before == pytest.approx([0.0, 0.0, 14.0 * 0.5], abs=0.2)
    rows = [(np.zeros((3, g1.nv)), np.zeros(3)) for _ in range(2)]
    task.stack(terms, controller.reference, *rows[0])
    task.stack(terms, turning, *rows[1])
    assert rows[1][1] - rows[0][1] == pytest.approx(after - before, abs=1e-9)
