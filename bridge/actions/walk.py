"""``walk_to``: to a pose, and there it stands."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from bridge.actions.ears import ANSWER_TIMEOUT, Ears
from bridge.actions.goals import Outcome, Turns
from models.nodes import topics
from models.types import Mode

WALK_TIMEOUT = 600.0
"""Longest walk to one goal [s]."""

STAND_TIMEOUT = 10.0
"""Longest wait for a standstill after the last footstep [s]."""

REPEAT = 1.0
"""The goal is published again so often until somebody answers [s]."""


class WalkTo:
    """Walks to a pose in ``odom``.

    Args:
        ears: Hears and asks.
        turns: Numbers the goals.
        kind: Type of the action.
        publish: Publishes a goal on ``goal_pose``.
    """

    def __init__(self, ears: Ears, turns: Turns, kind: Any, publish: Callable[[Any], None]) -> None:
        self._ears, self._turns, self._kind, self._publish = ears, turns, kind, publish

    async def __call__(self, handle: Any) -> Outcome:
        """Do it; see ``WalkTo.action``."""
        ears, goal = self._ears, handle.request.goal
        ended = self._turns.begin()
        reply = await ears.set_mode(Mode.WALK)
        if not reply.accepted:
            return Outcome(False, reply.reason)
        if not await ears.until(lambda: ears.mode == Mode.WALK.value, ANSWER_TIMEOUT):
            return Outcome(False, f"mode '{ears.mode}' goes on")
        ears.route.clear()
        next_time = end = time.monotonic()
        end += WALK_TIMEOUT
        answered = False
        while time.monotonic() < end:
            if why := ended() or ("" if ears.mode == Mode.WALK.value else f"mode '{ears.mode}'"):
                return Outcome(False, why)
            if handle.is_cancel_requested:
                return await self._stand(Outcome(False, "cancelled; it stands where it is", cancelled=True))
            word, _, reason = (ears.route[-1] if ears.route else "").partition(": ")
            answered = answered or word == topics.ROUTE_RUNNING
            if not answered and time.monotonic() >= next_time:
                next_time = time.monotonic() + REPEAT
                self._publish(goal)
            if word == topics.ROUTE_DONE:
                return await self._stand(Outcome(True, "there"))
            if word == topics.ROUTE_ENDED or (word == topics.ROUTE_REFUSED and not _may_pass(reason)):
                return await self._stand(Outcome(False, reason))
            left = ears.distance(goal.pose.position.x, goal.pose.position.y)
            handle.publish_feedback(self._kind.Feedback(distance=left, route=ears.route[-1] if ears.route else ""))
            await ears.turn()
        return await self._stand(Outcome(False, f"not there within {WALK_TIMEOUT:.0f} s"))

    def result(self, outcome: Outcome) -> Any:
        """Result message of an outcome."""
        return self._kind.Result(success=outcome.success, message=outcome.message)

    async def _stand(self, outcome: Outcome) -> Outcome:
        """Come to a standstill first."""
        ears = self._ears
        await ears.set_mode(Mode.STAND)
        if not await ears.until(lambda: ears.mode != Mode.WALK.value, STAND_TIMEOUT):
            return Outcome(False, f"{outcome.message}; no standstill within {STAND_TIMEOUT:.0f} s")
        return outcome


def _may_pass(reason: str) -> bool:
    """Whether the gait planner refuses only because it has not begun mode walk itself."""
    return "mode" in reason
