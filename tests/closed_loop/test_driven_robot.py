"""The simulated robot with its drivers: what a mode does to them, and how little their torque steps."""

from __future__ import annotations

import pytest

from bridge.loop_config import LoopConfig
from bridge.mujoco_plant import MujocoPlant
from bridge.ros.driven_robot import DrivenRobot
from controllers.joint_servo import ServoState
from models.config import default_config
from models.errors import CommandError
from models.robot_model import RobotModel
from models.types import Mode


@pytest.fixture
def driven(g1: RobotModel) -> DrivenRobot:
    return DrivenRobot(MujocoPlant(g1), default_config(LoopConfig, "bridge", "closed_loop"))


def test_active_drivers_are_switched_off_through_damp_only(driven: DrivenRobot) -> None:
    driven.set_mode(Mode.STAND)
    driven.plant.hold(False)
    with pytest.raises(CommandError, match="'damp' comes first"):
        driven.set_mode(Mode.OFF)
    assert driven.servo.state is ServoState.ACTIVE
    assert driven.awaits_command  # still in mode stand
    driven.set_mode(Mode.DAMP)
    driven.set_mode(Mode.OFF)
    assert driven.servo.state is ServoState.OFF
