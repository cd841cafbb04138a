"""A mirrored robot with a mirrored command is given the mirrored reference."""

from dataclasses import replace

import numpy as np
import pytest

from models.robot_model import RobotModel
from models.types import Reference, RobotState
from planners.gait.planner import GaitPlanner
from planners.gait.scaling import load_gait_config
from planners.gait.state import GaitPhase
from tests.support import standing

DT = 0.002
FLIP = np.array([1.0, -1.0, 1.0])


def references(model: RobotModel, side: float, foot: int) -> list[Reference]:
    """Start, one swing that a lateral push disturbs, and the touchdown after it; ``foot`` is the one that swings."""
    config = load_gait_config(model)
    # The feet of this robot stay where they are: none of them has been caught.
    swing = replace(config.swing, trip_lag=10.0)
    # Urgency is a switch, which the robots' own CoM, off their middle, would throw at different ticks.
    planner = GaitPlanner(model, replace(config, swing=swing, adjustment=replace(config.adjustment, urgent=1.0)))

    def state(t: float) -> RobotState:
        v = np.zeros(model.nv)
        if planner.phase is not GaitPhase.SINGLE:
            return standing(model, t)
        v[0], v[1] = 0.1, 0.15 * side
        if t >= 1.0:
            return standing(model, t, v=v)
        return standing(model, t, v=v, shares=(0.0, 0.5) if foot == 0 else (0.5, 0.0))

    planner.reset(state(0.0))
    planner.set_velocity(0.3, 0.2 * side, 0.3 * side)
    out = [planner.step(state(i * DT), DT) for i in range(600)]
    assert planner.steps == 1
    return out


@pytest.mark.parametrize("name", ["g1", "talos"])
def test_mirrored_in_mirrored_out(name: str) -> None:
    model = RobotModel.load(name)
    shifted = 0  # ticks by which the adjusted step times differ
    before = (True, True)
    for here, there in zip(references(model, 1.0, 0), references(model, -1.0, 1), strict=True):
        landed, before = here.contacts == (True, True) != before, here.contacts
        if there.contacts != here.contacts[::-1]:
            shifted += 1
            continue
        assert there.load == pytest.approx(here.load[::-1], abs=0.02)
        assert here.dcm is not None and there.dcm is not None
        # The robots' own CoM is off their middle by millimetres, which the time of a step multiplies. At a touchdown
        # the reference is that of feet that are off the plan: they do not move in this test.
        np.testing.assert_allclose(there.dcm, here.dcm * FLIP[:2], atol=0.05 if landed else 0.015)
        np.testing.assert_allclose(there.sole_positions, here.sole_positions[::-1] * FLIP, atol=0.015)
        assert there.heading_rate == pytest.approx(-here.heading_rate, abs=0.02)
    assert shifted <= 5
