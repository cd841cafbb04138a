"""Gaits of the tests, brought to where something is to happen."""

from models.robot_model import RobotModel
from planners.gait.config import GaitConfig
from planners.gait.planner import GaitPlanner
from planners.gait.state import GaitPhase
from tests.support import standing

DT = 0.002
"""Tick of these gaits [s]."""


def on_one_foot(stance: int) -> tuple[float, float]:
    """Shares of the weight on the feet when one of them bears it alone."""
    return (1.0, 0.0) if stance == 0 else (0.0, 1.0)


def in_single_support(model: RobotModel, config: GaitConfig | None = None, *, stance: int = 1) -> GaitPlanner:
    """A gait that has just lifted its first foot.

    Args:
        model: The robot.
        config: The gait; that of the robot when None.
        stance: The foot that bears.
    """
    planner = GaitPlanner(model, config)
    planner.reset(standing(model))
    planner.set_velocity(0.2, 0.1 if stance == 1 else -0.1, 0.0)  # the foot on the side of the velocity goes first
    while planner.phase is not GaitPhase.SINGLE:
        planner.step(standing(model), DT)
    return planner
