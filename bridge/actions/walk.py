"""``walk_to``: walk to a pose and stand there."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from bridge.actions.goals import Outcome, Turn
from bridge.actions.robot import RobotClient
from models.status import RouteState, RouteStatus
from models.types import Mode


class WalkTo:
    """Walks to a pose in ``odom``; ``publish`` publishes a goal on ``goal_pose``."""

    def __init__(self, robot: RobotClient, kind: Any, publish: Callable[[Any], None]) -> None:
        self._robot, self._kind, self._publish = robot, kind, publish

    def refusal(self, request: Any) -> Outcome | None:
        """Refuse nothing: the gait planner checks the pose."""
        return None

    async def run(self, handle: Any, turn: Turn) -> Outcome:
        """Execute the goal; see ``WalkTo.action``."""
        robot = self._robot
        robot.begin()
        reply = await robot.set_mode(Mode.WALK)
        if not reply.accepted:
            return Outcome(False, reply.reason)
        if not await robot.until(lambda: robot.mode == Mode.WALK.value, robot.config.answer_timeout):
            return await self._stand(Outcome(False, f"mode '{robot.mode}' goes on"))
        return await self._stand(await self._walk(handle, turn))

    def result(self, outcome: Outcome) -> Any:
        """Result message of an outcome."""
        return self._kind.Result(success=outcome.success, message=outcome.message)

    async def _walk(self, handle: Any, turn: Turn) -> Outcome:
        """Publish the goal until it is answered, and follow the route to its end."""
        robot, goal, begin = self._robot, handle.request.goal, time.monotonic()
        next_time, config = begin, robot.config
        while True:
            now = time.monotonic()
            newest = robot.route[-1] if robot.route else RouteStatus(RouteState.ENDED)
            running = any(status.state is RouteState.RUNNING for status in robot.route)
            if why := turn.ended or ("" if robot.mode == Mode.WALK.value else f"mode '{robot.mode}'"):
                return Outcome(False, why)
            if handle.is_cancel_requested:
                return Outcome(False, "cancelled", cancelled=True)
            if running and newest.state is RouteState.DONE:
                return Outcome(True, "there")
            if running and newest.state is not RouteState.RUNNING:
                return Outcome(False, newest.reason)
            if not running and now - begin > config.answer_timeout:
                return Outcome(False, newest.reason or f"no answer to the goal within {config.answer_timeout:g} s")
            if now - begin > config.walk_timeout:
                return Outcome(False, f"not there within {config.walk_timeout:g} s")
            if not running and now >= next_time:
                next_time = now + config.goal_period
                self._publish(goal)
            left = robot.distance(goal.pose.position.x, goal.pose.position.y)
            handle.publish_feedback(self._kind.Feedback(distance=left, route=str(newest) if robot.route else ""))
            await robot.turn()

    async def _stand(self, outcome: Outcome) -> Outcome:
        """Come to a standstill, whatever the outcome; without a standstill it is no success."""
        robot = self._robot
        if robot.mode != Mode.WALK.value:
            return outcome
        reply = await robot.set_mode(Mode.STAND)
        stood = reply.accepted and await robot.until(lambda: robot.mode != Mode.WALK.value, robot.config.stand_timeout)
        if stood:
            return Outcome(outcome.success, f"{outcome.message}; mode '{robot.mode}'", outcome.cancelled)
        return Outcome(False, f"{outcome.message}; no standstill: {reply.reason}", outcome.cancelled)
