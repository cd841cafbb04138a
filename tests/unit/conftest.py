"""Set-up that tests of several units share."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from models.mujoco_model import MujocoModel
    from models.robot_model import RobotModel


@pytest.fixture
def mj(robot: RobotModel) -> MujocoModel:
    """The robot in MuJoCo, built once a session."""
    from tests.mujoco_states import built

    return built(robot)
