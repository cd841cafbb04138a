"""A gait and the controller that tracks it, in one: the law of the mode ``walk``."""

from __future__ import annotations

from typing import Generic, Protocol, TypeVar

from controllers.head import Head
from controllers.upper_body import UpperBodyMotion
from controllers.walking import WalkingController
from models.types import ControlResult, JointTrajectory, Reference, RobotState


class Gait(Protocol):
    """What the walker needs of a gait planner."""

    @property
    def settled(self) -> bool:
        """Whether the robot has come to a standstill."""
        ...

    def reset(self, state: RobotState) -> None:
        """Start over from a robot that stands on both feet."""
        ...

    def step(self, state: RobotState, dt: float) -> Reference:
        """One tick: what the controller is to track."""
        ...


G = TypeVar("G", bound=Gait)


class Walker(Generic[G]):
    """Plans and tracks a gait, tick by tick, in place of the balance controller.

    Args:
        planner: When which foot lifts and lands.
        controller: Tracks what the planner wants.
        upper: Motions of arms and head meanwhile; a new one when None.
        head: Turns the head on top of them; None for nobody.

    Attributes:
        planner: When which foot lifts and lands.
        controller: Tracks what the planner wants.
    """

    def __init__(
        self,
        planner: G,
        controller: WalkingController,
        upper: UpperBodyMotion | None = None,
        head: Head | None = None,
    ) -> None:
        self.planner, self.controller, self._head = planner, controller, head
        self._upper = upper or UpperBodyMotion(controller.model, controller.config.motion_fade)

    @property
    def reference(self) -> Reference:
        """What the last tick tracked."""
        return self.controller.reference

    @property
    def standing(self) -> bool:
        """Whether it has come to a standstill."""
        return self.planner.settled

    def reset(self, state: RobotState) -> None:
        """Take over a robot that stands on both feet."""
        self._upper.drop()
        self.planner.reset(state)
        self.controller.reset(state)

    def step(self, state: RobotState, dt: float) -> ControlResult:
        """One tick."""
        reference = self._upper.step(self.planner.step(state, dt), dt)
        if self._head is not None:
            reference = self._head.into(reference, dt)
        return self.controller.step(state, reference, dt)

    @property
    def motion_active(self) -> bool:
        """Whether arms and head follow a motion."""
        return self._upper.active

    def follow(self, trajectory: JointTrajectory) -> None:
        """Have arms and head follow a motion while the legs go on; see ``UpperBodyMotion.follow`` for refusals."""
        posture = self.reference.posture
        if self._head is not None:
            posture, _ = self._head.without(self.reference, trajectory)
        self._upper.follow(trajectory, posture)

    def stop_motion(self) -> None:
        """Arms and head return to the posture of the walk."""
        self._upper.stop()
