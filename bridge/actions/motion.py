"""``execute_motion`` and ``joint_trajectory_controller/follow_joint_trajectory``: motions with an end."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from bridge.actions.ears import Ears
from bridge.actions.goals import Outcome, Turn
from controllers.supervisor import GAIT_WORDS
from models.nodes import topics
from models.nodes.messages import doubles
from models.robot_model import RobotModel

STOP = "stop"


async def followed(handle: Any, ears: Ears, turn: Turn, feedback: Callable[[str], None]) -> Outcome:
    """Follow a motion that was asked for, by the words on ``motion/state``, to its end.

    Args:
        handle: Of the goal.
        ears: Hear the words; those of before the goal have been cleared.
        turn: Of the goal.
        feedback: Called with ``requested`` or ``running``.

    Returns:
        How it ended. A motion that cannot go on, or is cancelled, has been stopped.

    Raises:
        CommandError: The supervisor does not answer.
    """
    longest = ears.config.start_timeout
    until = time.monotonic() + longest
    while True:
        running = topics.MOTION_RUNNING in ears.motion
        word, _, reason = (ears.motion[-1] if ears.motion else "").partition(": ")
        if word == topics.MOTION_REFUSED:
            return Outcome(False, reason)
        if word == topics.MOTION_DONE and running:
            return Outcome(False, "stopped by somebody else") if ears.stops else Outcome(True, "played to its end")
        if why := turn.ended:
            await _halt(ears)
            return Outcome(False, why)
        if handle.is_cancel_requested:
            stopped = await _halt(ears)
            return Outcome(False, f"cancelled; {stopped}", cancelled=True)
        if not running and time.monotonic() > until:
            await _halt(ears)
            return Outcome(False, f"the motion did not start within {longest:g} s")
        feedback(topics.MOTION_RUNNING if running else "requested")
        await ears.turn()


async def _halt(ears: Ears) -> str:
    """Have the robot stop what it does, and wait until it has; returns what it does then."""
    if ears.stopped:
        return ears.stopped
    reply = await ears.command(STOP)
    if not reply.accepted:
        return reply.reason
    config = ears.config
    await ears.until(lambda: not ears.at_rest, 2.0 * config.period)  # what was said before takes its time
    over = await ears.until(lambda: ears.at_rest or bool(ears.stopped), config.halt_timeout)
    return "it holds its posture" if over else f"the motion has not ended within {config.halt_timeout:g} s"


class ExecuteMotion:
    """Plays a motion by name.

    Args:
        ears: Hear and ask.
        kind: Type of the action.
    """

    def __init__(self, ears: Ears, kind: Any) -> None:
        self._ears, self._kind = ears, kind

    def refusal(self, request: Any) -> Outcome | None:
        """Words that are no motions: a walk has no end of its own."""
        word = request.motion.strip().lower()
        if word in (*GAIT_WORDS, STOP):
            return Outcome(False, f"'{word}' is no motion; walk with walk_to, or a velocity")
        return None

    async def run(self, handle: Any, turn: Turn) -> Outcome:
        """Do it; see ``ExecuteMotion.action``."""
        ears, begin = self._ears, time.monotonic()
        ears.begin()
        reply = await ears.command(handle.request.motion)
        if not reply.accepted:
            return Outcome(False, reply.reason)

        def feedback(state: str) -> None:
            handle.publish_feedback(self._kind.Feedback(state=state, elapsed=time.monotonic() - begin))

        return await followed(handle, ears, turn, feedback)

    def result(self, outcome: Outcome) -> Any:
        """Result message of an outcome."""
        return self._kind.Result(success=outcome.success, message=outcome.message)


class FollowJointTrajectory:
    """Has the balance controller follow a joint trajectory while it keeps its balance, as MoveIt asks for.

    Args:
        ears: Hear and ask.
        kind: Type of the action.
        model: The robot.
        publish: Publishes a trajectory on ``motion/joint_trajectory``.
    """

    def __init__(self, ears: Ears, kind: Any, model: RobotModel, publish: Callable[[Any], None]) -> None:
        self._ears, self._kind, self._model, self._publish = ears, kind, model, publish

    def refusal(self, request: Any) -> Outcome | None:
        """Joints that there are not; what else is wrong the controller says."""
        codes, names = self._kind.Result, list(request.trajectory.joint_names)
        unknown = [name for name in names if name not in self._model.joint_names]
        if unknown or not names:
            text = f"unknown joint '{unknown[0]}'" if unknown else "no joints are named"
            return Outcome(False, text, code=codes.INVALID_JOINTS)
        strangers = [each.name for each in request.goal_tolerance if each.name not in names]
        if strangers:
            return Outcome(False, f"goal_tolerance of '{strangers[0]}', which does not move", code=codes.INVALID_GOAL)
        if request.multi_dof_trajectory.points:
            return Outcome(False, "multi_dof_trajectory: this robot has no such joints", code=codes.INVALID_GOAL)
        return None

    async def run(self, handle: Any, turn: Turn) -> Outcome:
        """Do it; see ``FollowJointTrajectory.action``."""
        ears, asked, codes = self._ears, handle.request, self._kind.Result
        names = list(asked.trajectory.joint_names)
        ears.begin()
        asked.trajectory.header.frame_id = ""  # it answers no request
        self._publish(asked.trajectory)
        outcome = await followed(handle, ears, turn, lambda state: self._feedback(handle, names))
        if not outcome.success:
            begun = topics.MOTION_RUNNING in ears.motion
            code = codes.PATH_TOLERANCE_VIOLATED if begun else codes.INVALID_GOAL
            return Outcome(False, outcome.message, outcome.cancelled, code)
        worst = self._outside(asked, names)
        return Outcome(False, worst, code=codes.GOAL_TOLERANCE_VIOLATED) if worst else outcome

    def result(self, outcome: Outcome) -> Any:
        """Result message of an outcome."""
        return self._kind.Result(error_code=outcome.code, error_string="" if outcome.success else outcome.message)

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
            if tolerance.position <= 0.0:
                continue
            if posture is None:
                return f"where '{tolerance.name}' ended is not known"
            off = abs(posture[self._model.joint_index(tolerance.name)] - last[tolerance.name])
            if off > tolerance.position:
                return f"'{tolerance.name}' ended {off:.4f} rad off, tolerance {tolerance.position:.4f}"
        return ""
