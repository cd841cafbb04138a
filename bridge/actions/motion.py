"""``execute_motion`` and ``joint_trajectory_controller/follow_joint_trajectory``: motions with an end."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from bridge.actions.ears import Ears
from bridge.actions.goals import Outcome, Turns
from models.nodes import topics
from models.nodes.messages import doubles
from models.robot_model import RobotModel

START_TIMEOUT = 25.0
"""Longest wait for a motion to start: it is planned first [s]."""

STOP = "stop"


async def followed(handle: Any, ears: Ears, ended: Callable[[], str], feedback: Callable[[str], None]) -> Outcome:
    """Follow a motion that was asked for, by the words on ``motion/state``, to its end.

    Args:
        handle: Of the goal.
        ears: Hears the words; those of before the goal are cleared.
        ended: Why the goal cannot go on; empty while it can.
        feedback: Called with ``requested`` or ``running``.
    """
    running, until = False, time.monotonic() + START_TIMEOUT
    while True:
        word, _, reason = (ears.motion[-1] if ears.motion else "").partition(": ")
        if word == topics.MOTION_REFUSED:
            return Outcome(False, reason)
        if word == topics.MOTION_DONE and (running or topics.MOTION_RUNNING in ears.motion):
            return Outcome(True, "played to its end")
        running = running or word == topics.MOTION_RUNNING
        if why := ended():
            return Outcome(False, why)
        if handle.is_cancel_requested:
            await ears.command(STOP)
            return Outcome(False, "cancelled; the robot holds its posture", cancelled=True)
        if not running and time.monotonic() > until:
            return Outcome(False, f"the motion did not start within {START_TIMEOUT:.0f} s")
        feedback(topics.MOTION_RUNNING if running else "requested")
        await ears.turn()


class ExecuteMotion:
    """Plays a motion by name.

    Args:
        ears: Hears and asks.
        turns: Numbers the goals.
        kind: Type of the action.
    """

    def __init__(self, ears: Ears, turns: Turns, kind: Any) -> None:
        self._ears, self._turns, self._kind = ears, turns, kind

    async def __call__(self, handle: Any) -> Outcome:
        """Do it; see ``ExecuteMotion.action``."""
        ears, begin = self._ears, time.monotonic()
        ended = self._turns.begin()
        ears.motion.clear()
        reply = await ears.command(handle.request.motion)
        if not reply.accepted:
            return Outcome(False, reply.reason)

        def feedback(state: str) -> None:
            handle.publish_feedback(self._kind.Feedback(state=state, elapsed=time.monotonic() - begin))

        return await followed(handle, ears, ended, feedback)

    def result(self, outcome: Outcome) -> Any:
        """Result message of an outcome."""
        return self._kind.Result(success=outcome.success, message=outcome.message)


class FollowJointTrajectory:
    """Has the balance controller follow a joint trajectory while it keeps its balance, as MoveIt asks for.

    Args:
        ears: Hears and asks.
        turns: Numbers the goals.
        kind: Type of the action.
        model: The robot.
        publish: Publishes a trajectory on ``motion/joint_trajectory``.
    """

    def __init__(self, ears: Ears, turns: Turns, kind: Any, model: RobotModel, publish: Callable[[Any], None]) -> None:
        self._ears, self._turns, self._kind, self._model, self._publish = ears, turns, kind, model, publish
        self._code = kind.Result.SUCCESSFUL

    async def __call__(self, handle: Any) -> Outcome:
        """Do it; see ``FollowJointTrajectory.action``."""
        ears, asked = self._ears, handle.request
        codes, names = self._kind.Result, list(asked.trajectory.joint_names)
        self._code = codes.INVALID_JOINTS
        unknown = [name for name in names if name not in self._model.joint_names]
        if unknown or not names:
            return Outcome(False, f"unknown joint '{unknown[0]}'" if unknown else "no joints are named")
        self._code = codes.INVALID_GOAL
        if asked.multi_dof_trajectory.points:
            return Outcome(False, "multi_dof_trajectory: this robot has no such joints")
        ended = self._turns.begin()
        ears.motion.clear()
        asked.trajectory.header.frame_id = ""  # it answers no request
        self._publish(asked.trajectory)
        outcome = await followed(handle, ears, ended, lambda state: self._feedback(handle, names))
        if not outcome.success:
            return outcome
        worst = self._outside(asked, names)
        self._code = codes.GOAL_TOLERANCE_VIOLATED if worst else codes.SUCCESSFUL
        return Outcome(False, worst) if worst else outcome

    def result(self, outcome: Outcome) -> Any:
        """Result message of an outcome."""
        return self._kind.Result(error_code=self._code, error_string="" if outcome.success else outcome.message)

    def _feedback(self, handle: Any, names: list[str]) -> None:
        posture = self._ears.posture
        if posture is None:
            return
        message = self._kind.Feedback(joint_names=names)
        message.desired.positions = doubles(np.array([posture[self._model.joint_index(name)] for name in names]))
        handle.publish_feedback(message)

    def _outside(self, asked: Any, names: list[str]) -> str:
        """Joint that ended outside of its tolerance; empty when none did."""
        posture = self._ears.posture
        last = dict(zip(names, asked.trajectory.points[-1].positions, strict=True))
        for tolerance in asked.goal_tolerance:
            if posture is None or tolerance.position <= 0.0 or tolerance.name not in last:
                continue
            off = abs(posture[self._model.joint_index(tolerance.name)] - last[tolerance.name])
            if off > tolerance.position:
                return f"'{tolerance.name}' ended {off:.4f} rad off, tolerance {tolerance.position:.4f}"
        return ""
