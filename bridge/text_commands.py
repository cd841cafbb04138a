"""Text commands in the closed loop: from the supervisor's answer to the law in charge."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from bridge.lockstep import Lockstep
from models.errors import PoiseError
from models.robot_model import RobotModel
from models.types import CommandReply
from planners.motion import MotionPlanner


class Walk(Protocol):
    """Who takes a walk's velocities: the gait, or what stands before it."""

    def set_velocity(self, forward: float, left: float, turn: float) -> None:
        """Walk with a velocity [m/s, m/s, rad/s]."""
        ...

    def stop(self) -> None:
        """Come to a standstill."""
        ...


class TextCommands:
    """Has the supervisor answer, and carries out what it accepts.

    Args:
        robot: The robot.
        lockstep: Whose supervisor and laws.
        walk: Who takes the velocities.
    """

    def __init__(self, robot: RobotModel, lockstep: Lockstep, walk: Callable[[], Walk]) -> None:
        self._robot, self._lockstep, self._walk = robot, lockstep, walk
        self._planner: MotionPlanner | None = None

    def run(self, text: str) -> CommandReply:
        """Carry out a text command (wave, squat, walk, forward, stop, ...), or say why not."""
        lockstep, supervisor = self._lockstep, self._lockstep.supervisor
        before = supervisor.mode
        reply = supervisor.text(text)
        if supervisor.mode is not before:
            lockstep.enter_mode()
        velocity = supervisor.take_velocity()
        if velocity is not None:
            walk = self._walk()
            walk.set_velocity(*velocity) if any(velocity) else walk.stop()
        motion = supervisor.take_motion()
        if motion == "stop":
            lockstep.laws.stop_motion()
        elif motion is not None:
            reply = self._begin(motion, reply)
        return reply

    def _begin(self, motion: str, reply: CommandReply) -> CommandReply:
        """Plan a motion from the posture that the law in charge tracks, and have it follow."""
        self._planner = self._planner or MotionPlanner(self._robot)
        laws = self._lockstep.laws
        try:
            self._lockstep.follow(self._planner.plan(motion, start_q=laws.posture[0]))
        except PoiseError as error:
            return self._lockstep.supervisor.motion_refused(str(error))
        return reply
