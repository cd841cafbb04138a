"""Interface of the control stack to the gait planner's node: planners do not import controllers."""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import Protocol

from models.robot_model import RobotModel
from planners.gait.config import GaitConfig
from planners.gait.footsteps import Foothold
from planners.gait.planner import GaitPlanner
from planners.gait.route import Footstep


class GaitStage(Protocol):
    """Gait of the control stack in this process."""

    walking: bool

    def build_gait(self, robot: RobotModel, config: GaitConfig, timer: AbstractContextManager[None]) -> GaitPlanner:
        """Build the gait planner, or replace it."""
        ...

    def hold_velocity(self, forward: float, left: float, turn: float) -> None:
        """Repeat a velocity [m/s, m/s, rad/s] at every tick from now on."""
        ...

    def stop(self) -> None:
        """Come to a standstill."""
        ...

    def walk_to(self, goal: Foothold) -> None:
        """Walk to a pose."""
        ...

    def take_steps(self, steps: Sequence[Footstep]) -> None:
        """Take footsteps."""
        ...
