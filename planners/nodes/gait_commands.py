"""Gait commands besides velocity: walks to a pose or along listed footsteps, and services that plan them."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from nav_msgs.srv import GetPlan
from std_msgs.msg import String

from models.errors import CommandError, MessageError, PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.qos import EVENT, LATCHED_EVENT
from models.nodes.services import offer_own
from models.status import RouteState, RouteStatus
from planners.gait.commands import VelocityCommand
from planners.gait.footsteps import Foothold
from planners.gait.planner import GaitPlanner
from planners.gait.route import Footstep, plan_to_pose, soles_at, touchdown_times
from planners.nodes.footstep_messages import footstep_message, goal_from_message, path_from_steps, steps_from_path
from planners.nodes.gait_link import GaitStage
from planners.nodes.ground_walk import GroundWalk


class RouteTopics:
    """Commands walks to a pose or along listed footsteps, in mode ``walk`` only, and publishes their status.

    A route ends the velocity ``command``, and a later velocity ends the route. ``ready`` returns why the robot cannot
    walk now, empty if it can. ``soles`` returns the soles of a standing robot, or raises ``CommandError``. ``now``
    returns the stamp of the newest state [ns].
    """

    def __init__(
        self,
        node: PoiseNode,
        law: GaitPlanner,
        stack: GaitStage,
        command: VelocityCommand,
        ready: Callable[[], str],
        soles: Callable[[], Sequence[Foothold]],
        now: Callable[[], int],
        ground: GroundWalk,
    ) -> None:
        self._node, self._law, self._stack, self._command, self._ready = node, law, stack, command, ready
        self._ground = ground
        self._soles, self._now = soles, now
        self._running = False
        self._words = node.announce(String, topics.GAIT_ROUTE, EVENT)
        self._publish_status = node.announce_status(topics.ROUTE_STATUS, LATCHED_EVENT)
        node.listen(PoseStamped, topics.GOAL_POSE, partial(self._try, self._go), EVENT, while_active=True)
        node.listen(Path, topics.FOOTSTEPS_COMMAND, partial(self._try, self._take), EVENT, while_active=True)
        node.serve(GetPlan, topics.PLAN_FOOTSTEPS, self._on_plan)
        offer_own(node, "PlanFootsteps", topics.PLAN_TIMED_FOOTSTEPS, self._on_timed_plan)

    def publish_end(self) -> None:
        """Publish the end of a route; called after each tick."""
        route = self._law.route
        if self._running and not route.left and not self._ground.busy:
            self._running, outcome = False, self._ground.outcome or route.outcome
            done = outcome == RouteState.DONE.value
            self._publish(RouteStatus(RouteState.DONE) if done else RouteStatus(RouteState.ENDED, reason=outcome))

    def _publish(self, status: RouteStatus) -> None:
        self._publish_status(status)
        self._words.publish(String(data=str(status)))

    def _try(self, act: Callable[[Any], int], message: Any) -> None:
        try:
            if reason := self._ready():
                raise CommandError(reason)
            count = act(message)
        except PoiseError as error:
            self._publish(RouteStatus(RouteState.REFUSED, reason=str(error)))
            raise
        self._command.supersede()
        self._running = True
        self._publish(RouteStatus(RouteState.RUNNING, count))

    def _go(self, message: Any) -> int:
        return self._ground.go(goal_from_message("goal", message))

    def _take(self, message: Any) -> int:
        self._stack.take_steps(steps_from_path(message, self._law.footholds))
        self._ground.cancel("")
        return self._law.route.left

    def _on_plan(self, request: Any, response: Any) -> Any:
        """Plan, empty on failure: GetPlan has no field for the reason, which is in the diagnostics and the log."""
        try:
            if not request.tolerance >= 0.0:
                raise MessageError(f"tolerance is {request.tolerance}")
            response.plan = path_from_steps(self._now(), self._plan(request))
        except PoiseError as error:
            self._node.refuse(topics.PLAN_FOOTSTEPS, error)
        return response

    def _on_timed_plan(self, request: Any, response: Any) -> Any:
        """Plan with sides, times and reasons; see ``PlanFootsteps.srv``."""
        try:
            steps = self._plan(request)
        except PoiseError as error:
            self._node.refuse(topics.PLAN_TIMED_FOOTSTEPS, error)
            response.success, response.message = False, str(error)
            return response
        times = touchdown_times(len(steps), self._law.config)
        response.footsteps = [footstep_message(step, t) for step, t in zip(steps, times, strict=True)]
        response.success, response.message = True, f"{len(steps)} footsteps"
        return response

    def _plan(self, request: Any) -> list[Footstep]:
        if not self._node.active:
            raise CommandError("the gait planner is not active")
        goal = goal_from_message("goal", request.goal)
        return plan_to_pose(goal, self._start(request.start), self._law.config)

    def _start(self, start: Any) -> Sequence[Foothold]:
        """Soles to plan from: of a robot that stands at the given pose, or the present ones if that has no frame."""
        config = self._law.config
        if start.header.frame_id:
            return soles_at(goal_from_message("start", start), config.reach.width)
        return self._soles() if self._ready() else self._law.footholds
