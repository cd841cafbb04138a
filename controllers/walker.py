"""A gait and the controller that tracks it, in one: the law of the mode ``walk``."""

from __future__ import annotations

from typing import Generic, Protocol, TypeVar

from controllers.walking import WalkingController
from models.types import ControlResult, Reference, RobotState


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

    Attributes:
        planner: When which foot lifts and lands.
        controller: Tracks what the planner wants.
    """

    def __init__(self, planner: G, controller: WalkingController) -> None:
        self.planner, self.controller = planner, controller

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
        self.planner.reset(state)
        self.controller.reset(state)

    def step(self, state: RobotState, dt: float) -> ControlResult:
        """One tick."""
        return self.controller.step(state, self.planner.step(state, dt), dt)
