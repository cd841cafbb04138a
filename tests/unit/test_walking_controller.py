"""The walking controller: the CMP stays where the stance sole, shifted by the swing leg's reaction, can give it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from controllers.walking import WalkingController
from models.robot_model import RobotModel
from models.types import ContactState, Reference, RobotState
from planners.gait.gait import GaitPlanner


def standing(model: RobotModel) -> RobotState:
    return RobotState(
        t=0.0,
        q=model.standing_configuration(),
        v=np.zeros(model.nv),
        tau=np.zeros(model.nj),
        contacts=(ContactState(True, np.zeros(6)), ContactState(True, np.zeros(6))),
    )


@pytest.fixture(scope="module")
def case() -> tuple[WalkingController, RobotState, Reference]:
    """On the left foot, with a DCM reference so far ahead that the CMP is at the heel."""
    model = RobotModel.load("g1")
    state, planner = standing(model), GaitPlanner(model)
    planner.reset(state)
    reference = planner.step(state, 0.001)
    assert reference.dcm is not None
    ahead = replace(reference, contacts=(True, False), load=(1.0, 0.0), dcm=reference.dcm + np.array([1.0, 0.0]))
    controller = WalkingController(model)
    controller.reset(state)
    return controller, state, ahead


def cmp_at(case: tuple[WalkingController, RobotState, Reference], offset: np.ndarray | None) -> np.ndarray:
    controller, state, reference = case
    zmp = controller.step(state, replace(reference, cmp_offset=offset), 0.001).zmp
    assert zmp is not None
    return zmp


def test_the_cmp_is_kept_inside_the_stance_sole(case: tuple[WalkingController, RobotState, Reference]) -> None:
    heel = case[0].model.feet[0].rectangle[0]
    assert cmp_at(case, None)[0] == pytest.approx(heel, abs=1e-6)


def test_the_reaction_shifts_where_it_may_be(case: tuple[WalkingController, RobotState, Reference]) -> None:
    without = cmp_at(case, None)
    assert cmp_at(case, np.array([-0.1, 0.02])) - without == pytest.approx([-0.1, 0.02], abs=1e-6)


def test_the_shift_is_bounded(case: tuple[WalkingController, RobotState, Reference]) -> None:
    reach = case[0].config.reaction_reach_max
    without = cmp_at(case, None)
    assert cmp_at(case, np.array([-10.0, 0.0]))[0] - without[0] == pytest.approx(-reach, abs=1e-6)
