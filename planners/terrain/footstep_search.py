"""Beam search for footsteps along a line, on the places of a surveyed lattice."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.numerics.compiled import njit, register_jitable
from models.types import Matrix, Vector
from planners.gait.config import GaitConfig
from planners.gait.footsteps import LEFT, RIGHT
from planners.gait.tread import step_crouch
from planners.terrain.ground_config import PlanConfig
from planners.terrain.leg_extent import LegExtents
from planners.terrain.survey import GRID, Survey
from planners.terrain.swing_sweep import SweepLimits, Tops, sweep_limits, sweeps_ground

_DEPTH = 40  #: Largest number of footsteps of a plan
_WIDTH = 80  #: Beam width: partial plans that are kept after each step
_KEY = (0.04, 0.06)  #: Cell of foot positions along and across in which only the best partial plan is kept [m]
_RADIX = 1 << 15 * np.arange(4)  #: Weights of the coordinates of both cells in one number; each is below 2^14


class _Costs(NamedTuple):
    """Fields of ``CostsConfig`` for compiled code."""

    left: float
    short: float
    long: float
    crouch: float
    edge: float
    wall: float
    line: float
    width: float


class Places(NamedTuple):
    """Lattice along a line, and its survey."""

    ways: Vector  #: Positions along the line (n,) [m]
    sides: Vector  #: Positions across the line, left positive (m,) [m]
    survey: Survey

    @property
    def farthest(self) -> float:
        """Position along the line of the last place where a sole fits [m]; -inf without one."""
        fitting = np.flatnonzero((self.survey.fits == 1).any(axis=1))
        return float(self.ways[fitting[-1]]) if len(fitting) else -math.inf


class Step(NamedTuple):
    """Step to a place of the lattice."""

    foot: int
    row: int
    column: int
    height: float  #: [m]
    over: float  #: ``Tread.over`` [m]


class _Limits(NamedTuple):
    """Bounds of a step for compiled code [m]."""

    forward: float
    narrow: float
    wide: float
    rise: float
    over: float  #: Largest height that a foot steps over, plus its rise
    body: float  #: Largest motion of the body along the line
    sway: float  #: Largest motion of the body across the line
    width: float
    stride: float
    level: float
    together: float
    beside: float
    flat: float  #: Largest height difference between places on one level
    comfort: float
    leg: float
    heel: float  #: x of the heel in the frame of the sole; ``toe`` likewise
    toe: float
    edge: float  #: Free ground ahead of the toe of a foot that steps over something


class _Begun(NamedTuple):
    """Partial plans (k,); ``at`` are positions along and across the line and heights of both feet."""

    at: NDArray[np.float64]  #: (k, 2, 3) [m]
    foot: NDArray[np.int64]  #: Foot that steps next (k,)
    seen: NDArray[np.bool_]  #: Whether a sole has been on known ground; no later step is felt (k,)
    cost: Vector  #: (k,)
    over: Vector  #: ``Tread.over`` of the last step (k,) [m]


class _Candidates(NamedTuple):
    """Candidate steps: positions along and across the line and heights (r, 3) [m], and ``Tread.over`` (r,) [m]."""

    before: Matrix  #: Of the foot that steps
    stance: Matrix  #: Of the other foot
    place: Matrix  #: Of the foot after the step
    over: Vector


class FootstepSearch:
    """Beam search: extends at most ``_WIDTH`` partial plans by a step to every place in reach where a sole fits.

    On one level the feet step ahead in turn. Before and after a step to another level, or over something higher than
    both footholds, they are at most ``beside`` apart along the line. At the end they are side by side.
    """

    def __init__(
        self, config: GaitConfig, plan: PlanConfig, sole: tuple[float, float, float, float], legs: LegExtents
    ) -> None:
        """``sole`` is the rectangle of a sole: x_min, x_max, y_min, y_max [m]; ``legs`` are the extents of a leg."""
        self.sweep = sweep_limits(config, legs, plan.sole.higher, 0.5 * (sole[0] + sole[1]))
        self._costs, self._stance = _Costs(**asdict(plan.costs)), plan.stance + sole[3] - sole[2]
        reach, velocity, period = config.reach, config.velocity, config.period
        self.limits = _Limits(
            reach.forward - plan.inside,
            reach.width_min + plan.inside,
            reach.width_max - plan.inside,
            reach.rise,
            plan.passed * reach.rise,
            velocity.forward * period - plan.inside,
            velocity.lateral * period - plan.inside,
            reach.width,
            plan.stride,
            plan.level,
            plan.together,
            plan.beside,
            config.ground.level,
            plan.comfort,
            config.leg,
            sole[0],
            sole[1],
            config.swing.edge,
        )

    def steps(
        self, places: Places, feet: Matrix, foot: int | None, *, known: bool, distance: float
    ) -> tuple[list[Step], bool]:
        """Best steps towards the end of the way, at a ``distance`` along the line [m]; empty if there are none.

        Also returns whether a step was refused because a leg would meet the ground.

        ``feet`` are the positions of both feet along and across the line and their heights (2, 3) [m]. ``foot`` steps
        first; None: either one. Unless the ground under the feet is ``known``, steps are felt until a sole is on known
        ground.
        """
        felt = float(feet[:, 0].max()) + self.limits.stride
        starts = (LEFT, RIGHT) if foot is None else (foot,)
        count = len(starts)
        zero = np.zeros(count)
        begun = _Begun(np.array([feet] * count), np.array(starts), np.array([known] * count), zero, zero)
        history: list[tuple[NDArray[np.int64], NDArray[np.int64], _Begun]] = []  # parents, places, partial plans
        best, end, met = math.inf, (-1, 0), False
        left = max(distance - max(felt, places.farthest), 0.0)  # remaining distance after any number of steps
        least = self._costs.short * left / self.limits.stride
        for depth in range(_DEPTH + 1):
            costs = self._end_costs(begun, distance)
            if len(costs) and costs.min() < best:
                best, end = float(costs.min()), (depth, int(costs.argmin()))
            if depth == _DEPTH or not len(begun.cost) or begun.cost.min() + least >= best:  # more steps cost more
                break
            parents, chosen, begun, refused = self._next(begun, places, felt)
            met = met or refused
            history.append((parents, chosen, begun))
        steps: list[Step] = []
        depth, i = end
        for parents, chosen, after in reversed(history[: max(depth, 0)]):
            stepped = int(1 - after.foot[i])
            row, column = divmod(int(chosen[i]), len(places.sides))
            steps.append(Step(stepped, row, column, float(after.at[i, stepped, 2]), float(after.over[i])))
            i = int(parents[i])
        return steps[::-1], met

    def _end_costs(self, begun: _Begun, distance: float) -> Vector:
        """Costs of plans that end here (k,); infinite if the feet are not side by side."""
        apart = begun.at[:, LEFT] - begun.at[:, RIGHT]  # (k, 3)
        off = np.hypot(apart[:, 0], apart[:, 1] - self.limits.width)
        stands = (np.abs(apart[:, 0]) <= self.limits.together + 1e-9) & (off <= self._stance)
        stands &= np.abs(apart[:, 2]) <= self.limits.flat
        left = np.maximum(distance - 0.5 * (begun.at[:, LEFT, 0] + begun.at[:, RIGHT, 0]), 0.0)
        costs: Vector = np.where(stands, begun.cost + self._costs.short * left / self.limits.stride, np.inf)
        return costs

    def _next(
        self, begun: _Begun, places: Places, felt: float
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], _Begun, bool]:
        """Partial plans that are one step longer: their parents (k,), the places of that step (k,), and the plans.

        Also returns whether a step was refused because a leg would meet the ground.
        """
        ways, sides, survey = places
        costs, nearest, overs = _expand(begun, ways, sides, survey, felt, self.limits, self._costs)  # (k, n)
        parents, along = np.nonzero(np.isfinite(costs))
        cost, place = costs[parents, along], nearest[parents, along]
        foot = begun.foot[parents]
        at = begun.at[parents]
        rows, (i, j) = np.arange(len(parents)), np.divmod(place, len(sides))
        fits = survey.fits[i, j] == 1
        height = np.where(fits, survey.height[i, j], at[rows, 1 - foot, 2])
        at[rows, foot] = np.stack([ways[i], sides[j], height], axis=1)
        value = cost - self._costs.left * (0.5 * (at[:, LEFT, 0] + at[:, RIGHT, 0])) / self.limits.stride
        keys = 2 * (np.rint(at[:, :, :2] / _KEY).astype(np.int64).reshape(-1, 4) @ _RADIX) + foot
        over = overs[parents, along]
        steps = _Candidates(begun.at[parents, foot], at[rows, 1 - foot], at[rows, foot], over)
        kept, met = _choose(np.argsort(value, kind="stable"), keys, _WIDTH, steps, places, self.sweep)
        seen = begun.seen[parents] | fits
        plans = _Begun(at[kept], 1 - foot[kept], seen[kept], cost[kept], over[kept])
        return parents[kept], place[kept], plans, met


@njit(cache=True)
def _choose(
    order: NDArray[np.int64], keys: NDArray[np.int64], most: int, steps: _Candidates, places: Places, sweep: SweepLimits
) -> tuple[NDArray[np.int64], bool]:
    """At most ``most`` rows in the given order, only the first one of each key (k,) whose legs meet no ground.

    Also returns whether any was left out because a leg would.
    """
    kept, count, highest, met = np.empty(most, np.int64), 0, places.survey.top.max(), False
    for row in order:
        new = count < most
        for k in range(count):
            if keys[row] == keys[kept[k]]:
                new = False
                break
        if new and _is_clear(row, steps, places, sweep, highest):
            kept[count] = row
            count += 1
        elif new:
            met = True
        if count == most:
            break
    return kept[:count], met


@njit(cache=True)
def _is_clear(row: int, steps: _Candidates, places: Places, sweep: SweepLimits, highest: float) -> bool:
    """Whether foot and leg of a candidate swing through no ground."""
    before, stance, place = steps.before[row], steps.stance[row], steps.place[row]
    if highest <= min(before[2], stance[2], place[2]) + sweep.higher:
        return True
    slopes = _slope_at(places, before), _slope_at(places, stance), _slope_at(places, place)
    ground = Tops(places.ways, places.sides, places.survey.top)
    return not sweeps_ground(before, stance, place, slopes, steps.over[row], ground, sweep, 0.0)


@register_jitable
def _slope_at(places: Places, foot: Vector) -> float:
    """Slope of the ground along the line under a foot at the position ``foot`` (3,) [-]; 0 where no sole fits."""
    ways, sides, survey = places
    row = min(max(round((foot[0] - ways[0]) / GRID[0]), 0), len(ways) - 1)
    column = min(max(round((foot[1] - sides[0]) / GRID[1]), 0), len(sides) - 1)
    return float(survey.along[row, column]) if survey.fits[row, column] == 1 else 0.0


@njit(cache=True)
def _expand(
    begun: _Begun, ways: Vector, sides: Vector, survey: Survey, felt: float, limits: _Limits, costs: _Costs
) -> tuple[Matrix, NDArray[np.int64], Matrix]:
    """Cost of each partial plan (k) with a next step to each position along the line (n), at the best place across.

    Also returns these places, and ``Tread.over`` of the steps. Steps may be felt up to the position ``felt`` [m].
    """
    shape = len(begun.cost), len(ways)
    best, places, overs = np.full(shape, np.inf), np.zeros(shape, np.int64), np.zeros(shape)
    grid, highest = ways[1] - ways[0] if len(ways) > 1 else 1.0, np.empty(len(sides))
    columns, across = np.empty(len(sides), np.int64), np.empty(len(sides))
    for n in range(shape[0]):
        foot = begun.foot[n]
        stance, before, side = begun.at[n, 1 - foot], begun.at[n, foot], 1.0 if foot == LEFT else -1.0
        together = abs(stance[0] - before[0]) <= limits.beside + 1e-9
        apart = abs(stance[2] - before[2]) > limits.flat
        highest[:], tallest = -np.inf, -np.inf  # of the ground between the toe before and the heel after the step
        row, own = max(math.ceil((before[0] + limits.toe - ways[0]) / grid), 0), 0
        count = 0  # of columns in reach
        for j in range(len(sides)):
            if abs(sides[j] - before[1]) < abs(sides[own] - before[1]):
                own = j
            out = side * (sides[j] - stance[1])
            if limits.narrow <= out <= limits.wide and abs(sides[j] - before[1]) <= 2.0 * limits.sway:
                off, wider = sides[j] - 0.5 * side * limits.width, out - limits.width
                across[j] = costs.line * off * off + costs.width * wider * wider
                columns[count], count = j, count + 1
        nearest = -np.inf  # highest ground directly ahead of the toe
        for i in range(row, shape[1]):
            if ways[i] > before[0] + limits.toe + limits.edge:
                break
            nearest = max(nearest, survey.top[i, own])
        near = nearest > before[2] + limits.level
        for i in range(shape[1]):
            while row < shape[1] and ways[row] <= ways[i] + limits.heel:
                for j in range(len(sides)):
                    highest[j] = max(highest[j], survey.top[row, j])
                    tallest = max(tallest, highest[j])
                row += 1
            ahead, swing = ways[i] - stance[0], ways[i] - before[0]
            beside = abs(ahead) <= limits.beside + 1e-9
            if ahead > limits.forward or swing > 2.0 * limits.body:
                break
            if ahead < -limits.together - 1e-9 or (apart and not beside):
                continue
            may_feel = ways[i] <= felt + 1e-9 and not begun.seen[n]
            farther = max(swing - 2.0 * limits.stride, 0.0)
            for j in columns[:count]:
                fits, height, room = survey.fits[i, j] == 1, stance[2], limits.comfort
                level = stance[2] - limits.level <= survey.low[i, j] and survey.high[i, j] <= stance[2] + limits.level
                if fits:
                    height, room = survey.height[i, j], min(survey.room[i, j, 0], survey.room[i, j, 1])
                elif not (may_feel and survey.fits[i, j] < 0 and level):
                    continue
                rise = height - stance[2]
                if abs(rise) > limits.rise or (abs(rise) > limits.flat and (apart or not together)):
                    continue
                longer = max(ahead + abs(rise) - limits.stride, 0.0)
                value = begun.cost[n] + 1.0 + costs.long * (longer * longer + farther * farther)
                if value >= best[n, i]:  # the other costs are not negative
                    continue
                over = 0.0
                if tallest - max(height, before[2]) > limits.level:
                    for k in range(min(j, own), max(j, own) + 1):
                        over = max(over, highest[k] - max(height, before[2]))
                    over = over if over > limits.level else 0.0
                if over > 0.0 and not fits:
                    continue
                if over > 0.0 and (over + abs(height - before[2]) > limits.over or near or not (together or beside)):
                    continue
                crouch = step_crouch(ahead, side * (sides[j] - stance[1]) - limits.width, rise, limits.leg)
                value += costs.crouch * crouch * crouch
                if fits:
                    value += costs.wall * survey.wall[i, j] * survey.wall[i, j]
                value += costs.edge * max(limits.comfort - room, 0.0) / limits.comfort
                value += across[j]
                if value < best[n, i]:
                    best[n, i], places[n, i], overs[n, i] = value, i * len(sides) + j, over
    return best, places, overs
