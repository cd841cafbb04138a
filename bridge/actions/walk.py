"""``walk_to``: to a pose, and there it stands."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from bridge.actions.ears import Ears
from bridge.actions.goals import Outcome, Turn
from models.nodes import topics
from models.types import Mode


class WalkTo:
    """Walks to a pose in ``odom``.

    Args:
        ears: Hear and ask.
        kind: Type of the action.
        publish: Publishes a goal on ``goal_pose``.
    """

    def __init__(self, ears: Ears, kind: Any, publish: Callable[[Any], None]) -> None:
        self._ears, self._kind, self._publish = ears, kind, publish

    def refusal(self, request: Any) -> Outcome | None:
        """What is wrong with the pose the gait planner says."""
        return None

    async def run(self, handle: Any, turn: Turn) -> Outcome:
        """Do it; see ``WalkTo.action``."""
        ears = self._ears
        ears.begin()
        reply = await ears.set_mode(Mode.WALK)
        if not reply.accepted:
            return Outcome(False, reply.reason)
        if not await ears.until(lambda: ears.mode == Mode.WALK.value, ears.config.answer_timeout):
            return await self._stand(Outcome(False, f"mode '{ears.mode}' goes on"))
        return await self._stand(await self._walk(handle, turn))

    def result(self, outcome: Outcome) -> Any:
        """Result message of an outcome."""
        return self._kind.Result(success=outcome.success, message=outcome.message)

    async def _walk(self, handle: Any, turn: Turn) -> Outcome:
        """Publish the goal until it is answered, and follow the route to its end."""
        ears, goal, begin = self._ears, handle.request.goal, time.monotonic()
        next_time, config = begin, ears.config
        while True:
            now = time.monotonic()
            word, _, reason = (ears.route[-1] if ears.route else "").partition(": ")
            running = any(each.startswith(topics.ROUTE_RUNNING) for each in ears.route)
            if why := turn.ended or ("" if ears.mode == Mode.WALK.value else f"mode '{ears.mode}'"):
                return Outcome(False, why)
            if handle.is_cancel_requested:
                return Outcome(False, "cancelled", cancelled=True)
            if running and word == topics.ROUTE_DONE:
                return Outcome(True, "there")
            if running and word in (topics.ROUTE_ENDED, topics.ROUTE_REFUSED):
                return Outcome(False, reason)
            if not running and now - begin > config.answer_timeout:
                return Outcome(False, reason or f"no answer on {topics.GAIT_ROUTE} within {config.answer_timeout:g} s")
            if now - begin > config.walk_timeout:
                return Outcome(False, f"not there within {config.walk_timeout:g} s")
            if not running and now >= next_time:
                next_time = now + config.goal_period
                self._publish(goal)
            left = ears.distance(goal.pose.position.x, goal.pose.position.y)
            handle.publish_feedback(self._kind.Feedback(distance=left, route=ears.route[-1] if ears.route else ""))
            await ears.turn()

    async def _stand(self, outcome: Outcome) -> Outcome:
        """Come to a standstill, whatever the outcome; one that does not come is no success."""
        ears = self._ears
        if ears.mode != Mode.WALK.value:
            return outcome
        reply = await ears.set_mode(Mode.STAND)
        stood = reply.accepted and await ears.until(lambda: ears.mode != Mode.WALK.value, ears.config.stand_timeout)
        if stood:
            return Outcome(outcome.success, f"{outcome.message}; mode '{ears.mode}'", outcome.cancelled)
        return Outcome(False, f"{outcome.message}; no standstill: {reply.reason}", outcome.cancelled)
