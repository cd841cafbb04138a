"""Walk along a line over measured ground, planned from standing and again at every touchdown as the map grows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

from msgspec import Struct

from models.config import default_config
from models.errors import PoiseError, UnreachableError
from planners.gait.footsteps import Foothold, middle
from planners.gait.planner import GaitPlanner
from planners.gait.route import Footstep
from planners.terrain.detour import detour
from planners.terrain.elevation_map import Heights
from planners.terrain.footholds import GroundPlanner, GroundQuery
from planners.terrain.ground_config import GroundConfig, RouteConfig

STAMP_MAX = 2.0**31  #: Bound of the stamps of messages, whose seconds are int32 [s]


class Walker(Protocol):
    """Executes footsteps: the gait, or the stack around it."""

    def take_steps(self, steps: Sequence[Footstep], after: int | None = None) -> None:
        """See ``GaitPlanner.take_steps``."""

    def stop(self) -> None:
        """See ``GaitPlanner.stop``."""


class Request(Struct, frozen=True):
    """Query for a plan, and the touchdown after which the plan begins; None: from standing."""

    number: int
    query: GroundQuery
    after: int | None = None
    stamp: float = 0.0  # stamp of the request [s]
    watch: bool = False  # requests only whether the way is level
    around: bool = False  # requests poses around obstacles instead of footsteps

    def __post_init__(self) -> None:
        if not 0.0 <= self.stamp < STAMP_MAX:
            raise ValueError(f"the stamp is {self.stamp} s, not between 0 and {STAMP_MAX:g}")


class Answer(Struct, frozen=True):
    """Answer to a request."""

    number: int
    steps: tuple[Footstep, ...] = ()
    reason: str = ""  # why the steps end before the end of the way; empty if they do not
    level: bool = False  # whether the whole way is on the level of the feet, see ``GroundPlanner.level``
    blind: bool = False  # whether nothing on the way is known
    blocked: bool = False  # whether the steps planned so far have become impossible
    poses: tuple[Foothold, ...] = ()  # to walk through, around obstacles
    stamp: float = 0.0  # of the newest measurement in the map [s]


def answer_request(
    planner: GroundPlanner, request: Request, ground: Heights, *, clearance: float, stamp: float = 0.0
) -> Answer:
    """Answer a request on the known ground; ``stamp`` is that of the newest measurement in the map [s].

    ``clearance`` is half the width that the robot needs beside an obstacle [m].
    """
    number, query = request.number, request.query
    ground = planner.corrected(ground, query)
    if request.around:
        try:
            poses = detour(ground, query.line, query.distance, clearance, planner.config)
        except UnreachableError as error:
            return Answer(number, reason=str(error), stamp=stamp)
        return Answer(number, poses=tuple(poses), stamp=stamp)
    steps, reason = ([], "") if request.watch else planner.plan(ground, query)
    level, blocked = planner.level(ground, query), planner.blocked(ground, query)
    return Answer(number, tuple(steps), reason, bool(level), level is None, blocked, stamp=stamp)


class GroundRoute:
    """Requests plans and executes their footsteps until the robot stands at the end of a line or cannot go on.

        request = route.request(t)             # after every tick; None when no plan is due
        route.answer(answer_request(planner, request, ground, ...))

    A plan from standing is requested after ``look_time`` [s], in which the robot observes the ground. During the walk,
    each touchdown triggers a plan after the next ``kept`` steps. It is not used if it is too late, or if it ends before
    the present plan while the ground of that plan is unchanged. If the map grows in time, the robot does not stop.
    Otherwise it stands, observes and goes on, also if its plan became void without another one, since a map may be
    wrong for a moment during a walk. The walk ends with the reason of a plan from standing.

    Attributes:
        outcome: Empty during the walk, then ``done``, ``ended`` or the reason why it ended.
        plans: Number of plans that were used.
    """

    def __init__(self, gait: GaitPlanner, walker: Walker, config: RouteConfig | None = None) -> None:
        self._gait, self._walker = gait, walker
        self._config = config or default_config(GroundConfig, "planners", "ground").route
        self._number = 0
        self.outcome, self.plans = "done", 0
        self._pending: Request | None = None

    @property
    def active(self) -> bool:
        """Whether a walk is under way."""
        return not self.outcome

    def begin(self, line: Foothold, distance: float) -> None:
        """Walk along a line from its pose over a ``distance`` [m]; the robot must stand."""
        self._line, self._distance = line, distance
        self.outcome, self.plans = "", 0
        self._pending, self._asked = None, self._gait.steps
        self._standing: float | None = None
        self._stops, self._stopped = 0, False  # stops of this route to observe again, and whether one is active
        self._taken: tuple[Footstep, ...] = ()  # steps of the plan in use, with the heights of its map

    def end(self, reason: str) -> None:
        """End an active walk with a reason, ``ended`` if empty; footsteps under way are not affected."""
        self.outcome, self._pending = self.outcome or reason or "ended", None

    def request(self, t: float) -> Request | None:
        """The request for a plan that is due at a stamp [s], returned once."""
        if not self.active:
            return None
        if self._pending is not None:
            if t - self._since > self._config.plan_timeout:
                self.end(
                    f"no plan was received for {self._config.plan_timeout:g} s: the ground planner is busy or restarts"
                )
            return None
        gait = self._gait
        if gait.route.left:
            self._standing = None
            kept = self._config.kept
            if gait.steps == self._asked or gait.route.left < kept:
                return None
            self._asked = gait.steps
            feet, foot = gait.soles_after(kept), 1 - gait.route.steps[kept - 1].foot
            planned = self._taken[len(self._taken) + kept - gait.route.left :]
            query = GroundQuery(self._line, self._reach(feet), feet, foot, planned)
            return self._ask(t, query, gait.steps + kept)
        if not gait.settled:
            self._standing = None
            return None
        if self.plans and gait.route.outcome not in ("", "done") and not self._stopped:
            self.end(gait.route.outcome)
            return None
        feet = gait.footholds
        if self._distance - self._way(feet) <= self._config.arrived:
            self.end("done")
            return None
        self._standing = t if self._standing is None else self._standing
        if t - self._standing < self._config.look_time:
            return None
        return self._ask(t, GroundQuery(self._line, self._reach(feet), feet))

    def answer(self, answer: Answer) -> None:
        """Use the plan for the newest request; other answers are ignored."""
        request = self._pending
        if request is None or answer.number != request.number:
            return
        self._pending = None
        if not answer.steps:
            if answer.blocked:
                self._stops, self._stopped = self._stops + 1, True
                self._walker.stop()
            if request.after is None or self._stops > self._config.stops_max:
                self.end(answer.reason or "the ground planner found no step")
            return
        if request.after is not None and not self._helps(request.after, answer):
            return
        try:
            self._walker.take_steps(answer.steps, request.after)
        except PoiseError as error:
            if request.after is None:
                self.end(str(error))
            return
        self.plans, self._taken, self._stopped = self.plans + 1, answer.steps, False
        if request.after is None:
            self._asked, self._standing = self._gait.steps, None

    def _ask(self, t: float, query: GroundQuery, after: int | None = None) -> Request:
        self._number += 1
        self._since, self._pending = t, Request(self._number, query, after, t)
        return self._pending

    def _way(self, feet: Sequence[Foothold]) -> float:
        """Position of the middle between the soles along the line [m]."""
        here = middle(feet)
        return self._line.relative(here.x, here.y)[0]

    def _reach(self, feet: Sequence[Foothold]) -> float:
        return min(self._distance, self._way(feet) + self._config.horizon)

    def _helps(self, after: int, answer: Answer) -> bool:
        """Whether steps after a touchdown are in time, and reach as far as those they replace if these are valid."""
        route, kept, steps = self._gait.route, after - self._gait.steps, answer.steps
        if not 1 <= kept <= route.left:
            return False
        if self._end_of(steps) < self._end_of(route.steps) - self._config.shortfall_max and not answer.blocked:
            return False
        if kept >= self._config.kept:
            return True
        old, new = route.steps[kept : kept + 1], steps[0].hold
        return bool(old) and math.hypot(new.x - old[0].hold.x, new.y - old[0].hold.y) <= self._config.change_max

    def _end_of(self, steps: Sequence[Footstep]) -> float:
        """Farthest position of the last two steps along the line [m]."""
        return max(self._line.relative(step.hold.x, step.hold.y)[0] for step in steps[-2:])
