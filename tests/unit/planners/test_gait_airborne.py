"""When a walking robot counts as lifted, and when as put down."""

import numpy as np
import pytest

from models.config import default_config
from models.robot_model import RobotModel
from planners.gait.config import GaitConfig
from planners.gait.contact import AirborneDetector
from planners.gait.measurement import GaitMeasurement
from planners.gait.reference import ReferenceBuilder
from tests.support import standing

GAIT = default_config(GaitConfig, "planners", "gait")
CONFIG = GAIT.lift
DT = 0.001


class Watched:
    """A detector, tick by tick."""

    def __init__(self, model: RobotModel) -> None:
        self._law, self.joints = AirborneDetector(model, CONFIG), model.posture("stand")
        self.state = self._law.on_floor

    def watch(self, bearing: tuple[bool, bool], time: float) -> bool:
        """Watch for a time [s]; whether the robot was put down meanwhile."""
        down = False
        for _ in range(round(time / DT)):
            self.state, now = self._law.update(self.state, bearing, self.joints, DT)
            down = down or now
        return down


@pytest.fixture
def lifted(g1: RobotModel) -> Watched:
    return Watched(g1)


def test_it_is_held_soon_and_lifted_later_and_one_foot_is_enough_to_go_on(lifted: Watched) -> None:
    assert not lifted.watch((True, False), 1.0) and not lifted.state.active
    assert not lifted.watch((False, False), CONFIG.float_time - DT) and not lifted.state.active
    assert not lifted.watch((True, False), DT) and not lifted.watch((False, False), 2 * DT)
    assert not lifted.state.active  # the time counts from the last load
    assert not lifted.watch((False, False), 0.8 * CONFIG.up_time)
    assert lifted.state.active and not lifted.state.confirmed
    assert not lifted.watch((False, True), DT) and not lifted.state.active


def test_lifted_it_stays_held_until_both_feet_bear_for_a_while(lifted: Watched) -> None:
    lifted.watch((False, False), CONFIG.up_time + 2 * DT)
    assert lifted.state.active and lifted.state.confirmed
    assert not lifted.watch((True, False), 1.0)
    assert not lifted.watch((True, True), CONFIG.down_time - DT)
    assert not lifted.watch((False, True), DT) and lifted.state.active
    assert lifted.watch((True, True), CONFIG.down_time + DT)


def test_the_reference_is_the_posture_of_the_moment_without_any_contact(g1: RobotModel, lifted: Watched) -> None:
    lifted.watch((False, False), CONFIG.float_time)
    posture = lifted.joints
    lifted.joints = posture + 0.1
    lifted.watch((False, False), DT)
    state = standing(g1, shares=(0.0, 0.0))
    measured = GaitMeasurement(g1).measure(state)
    reference = ReferenceBuilder(g1, GAIT).build_airborne(lifted.state, state, measured)
    assert reference.contacts == (False, False)
    assert reference.posture == pytest.approx(posture)
    assert np.allclose(reference.sole_rotations, np.eye(3))
