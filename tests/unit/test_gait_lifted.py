"""When a walking robot counts as lifted, and when as put down."""

from __future__ import annotations

import numpy as np
import pytest

from models.config import default_config
from models.robot_model import RobotModel
from models.types import RobotState
from planners.gait.config import GaitConfig
from planners.gait.lifted import Lifted
from tests.support import standing

CONFIG = default_config(GaitConfig, "planners", "gait").lift
DT = 0.001


@pytest.fixture
def state(g1: RobotModel) -> RobotState:
    return standing(g1, shares=(0.0, 0.0))


def look(lifted: Lifted, state: RobotState, bearing: tuple[bool, bool], time: float) -> bool:
    """Look for a time [s]; whether it was put down meanwhile."""
    down = [lifted.update(bearing, state, DT) for _ in range(round(time / DT))]
    return any(down)


def test_it_is_held_soon_and_lifted_later_and_one_foot_is_enough_to_go_on(g1: RobotModel, state: RobotState) -> None:
    lifted = Lifted(g1, CONFIG)
    assert not look(lifted, state, (True, False), 1.0) and not lifted.active
    assert not look(lifted, state, (False, False), CONFIG.float_time - DT) and not lifted.active
    assert not look(lifted, state, (True, False), DT) and not look(lifted, state, (False, False), 2 * DT)
    assert not lifted.active  # the time counts from the last load
    assert not look(lifted, state, (False, False), 0.8 * CONFIG.up_time) and lifted.active and not lifted.confirmed
    assert not look(lifted, state, (False, True), DT) and not lifted.active


def test_lifted_it_stays_held_until_both_feet_bear_for_a_while(g1: RobotModel, state: RobotState) -> None:
    lifted = Lifted(g1, CONFIG)
    look(lifted, state, (False, False), CONFIG.up_time + 2 * DT)
    assert lifted.active and lifted.confirmed
    assert not look(lifted, state, (True, False), 1.0)
    assert not look(lifted, state, (True, True), CONFIG.down_time - DT)
    assert not look(lifted, state, (False, True), DT) and lifted.active
    assert look(lifted, state, (True, True), CONFIG.down_time + DT)
    lifted.reset()
    assert not lifted.active and not lifted.confirmed


def test_the_reference_is_the_posture_of_the_moment_without_any_contact(g1: RobotModel, state: RobotState) -> None:
    lifted = Lifted(g1, CONFIG)
    look(lifted, state, (False, False), CONFIG.float_time)
    later = RobotState(1.0, state.q + 0.0, state.v, state.tau, state.contacts)
    later.q[7:] += 0.1
    reference = lifted.reference(later, np.zeros(3), [])
    assert reference.contacts == (False, False)
    assert reference.posture == pytest.approx(state.q[7:])
