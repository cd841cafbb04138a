"""Set-up that tests of several units share."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from controllers.estimation.estimator import StateEstimator
    from models.mujoco_model import MujocoModel
    from models.robot_model import RobotModel


@pytest.fixture
def mj(robot: RobotModel) -> MujocoModel:
    """The robot in MuJoCo, built once a session."""
    from tests.mujoco_states import built

    return built(robot)


@pytest.fixture(scope="module", params=["g1", "talos"])
def estimator(request: pytest.FixtureRequest) -> StateEstimator:
    """An estimator of each robot in turn, the one that ``robot_of`` returns."""
    from controllers.estimation.estimator import StateEstimator

    robot: RobotModel = request.getfixturevalue(request.param)
    result = StateEstimator(robot)
    result.robot = robot  # type: ignore[attr-defined]
    return result
