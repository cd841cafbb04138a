"""Gait planner and walking controller in one: the walking robot of the closed loop."""

from __future__ import annotations

from controllers.walking import WalkingController
from models.robot_model import RobotModel
from models.types import ControlResult, Reference, RobotState
from planners.gait.config import GaitConfig
from planners.gait.gait import GaitPlanner


class Walker:
    """Plans and tracks a gait, tick by tick, in place of the balance controller.

    Args:
        model: The robot.
        gait: The gait; that of the robot when None.

    Attributes:
        planner: When which foot lifts and lands.
        controller: Tracks what the planner wants.
    """

    def __init__(self, model: RobotModel, gait: GaitConfig | None = None) -> None:
        self.planner = GaitPlanner(model, gait)
        self.controller = WalkingController(model)

    @property
    def reference(self) -> Reference:
        """What the last tick tracked."""
        return self.controller.reference

    @property
    def standing(self) -> bool:
        """Whether it has come to a standstill."""
        return self.planner.settled

    def start(self, state: RobotState) -> None:
        """Take over a robot that stands on both feet."""
        self.planner.reset(state)
        self.controller.reset(state)

    def step(self, state: RobotState, dt: float) -> ControlResult:
        """One tick."""
        return self.controller.step(state, self.planner.step(state, dt), dt)
