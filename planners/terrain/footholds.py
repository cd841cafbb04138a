"""Footsteps along a line on measured ground, up to what cannot be stepped on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from msgspec import Struct, structs
from numpy.typing import NDArray

from models.errors import PoiseError
from models.numerics.compiled import njit
from models.robot_model import RobotModel
from models.types import Matrix, Vector
from planners.gait.config import GaitConfig
from planners.gait.footsteps import LEFT, RIGHT, Feet, Foothold, rotated
from planners.gait.route import Footstep, check_footsteps, soles_at
from planners.gait.tread import Tread, leg_height
from planners.terrain.elevation_map import Heights
from planners.terrain.survey import BESIDE, GRID, SoleSurvey, Survey

_ASIDE = 0.30  #: To either side of the line they reach [m]
_LEVEL = 0.03  #: Difference of height from which ground is another, and of way up to which feet are together [m]
_BESIDE = 0.10  #: Of way up to which feet are beside each other before and after a step to another level [m]
_COMFORT = 0.01  #: Room ahead and back from which on an edge does not matter [m]
_INSIDE = 0.01  #: A step is planned so far inside the reach [m]
_STANCE = 0.03  #: Difference from the nominal stance in which a plan may end, beyond the width of a sole [m]
_SHIFT = 0.2  #: From the line to those beside it [m]
_SOON = 1.0  #: A plan that ends before this way is compared with those beside it [m]
_DEPTH = 40  #: Footsteps of a plan at most
_WIDTH = 80  #: Beginnings of plans that are kept after each step
_KEY = (0.04, 0.06)  #: Of beginnings whose feet are this near to each other along and across, the best is kept [m]
_STRAY = 6  #: Cells off a level from which on it is none
_CHANGED = 0.1  #: Share of the ground of a step that is off its plan from which on the plan is void [-]
_AHEAD_MIN = 0.1  #: Nearest place ahead of a sole that counts for the reason why it cannot go on [m]


class Costs(NamedTuple):
    """Costs of a plan; each step costs 1."""

    left: float = 6.0  #: Of every stride of the distance that is left, while the search goes on,
    short: float = 12.0  #: and at the end of a plan: more than a step in reach costs, so that it goes on
    long: float = 60.0  #: Of the square of what a step, with its rise, is longer than the stride, or its swing than two
    crouch: float = 200.0  #: Of the square of how much lower the body is between both soles [1/m^2]
    edge: float = 0.6  #: Of a sole beside an edge
    wall: float = 12.0  #: Of the squared share by which higher ground ahead or behind, for shin or heel, is too near
    line: float = 400.0  #: Of the square of a sole's distance from its nominal place beside the line [1/m^2]
    width: float = 300.0  #: Of the square of the difference from the nominal width between the feet [1/m^2]


class GroundQuery(Struct, frozen=True):
    """A way to plan: along a line, from where the feet will be."""

    line: Foothold  #: Pose on the line, heading along it
    distance: float  #: Of the end of the way from there [m]
    feet: Feet  #: Left and right sole at the start
    foot: int | None = None  #: That steps first; None for either
    planned: tuple[Footstep, ...] = ()  #: The present plan from there on


class GroundPlan(NamedTuple):
    """Footsteps, and why they end before the end of the way; empty when they do not."""

    steps: list[Footstep]
    reason: str


class _Limits(NamedTuple):
    """Bounds of a step for compiled code [m]."""

    forward: float
    narrow: float
    wide: float
    rise: float
    body: float  #: Of the body along the line
    sway: float  #: and across
    width: float
    stride: float
    level: float
    beside: float
    flat: float  #: Difference of height between places on one level
    comfort: float
    leg: float


class _Begun(NamedTuple):
    """Beginnings of plans, of k each; ``at`` are places along and across the line and heights of both feet."""

    at: NDArray[np.float64]  #: (k, 2, 3) [m]
    foot: NDArray[np.int64]  #: That steps next (k,)
    seen: NDArray[np.bool_]  #: Whether a sole is on known ground, so that none is felt any more (k,)
    cost: Vector  #: (k,)


class GroundPlanner:
    """Plans footsteps on the ground as it is known; where nothing is known beside the feet, they will feel it.

    A beam search: from ``_WIDTH`` beginnings at most, each next step to every place of a lattice along the line where a
    sole lies on a plane and in reach. On one level the feet go ahead in turn; before and after a step to another level
    they are at most ``_BESIDE`` apart along it, and at the end side by side.
    """

    def __init__(self, robot: RobotModel, config: GaitConfig, stride: float = 0.25, costs: Costs | None = None) -> None:
        self._config, self._costs = config, costs or Costs()
        self._ground = SoleSurvey(robot, config.swing.edge)
        y_min, y_max = robot.feet[LEFT].rectangle[2:]
        self._stance = _STANCE + y_max - y_min
        reach, limits, period = config.reach, config.velocity, config.period
        self._limits = _Limits(
            reach.forward - _INSIDE,
            reach.width_min + _INSIDE,
            reach.width_max - _INSIDE,
            reach.rise,
            limits.forward * period - _INSIDE,
            limits.lateral * period - _INSIDE,
            reach.width,
            stride,
            _LEVEL,
            _BESIDE,
            config.ground.level,
            _COMFORT,
            config.leg,
        )
        soles = soles_at(Foothold(0.0, 0.0, 0.0), reach.width)
        level = Heights(np.zeros((9, 9)), (0.0, 0.0), 0.1)
        self.plan(level, GroundQuery(Foothold(0.0, 0.0, 0.0), 0.1, soles))  # compile now, not for the first plan

    def plan(self, ground: Heights, query: GroundQuery) -> GroundPlan:
        """Footsteps from the feet of a query to the end of its way, or as near to it as they get.

        Where they end soon they are planned beside the line, too: wide soles stand on both sides of a gap along the
        way. Such a plan is used where nothing is too high for a step between it and the line.
        """
        found, way = self._plan_along(ground, query, query.line)
        begin = max(query.line.relative(sole.x, sole.y)[0] for sole in query.feet)
        if not found.reason or way >= begin + _SOON:
            return found
        ways = np.arange(begin, begin + _SOON, ground.cell).tolist()
        sides = np.arange(-_SHIFT - _ASIDE, _SHIFT + _ASIDE, ground.cell).tolist()
        heights = ground.at(np.array([query.line.moved(x, y) for x in ways for y in sides]))
        if (heights > max(sole.z for sole in query.feet) + self._limits.rise).any():
            return found
        for side in (_SHIFT, -_SHIFT):
            x, y = query.line.moved(0.0, side)
            other, end = self._plan_along(ground, query, structs.replace(query.line, x=x, y=y))
            if end > way + self._limits.stride:
                found, way = other, end
        return found

    def _plan_along(self, ground: Heights, query: GroundQuery, line: Foothold) -> tuple[GroundPlan, float]:
        """A plan along a line, and the way of its leading foot there [m]."""
        first = [line.relative(sole.x, sole.y) for sole in query.feet]
        begin = min(place[0] for place in first)
        count = max(math.ceil((query.distance - begin) / GRID[0]), 0) + 1
        felt = max(place[0] for place in first) + self._limits.stride
        ways: Vector = np.asarray(query.distance - GRID[0] * np.arange(count)[::-1], dtype=np.float64)
        half = round(_ASIDE / GRID[1])
        sides: Vector = np.asarray(GRID[1] * np.arange(-half, half + 1), dtype=np.float64)
        survey = self._ground.survey(ground, line, ways, sides)
        starts = (LEFT, RIGHT) if query.foot is None else (query.foot,)
        at = np.array([[(*place, sole.z) for place, sole in zip(first, query.feet, strict=True)]] * len(starts))
        known = [bool(np.isfinite(ground.at(np.array([sole.pose[:2] for sole in query.feet]))).any())] * len(starts)
        begun = _Begun(at, np.array(starts), np.array(known), np.zeros(len(starts)))
        history: list[tuple[NDArray[np.int64], NDArray[np.int64], _Begun]] = []  # parents, places, beginnings
        best, end = math.inf, (-1, 0)
        for depth in range(_DEPTH + 1):
            costs = self._end_costs(begun, query.distance)
            if len(costs) and costs.min() < best:
                best, end = float(costs.min()), (depth, int(costs.argmin()))
            if depth == _DEPTH or not len(begun.cost):
                break
            parents, places, begun = self._next(begun, ways, sides, survey, felt)
            history.append((parents, places, begun))
        steps: list[Footstep] = []
        depth, i = end
        for parents, places, after in reversed(history[: max(depth, 0)]):
            steps.append(self._footstep(line, ways, sides, survey, places[i], after, i))
            i = int(parents[i])
        steps.reverse()
        steps = self._checked(steps, query.feet)
        feet = list(query.feet)
        for step in steps:
            feet[step.foot] = step.hold
        leading = max(feet, key=lambda sole: line.relative(sole.x, sole.y)[0])
        way = line.relative(leading.x, leading.y)[0]
        arrived = query.distance - way <= _LEVEL
        return GroundPlan(steps, "" if arrived else self._obstacle(ground, leading, line.yaw)), way

    def level(self, ground: Heights, query: GroundQuery) -> bool:
        """Whether the ground along the way is known, and level to where the feet walk, so that no plan is needed."""
        half = 0.5 * self._limits.width + self._ground.points[:, 1].max()
        start = min(query.line.relative(sole.x, sole.y)[0] for sole in query.feet)
        ways = np.arange(start, query.distance + self._ground.points[:, 0].max(), ground.cell)
        sides = np.arange(-half, half + 1e-6, ground.cell)
        heights = ground.at(np.array([query.line.moved(way, side) for way in ways.tolist() for side in sides.tolist()]))
        off = np.abs(heights - np.mean([sole.z for sole in query.feet]))
        return int((off > _LEVEL).sum()) < _STRAY

    def blocked(self, ground: Heights, query: GroundQuery) -> bool:
        """Whether the ground under or between the planned footsteps has changed since their plan."""
        feet, points = list(query.feet), self._ground.points
        for step in query.planned:
            last, hold = feet[step.foot], step.hold
            feet[step.foot] = hold
            if step.tread is None:
                continue
            places = np.array([hold.moved(x, y) for x, y in points.tolist()])
            level = np.array([step.tread.height(hold, x, y) for x, y in places.tolist()])
            if (np.abs(ground.at(places) - level) > _LEVEL).mean() > _CHANGED:
                return True
            way = np.array([last.x - hold.x, last.y - hold.y])
            between = np.concatenate([places + share * way for share in np.arange(0.0, 1.0, _AHEAD_MIN)])
            if (ground.at(between) > max(last.z, hold.z) + _LEVEL).mean() > _CHANGED:
                return True
        return False

    def _end_costs(self, begun: _Begun, distance: float) -> Vector:
        """Costs of plans that end here; infinite where the feet are not side by side."""
        apart = begun.at[:, LEFT] - begun.at[:, RIGHT]  # (k, 3)
        off = np.hypot(apart[:, 0], apart[:, 1] - self._limits.width)
        stands = (np.abs(apart[:, 0]) <= _LEVEL + 1e-9) & (off <= self._stance)
        stands &= np.abs(apart[:, 2]) <= self._limits.flat
        left = np.maximum(distance - begun.at[:, :, 0].mean(axis=1), 0.0)
        costs: Vector = np.where(stands, begun.cost + self._costs.short * left / self._limits.stride, np.inf)
        return costs

    def _next(
        self, begun: _Begun, ways: Vector, sides: Vector, survey: Survey, felt: float
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], _Begun]:
        """Beginnings that are one step longer: their parents (k,), the places of that step (k,), and themselves."""
        costs, places = _expand(begun, ways, sides, survey, felt, self._limits, self._costs)  # (k, n)
        parents, along = np.nonzero(np.isfinite(costs))
        cost, place = costs[parents, along], places[parents, along]
        foot = begun.foot[parents]
        at = begun.at[parents].copy()
        rows, (i, j) = np.arange(len(parents)), np.divmod(place, len(sides))
        fits = survey.fits[i, j] == 1
        height = np.where(fits, survey.height[i, j], at[rows, 1 - foot, 2])
        at[rows, foot] = np.stack([ways[i], sides[j], height], axis=1)
        value = cost - self._costs.left * at[:, :, 0].mean(axis=1) / self._limits.stride
        keys = np.column_stack([foot, np.round(at[:, :, 0] / _KEY[0]), np.round(at[:, :, 1] / _KEY[1])])
        order = np.argsort(value, kind="stable")
        _, unique = np.unique(keys[order], axis=0, return_index=True)
        kept = order[np.sort(unique)[:_WIDTH]]
        seen = begun.seen[parents] | fits
        return parents[kept], place[kept], _Begun(at[kept], 1 - foot[kept], seen[kept], cost[kept])

    def _footstep(
        self, line: Foothold, ways: Vector, sides: Vector, survey: Survey, place: int, after: _Begun, i: int
    ) -> Footstep:
        """The step to a place that led to a beginning."""
        foot = int(1 - after.foot[i])
        row, column = divmod(int(place), len(sides))
        x, y = line.moved(float(ways[row]), float(sides[column]))
        hold = Foothold(x, y, line.yaw, float(after.at[i, foot, 2]))
        if survey.fits[row, column] != 1:
            return Footstep(foot, hold)
        back, forward, right, left = survey.room[row, column].tolist()
        slope = rotated(line.yaw, float(survey.along[row, column]), float(survey.across[row, column]))
        return Footstep(foot, hold, Tread(slope, (back, forward, right + BESIDE, left + BESIDE)))

    def _checked(self, steps: list[Footstep], feet: Sequence[Foothold]) -> list[Footstep]:
        """The steps, or none where the gait would refuse them: feet that are turned from the line, too steep ground."""
        try:
            if steps:
                check_footsteps(steps, feet, self._config)
        except PoiseError:
            return []
        return steps

    def _obstacle(self, ground: Heights, stance: Foothold, yaw: float) -> str:
        """Why no foot can be put down ahead of a stance foot."""
        reach, pose = self._config.reach, Foothold(stance.x, stance.y, yaw)
        places = np.array([pose.moved(ahead, 0.0) for ahead in np.arange(_AHEAD_MIN, reach.forward, 0.02).tolist()])
        rises = ground.at(places) - stance.z
        beyond = rises[np.abs(rises) > reach.rise]
        if len(beyond):
            rise = float(np.median(beyond))
            way = "higher" if rise > 0.0 else "lower"
            return f"the ground ahead is {abs(rise):.2f} m {way}, at most {reach.rise:.2f} m"
        if np.isnan(rises).any():
            return "the ground ahead is not known"
        return f"no room for a sole up to {reach.forward:.2f} m ahead"


@njit(cache=True)
def _expand(
    begun: _Begun, ways: Vector, sides: Vector, survey: Survey, felt: float, limits: _Limits, costs: Costs
) -> tuple[Matrix, NDArray[np.int64]]:
    """Cost of each beginning (k) with a next step to each way (n), across from it at the best place; and that place.

    A step is felt up to the way ``felt`` [m].
    """
    shape = len(begun.cost), len(ways)
    best, places = np.full(shape, np.inf), np.zeros(shape, np.int64)
    for n in range(shape[0]):
        foot = begun.foot[n]
        stance, before, side = begun.at[n, 1 - foot], begun.at[n, foot], 1.0 if foot == LEFT else -1.0
        together = abs(stance[0] - before[0]) <= limits.beside + 1e-9
        apart = abs(stance[2] - before[2]) > limits.flat
        for i in range(shape[1]):
            ahead, swing = ways[i] - stance[0], ways[i] - before[0]
            beside = abs(ahead) <= limits.beside + 1e-9
            if ahead < -limits.level - 1e-9 or ahead > limits.forward or swing > 2.0 * limits.body:
                continue
            if apart and not beside:
                continue
            for j in range(len(sides)):
                out = side * (sides[j] - stance[1])
                if out < limits.narrow or out > limits.wide or abs(sides[j] - before[1]) > 2.0 * limits.sway:
                    continue
                room = limits.comfort
                if survey.fits[i, j] == 1:
                    rise, room = survey.height[i, j] - stance[2], min(survey.room[i, j, 0], survey.room[i, j, 1])
                elif survey.fits[i, j] < 0 and ways[i] <= felt + 1e-9 and not begun.seen[n]:  # level as far as known
                    if survey.low[i, j] < stance[2] - limits.level or survey.high[i, j] > stance[2] + limits.level:
                        continue
                    rise = 0.0
                else:
                    continue
                if abs(rise) > limits.rise or (abs(rise) > limits.flat and (apart or not together)):
                    continue
                longer = max(ahead + abs(rise) - limits.stride, 0.0)
                farther = max(swing - 2.0 * limits.stride, 0.0)
                off, wider = sides[j] - 0.5 * side * limits.width, out - limits.width
                value = begun.cost[n] + 1.0 + costs.long * (longer * longer + farther * farther)
                square = 0.25 * (ahead * ahead + wider * wider)
                crouch = limits.leg - leg_height(square, limits.leg) + 0.5 * abs(rise)
                value += costs.crouch * crouch * crouch
                if survey.fits[i, j] == 1:
                    value += costs.wall * survey.wall[i, j] * survey.wall[i, j]
                value += costs.edge * max(limits.comfort - room, 0.0) / limits.comfort
                value += costs.line * off * off + costs.width * wider * wider
                if value < best[n, i]:
                    best[n, i], places[n, i] = value, i * len(sides) + j
    return best, places
