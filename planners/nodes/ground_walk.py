"""Walks of the gait planner on mapped ground: planned footsteps take over where it is not level."""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import Enum, auto
from typing import Any

from msgspec import structs
from std_msgs.msg import UInt8MultiArray

from models.config import default_config
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.messages import to_ns
from models.nodes.parameters import declare_config, describe
from models.nodes.progress import Progress
from models.nodes.qos import EVENT
from models.types import STILL, Velocity
from planners.gait.footsteps import Foothold, middle, wrap
from planners.gait.planner import GaitPlanner
from planners.gait.route import plan_to_pose
from planners.nodes.gait_link import GaitStage, decode, encode
from planners.terrain.footholds import GroundQuery
from planners.terrain.ground_config import GroundConfig, RouteConfig, WatchConfig
from planners.terrain.ground_route import Answer, GroundRoute, Request

_AROUND = "around"  #: Name of the parameter
_UNSEEN = "the ground on the way is unknown: the robot walks without a map; check terrain_mapper and its clouds"


class _Stage(Enum):
    IDLE = auto()  # no ground to check, or no ground planner
    ASKED = auto()  # awaits the answer about the ground on the way to a goal
    BLIND = auto()  # the gait walks without planned footsteps; the ground on the way is checked
    STOP = auto()  # stops in front of ground that is not level
    ROUTE = auto()  # takes planned footsteps
    LOOK = auto()  # stands, and will request a detour
    AROUND = auto()  # awaits the detour
    LAST = auto()  # turns to the heading of the goal
    BLOCKED = auto()  # stands in front of ground that it cannot step on


_WATCHING = (_Stage.ASKED, _Stage.BLIND, _Stage.BLOCKED)  #: Stages that request the ground on the way
_STOPPED = (_Stage.STOP, _Stage.ROUTE, _Stage.BLOCKED)  #: Stages in which the gait may only take planned steps


def declare_ground(node: PoiseNode) -> tuple[WatchConfig, RouteConfig]:
    """Declare the parameters of ``GroundWalk`` from ``ground.yaml``, and the parameter ``around``."""
    default = default_config(GroundConfig, "planners", "ground")
    watch = declare_config(node, default.watch, "ground_walk.watch.")
    route = declare_config(node, default.route, "ground_walk.route.")
    text = "Whether to walk to a goal around obstacles on level ground, instead of stepping onto them"
    node.declare_parameter(_AROUND, False, describe(text, read_only=False))
    return watch, route


def _speed(velocity: Velocity) -> float:
    return math.hypot(*velocity[:2])


def _bearing(velocity: Velocity) -> float:
    """Direction of a velocity relative to straight ahead [rad]."""
    return math.atan2(velocity[1], velocity[0])


