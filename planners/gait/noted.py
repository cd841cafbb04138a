"""A gait planner that notes what it is told, for a replay."""

from __future__ import annotations

from collections.abc import Sequence

from msgspec import structs

from models.applied import Applied
from models.robot_model import RobotModel
from planners.gait.config import GaitConfig
from planners.gait.footstep_plan import Footstep
from planners.gait.footsteps import Foothold
from planners.gait.gait import GaitPlanner


class NotedGait(GaitPlanner):
    """Notes what was not refused.

    Args:
        model: The robot.
        config: The gait; that of the robot when None.
        applied: Takes the notes.
        held: Whether the velocity is told again at every tick: then only its changes are noted.
    """

    def __init__(self, model: RobotModel, config: GaitConfig | None, applied: Applied, *, held: bool = False) -> None:
        super().__init__(model, config)
        self._applied, self._held = applied, held

    def set_velocity(self, forward: float, left: float, turn: float) -> None:
        """See ``GaitPlanner``."""
        super().set_velocity(forward, left, turn)
        if self._held:
            self._applied.note_change("hold_velocity", forward, left, turn)
        else:
            self._applied.note("velocity", forward, left, turn)

    def stop(self) -> None:
        """See ``GaitPlanner``."""
        super().stop()
        self._applied.note("stop")

    def walk_to(self, goal: Foothold) -> None:
        """See ``GaitPlanner``."""
        super().walk_to(goal)
        self._applied.note("walk_to", *structs.astuple(goal))

    def take_steps(self, steps: Sequence[Footstep]) -> None:
        """See ``GaitPlanner``."""
        super().take_steps(steps)
        self._applied.note("take_steps", [[step.foot, *structs.astuple(step.hold)] for step in steps])
