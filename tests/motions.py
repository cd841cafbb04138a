"""Motion planners of the tests, one a robot."""

from functools import cache

from models.robot_model import RobotModel
from planners.motion import MotionPlanner


@cache
def load(name: str) -> tuple[RobotModel, MotionPlanner]:
    """A robot and its motion planner."""
    model = RobotModel.load(name)
    return model, MotionPlanner(model)