class GroundWalk:
    """Checks the ground on the way to a goal or of a velocity, and walks on planned footsteps where it is not level.

    Without a ground planner or a map, the gait walks unchecked. Otherwise each touchdown triggers a request whether the
    ground is level for the next ``ahead`` (``beside`` to the sides and behind). If not, the robot stops, turns to the
    goal, and follows ``GroundRoute``. If that ends beside the goal, it walks there over level ground. At a velocity to
    the side or back it stays where it is. With the parameter ``around`` it walks to a goal around obstacles, over level
    ground. ``report`` receives the reasons why the robot stands despite a velocity and why it walks without a map,
    empty if it does not. A robot that cannot go on may turn, and repeats its request every ``retry_period``. A velocity
    in another direction is a new command.

    Attributes:
        outcome: Of the last goal: ``done``, or why it was not reached; empty if the route of the gait has the outcome.
    """

    def __init__(
        self,
        node: PoiseNode,
        law: GaitPlanner,
        stack: GaitStage,
        config: tuple[WatchConfig, RouteConfig],
        report: Callable[[str, str], None],
    ) -> None:
        self._law, self._stack, self._report = law, stack, report
        self._blocked = self._unmapped = ""  # last reported reasons
        self._config, route = config
        self._route, self._arrived = GroundRoute(law, stack, route), route.arrived
        self._requests = node.announce(UInt8MultiArray, topics.GROUND_REQUEST, EVENT)
        node.listen(UInt8MultiArray, topics.GROUND_PLAN, self._on_answer, EVENT, while_active=True)
        self._progress = Progress(node, "ground_planner")
        self._awaited = 0  # number of the newest request, until it is answered
        self._around = lambda: bool(node.get_parameter(_AROUND).value)
        self._number = self._before = 0  # of the last request, and of the last one before the present command
        self._stage, self.outcome = _Stage.IDLE, ""
        self._goal: Foothold | None = None
        self._poses: list[Foothold] = []  # to walk through on the way to the goal
        self._detours = 0
        self._beside = 0.0  # distance to the goal after plans that ended beside it [m]
        self._velocity = STILL
        self._direction = 0.0  # bearing of the velocity for which the ground was watched last [rad]
        self._t = self._asked = 0.0
        self._steps = -1  # touchdowns at the last request
        self._seen = False  # whether a ground planner was present
        self._unanswered = math.inf  # stamp of the first request since the last answer [s]

    @property
    def busy(self) -> bool:
        """Whether a walk to a goal is in progress, with or without a route of the gait."""
        return self._goal is not None

    def go(self, goal: Foothold) -> int:
        """Walk to a goal; returns the number of footsteps on level ground. Raises as ``plan_to_pose``."""
        count = len(plan_to_pose(goal, self._law.footholds, self._law.config))
        self.cancel("")
        if not count or not self._has_planner():
            self._stack.walk_to(goal)
            return self._law.route.left
        self._goal, self._poses, self._detours, self._beside = goal, [], 0, 0.0
        self._watch(_Stage.ASKED)
        return count

    def _report_ground(self, *, blocked: str | None = None, unmapped: str | None = None) -> None:
        """Report a change of the given reasons, together with the other one."""
        before = self._blocked, self._unmapped
        self._blocked = self._blocked if blocked is None else blocked
        self._unmapped = self._unmapped if unmapped is None else unmapped
        if before != (self._blocked, self._unmapped):
            self._report(self._blocked, self._unmapped)

    def _has_planner(self) -> bool:
        """Whether a ground planner is or was present, so that a missing answer is a fault."""
        self._seen = self._seen or self._requests.get_subscription_count() > 0
        return self._seen

    def cancel(self, reason: str) -> None:
        """End the present goal or velocity with a reason; footsteps under way are not affected."""
        self._report_ground(blocked="", unmapped="")
        self._route.end(reason)
        self._stage, self._goal, self.outcome, self._velocity = _Stage.IDLE, None, reason, STILL
        self._poses, self._before, self._unanswered = [], self._number, math.inf

    def admit(self, velocity: Velocity) -> Velocity:
        """The part of a commanded velocity that the gait may walk at; zero where planned footsteps take over."""
        if self._goal is not None:
            if velocity == STILL:
                return STILL
            self.cancel("a velocity was commanded")
        stopped = self._stage in _STOPPED
        moves = _speed(velocity) > self._config.speed_min
        continues = moves and abs(wrap(_bearing(velocity) - self._direction)) <= self._config.cone
        if stopped and continues:
            self._velocity = velocity
            return (0.0, 0.0, velocity[2]) if self._stage is _Stage.BLOCKED else STILL
        if velocity == self._velocity:
            return velocity
        if continues and self._stage is _Stage.BLIND:  # a stick that moves: answers under way count
            self._velocity = velocity
            return velocity
        if stopped:
            self._stack.stop()
        self.cancel(self.outcome)  # that of a goal is kept until it is published
        self._velocity, self._steps = velocity, -1
        if moves:
            self._stage, self._direction = _Stage.BLIND, _bearing(velocity)
        return velocity

    def update(self, t: float) -> None:
        """Advance the stage, after a tick with a stamp [s]."""
        self._t, law = t, self._law
        if t - self._unanswered > self._config.answer_timeout and self._stage in _WATCHING:  # repeated every tick
            now = "stands" if self._stage is _Stage.BLOCKED else "walks without a map"
            text = f"no answer from the ground planner for {self._config.answer_timeout:g} s: the robot {now}"
            self._report_ground(unmapped=text)
            if self._stage is _Stage.ASKED:
                self._walk_blind(known=False)
        match self._stage:
            case _Stage.BLIND:
                if self._goal is not None and not law.route.left and (law.settled or not self._poses):
                    self._arrive(law.route.outcome)
                elif law.steps != self._steps and self._has_planner():
                    self._watch(_Stage.BLIND)
            case _Stage.STOP:
                if law.settled and not law.route.left:  # a turn that has just been commanded has not begun yet
                    self._begin()
            case _Stage.ROUTE:
                self._follow(t)
            case _Stage.LOOK:
                if t - self._asked > self._config.look_time and self._goal is not None:
                    self._ask_around(self._goal)
            case _Stage.AROUND:
                if t - self._asked > self._config.answer_timeout:
                    self._finish("no way around was received from the ground planner")
            case _Stage.BLOCKED:
                if t - self._asked > self._config.retry_period:
                    self._watch(_Stage.BLOCKED)
            case _Stage.LAST:
                if not law.route.left:
                    self._finish(law.route.outcome)

    def _watch(self, stage: _Stage) -> None:
        """Enter a stage, and request whether the ground on the way is level."""
        self._stage, self._steps, self._asked = stage, self._law.steps, self._t
        self._direction = _bearing(self._velocity)
        feet, here = self._law.footholds, middle(self._law.footholds)
        config = self._config
        far = (config.ahead if self._leads_ahead else config.beside) + config.preview_time * _speed(self._velocity)
        far = min(far, config.line_length)  # the velocity is not limited yet
        line = structs.replace(here, yaw=here.yaw + _bearing(self._velocity))
        if (goal := self._target) is not None:
            ahead, way = self._way_to(goal)
            line, far = ahead if way > config.near_goal else here, min(far, way)
        self._number -= 1
        self._unanswered = min(self._unanswered, self._t)
        self._send(Request(self._number, GroundQuery(line, far, feet), None, self._t, watch=True))

    def _send(self, request: Request) -> None:
        """Publish a request. Simulated time waits for the answer, unless an earlier request was not answered."""
        if not self._awaited and self._requests.get_subscription_count() > 0:
            self._progress.report(to_ns(request.stamp))
        self._awaited = request.number
        self._requests.publish(encode(request))

    def _on_answer(self, message: Any) -> None:
        answer = decode(Answer, message)
        if answer.number == self._awaited:
            self._awaited = 0
            self._progress.report_idle()
        if self._stage is _Stage.ROUTE and answer.number > 0:
            if self._goal is None and answer.level:
                self._route.end("level")  # the rest is walked at the commanded velocity
            else:
                self._route.answer(answer)
        elif self._stage in _WATCHING and self._number <= answer.number < self._before:
            # A late answer is also valid, since the ground on the way has not moved.
            self._unanswered = math.inf
            self._report_ground(unmapped=_UNSEEN if answer.blind and self._stage is not _Stage.BLOCKED else "")
            if not (answer.level or answer.blind):
                self._stop()
            elif self._stage is _Stage.ASKED:
                self._walk_blind(known=answer.level)
            elif self._stage is _Stage.BLOCKED and answer.level and answer.number == self._number:
                self._go_on()
        elif self._stage is _Stage.AROUND and answer.number == self._number and self._goal is not None:
            self._pass(answer, self._goal)

    @property
    def _leads_ahead(self) -> bool:
        return abs(_bearing(self._velocity)) <= self._config.cone

    def _stop(self) -> None:
        """Stop before ground that is not level. A blocked robot plans again only at a velocity ahead without a turn."""
        (x, y, turn), ahead = self._velocity, self._leads_ahead
        if self._stage is _Stage.BLOCKED and (turn or not ahead):
            return
        if self._stage is not _Stage.BLOCKED and self._goal is None:
            side = "ahead" if ahead else "behind" if abs(y) < -x else "to the left" if y > 0.0 else "to the right"
            why = "searching for footsteps" if ahead else "steps up and down are planned ahead only"
            self._report_ground(blocked=f"the ground {side} is not level; {why}")
        self._stage = _Stage.STOP
        self._stack.hold_velocity(*STILL)
        self._stack.stop()

    @property
    def _target(self) -> Foothold | None:
        """Next pose to walk to; None at a velocity."""
        return self._poses[0] if self._poses else self._goal

    def _walk_blind(self, *, known: bool = True) -> None:
        """Walk to the next pose by a route of the gait; from beside the goal, only if the ground is ``known``."""
        if self._beside and not known:
            self._finish(f"the robot stands {self._beside:.2f} m beside the goal, and the ground between is not known")
            return
        target = self._target
        assert target is not None
        self._steps = self._law.steps
        self._walk_to(target, _Stage.BLIND)

    def _walk_to(self, pose: Foothold, stage: _Stage) -> None:
        """Enter a stage with a route of the gait to a pose; a refused route ends the walk to the goal."""
        try:
            self._stack.walk_to(pose)
        except PoiseError as error:
            self._finish(str(error))
        else:
            self._stage = stage

    def _begin(self) -> None:
        """From standing, turn to the goal, prepare a detour, or follow plans along a line from here."""
        here, self._poses = middle(self._law.footholds), []
        if self._goal is None:
            if not self._leads_ahead:
                self._block()
                return
            self._stage = _Stage.ROUTE
            self._route.begin(here, self._config.line_length)
            return
        line, way = self._way_to(self._goal)
        if self._beside:
            self._finish(f"the robot stands {self._beside:.2f} m beside the goal, and the ground between is not level")
            return
        # at the goal, the direction to it is arbitrary
        if way > self._arrived and abs(wrap(line.yaw - here.yaw)) > self._config.turn_min:
            self._walk_to(line, _Stage.STOP)
            return
        if self._around():
            self._stage, self._asked = _Stage.LOOK, self._t
        else:
            self._stage = _Stage.ROUTE
            self._route.begin(line, way)

    def _way_to(self, goal: Foothold) -> tuple[Foothold, float]:
        """Line from the present pose to a goal, and its length [m]."""
        here = middle(self._law.footholds)
        bearing = math.atan2(goal.y - here.y, goal.x - here.x)
        return Foothold(here.x, here.y, bearing, here.z), math.hypot(goal.x - here.x, goal.y - here.y)

    def _ask_around(self, goal: Foothold) -> None:
        line, way = self._way_to(goal)
        self._stage, self._asked, self._number = _Stage.AROUND, self._t, self._number - 1
        query = GroundQuery(line, way, self._law.footholds)
        self._send(Request(self._number, query, None, self._t, around=True))

    def _pass(self, answer: Answer, goal: Foothold) -> None:
        """Walk through the poses of an answer; without poses, follow plans to the goal."""
        self._detours += 1
        if answer.reason or self._detours > self._config.detours_max:
            self._finish(answer.reason or f"no way around was found in {self._config.detours_max} tries")
        elif answer.poses:
            self._poses = list(answer.poses)
            self._walk_blind()
        else:
            self._stage = _Stage.ROUTE
            self._route.begin(*self._way_to(goal))

    def _arrive(self, outcome: str) -> None:
        """Handle the end of a route of the gait, at a pose of a detour or at the goal."""
        if outcome == "done" and self._poses:
            del self._poses[0]
            self._walk_blind()
        else:
            self._finish(outcome)

    def _follow(self, t: float) -> None:
        route, goal = self._route, self._goal
        if (request := route.request(t)) is not None:
            self._send(request)
        if self._law.route.left:
            self._report_ground(blocked="")
        if route.active or self._law.route.left or not self._law.settled:
            return
        if goal is None:
            if route.outcome in ("level", "done"):  # the line has an end, the velocity has none
                self._go_on()
            else:
                self._block()
                self._report_ground(blocked=route.outcome)
        elif route.outcome == "done" and self._way_to(goal)[1] > self._config.near_goal:
            self._beside = self._way_to(goal)[1]
            self._watch(_Stage.ASKED)  # over level ground in between, the gait walks there
        elif route.outcome == "done" and self._turned_from(goal):
            self._walk_to(goal, _Stage.LAST)
        else:
            self._finish(route.outcome)

    def _turned_from(self, goal: Foothold) -> bool:
        return abs(wrap(goal.yaw - middle(self._law.footholds).yaw)) > self._config.heading_error

    def _block(self) -> None:
        """Stand despite a velocity, and repeat the request later."""
        self._stage, self._asked = _Stage.BLOCKED, self._t

    def _go_on(self) -> None:
        """Resume the velocity."""
        self._report_ground(blocked="")
        self._stage, self._steps = _Stage.BLIND, -1

    def _finish(self, outcome: str) -> None:
        self._report_ground(unmapped="")
        self._stage, self._goal, self._poses, self.outcome = _Stage.IDLE, None, [], outcome
