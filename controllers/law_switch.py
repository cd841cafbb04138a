"""Which law moves the joints: the standing one, or the walker; the hand-over between them is here and nowhere else."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from controllers.head import Head
from controllers.joint_monitor import JointMonitor
from controllers.walker import Walker
from models.applied import Applied
from models.errors import CommandError
from models.types import ControlResult, JointTrajectory, Mode, Reference, RobotState, Vector


class Law(Protocol):
    """What the switch needs of either law."""

    @property
    def reference(self) -> Reference:
        """What the last tick tracked."""
        ...

    @property
    def motion_active(self) -> bool:
        """Whether a motion is being executed."""
        ...

    def reset(self, state: RobotState) -> None:
        """Start over from a state."""
        ...

    def follow(self, trajectory: JointTrajectory) -> None:
        """Start a motion."""
        ...

    def stop_motion(self) -> None:
        """End the motion."""
        ...

    def step(self, state: RobotState, dt: float) -> ControlResult:
        """One tick."""
        ...


class LawSwitch:
    """Runs the walker in mode ``walk`` and the standing law in every other mode.

    Whoever takes over starts from the state at hand: the walker when ``walk`` is entered, the standing law when it is
    left for ``stand``. Left for a mode that moves nothing, neither is touched: ``reset`` precedes the next tick.

    Args:
        standing: Law of the modes ``stand`` and ``motion``.
        walker: Gives the walker, called each time it is needed; None where there is no gait planner.
        monitor: Looks whether the joints do as they are told; None for nobody.
        applied: Notes what the laws are told, for a replay; None for nobody.
        head: The head that both laws turn; None for a robot whose head is fixed.

    Attributes:
        walking: Whether the walker runs.
    """

    def __init__(
        self,
        standing: Law,
        walker: Callable[[], Walker[Any]] | None,
        monitor: JointMonitor | None = None,
        applied: Applied | None = None,
        head: Head | None = None,
    ) -> None:
        self._standing, self._walker, self._monitor = standing, walker, monitor
        self._applied, self._head = applied, head
        self.walking = False

    @property
    def joint_fault(self) -> str:
        """What is wrong with a joint; empty while nothing is."""
        return "" if self._monitor is None else self._monitor.fault

    @property
    def can_walk(self) -> bool:
        """Whether there is a gait planner."""
        return self._walker is not None

    @property
    def active(self) -> Law:
        """The law that runs."""
        return self._walker() if self.walking and self._walker is not None else self._standing

    @property
    def reference(self) -> Reference:
        """What the last tick tracked."""
        return self.active.reference

    @property
    def posture(self) -> tuple[Vector, Vector]:
        """Where motions are planned from: posture (nj,) [rad] and its rate [rad/s], without what the head adds."""
        reference = self.reference
        if self._head is None:
            return reference.posture, reference.posture_velocity
        return self._head.without(reference)

    @property
    def gait_active(self) -> bool:
        """Whether the robot walks, or has not yet come to a standstill."""
        return self.walking and self._walker is not None and not self._walker().standing

    @property
    def motion_active(self) -> bool:
        """Whether the law that runs executes a motion."""
        return self.active.motion_active

    def follow(self, trajectory: JointTrajectory) -> None:
        """Have the law that runs follow a motion; the walker does so with arms and head only."""
        self.active.follow(trajectory)
        if self._head is not None:
            self._head.release(trajectory)

    def look(self, pan: float, tilt: float) -> None:
        """Send the head to joint angles [rad]; a later motion that moves the head takes it over.

        Raises:
            CommandError: The robot has none, or a value is not finite.
        """
        if self._head is None:
            raise CommandError("this robot has no head to turn: its profile names no joints 'head.pan' and 'head.tilt'")
        self._head.command(pan, tilt)
        if self._applied is not None:
            self._applied.note("head", pan, tilt)

    def stop_motion(self) -> None:
        """Have the law that runs end its motion."""
        self.active.stop_motion()
        if self._applied is not None:
            self._applied.note("stop_motion")

    def reset(self, state: RobotState) -> None:
        """Start over from a state, standing."""
        self.walking = False
        self._standing.reset(state)
        if self._head is not None:
            self._head.drop()
        if self._monitor is not None:
            self._monitor.reset()
        if self._applied is not None:
            self._applied.note("reset")

    def enter(self, mode: Mode, state: RobotState) -> None:
        """Hand the robot over as a mode wants it.

        Args:
            mode: The mode from now on.
            state: Newest state.
        """
        walk = mode is Mode.WALK and self._walker is not None
        if walk and not self.walking and self._walker is not None:
            self._walker().reset(state)
        elif self.walking and mode is Mode.STAND:
            self._standing.reset(state)
        if walk is not self.walking and self._applied is not None:
            self._applied.note("walk", walk, mode.value)
        self.walking = walk

    def step(self, state: RobotState, dt: float) -> ControlResult:
        """One tick of the law that runs."""
        result = self.active.step(state, dt)
        if self._head is not None:
            result = self._head.drive(result, self.reference)
        if self._monitor is not None:
            self._monitor.step(state, result.command)
        return result
