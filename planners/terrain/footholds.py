"""Footsteps along a line on measured ground, up to the first obstacle."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from msgspec import Struct, structs

from models.config import default_config
from models.errors import PoiseError
from models.robot_model import RobotModel
from models.types import Vector
from planners.gait.config import GaitConfig
from planners.gait.footsteps import LEFT, RIGHT, Feet, Foothold, Point, rotated
from planners.gait.route import Footstep, check_footsteps, soles_at
from planners.gait.tread import Tread
from planners.terrain.config import TerrainMapConfig
from planners.terrain.elevation_map import Heights, lattice, level_offset, off_level
from planners.terrain.footstep_search import FootstepSearch, Places, Step
from planners.terrain.ground_config import GroundConfig, PlanConfig
from planners.terrain.leg_extent import leg_extents
from planners.terrain.survey import GRID, SoleSurvey
from planners.terrain.swing_sweep import Tops, sweeps_ground

_WAY_STEP = 0.1  #: Step between the places of a way that are compared, as a share of the way [-]
_AHEAD_MIN = 0.1  #: Least distance ahead of a sole of ground that may be the reason for the end of a plan [m]


class GroundQuery(Struct, frozen=True):
    """Query for footsteps along a line, from given poses of the feet."""

    line: Foothold  #: Start of the line, with its heading
    distance: float  #: Distance from there to the end of the way [m]
    feet: Feet  #: Left and right sole at the start
    foot: int | None = None  #: Foot that steps first; None: either one
    planned: tuple[Footstep, ...] = ()  #: Steps of the present plan after these poses

    def __post_init__(self) -> None:
        poses = (self.line, *self.feet, *(step.hold for step in self.planned))
        if not all(map(math.isfinite, (self.distance, *(value for pose in poses for value in structs.astuple(pose))))):
            raise ValueError("a pose or the distance is not finite")
        if self.foot not in (None, LEFT, RIGHT):
            raise ValueError(f"foot {self.foot} is neither {LEFT} (left) nor {RIGHT} (right)")


class GroundPlan(NamedTuple):
    """Footsteps, and the reason why they end before the end of the way; empty if they do not."""

    steps: list[Footstep]
    reason: str


class GroundPlanner:
    """Plans footsteps on known ground. Steps on unknown ground near the feet are felt (no ``Tread``)."""

    def __init__(self, robot: RobotModel, config: GaitConfig, plan: PlanConfig | None = None) -> None:
        self.config = plan = plan or default_config(GroundConfig, "planners", "ground").plan
        self._gait, self._ground = config, SoleSurvey(robot, config, plan.sole)
        mapping = default_config(TerrainMapConfig, "planners", "terrain_map")
        self._errors, self._roughness = mapping.feet, mapping.patches.roughness
        self._search = FootstepSearch(config, plan, robot.feet[LEFT].rectangle, leg_extents(robot))
        self._limits = self._search.limits
        soles = soles_at(Foothold(0.0, 0.0, 0.0), config.reach.width)
        level = Heights(np.zeros((9, 9)), (0.0, 0.0), 0.1)
        self.plan(level, GroundQuery(Foothold(0.0, 0.0, 0.0), 0.1, soles))  # compile now, not at the first plan

    def corrected(self, ground: Heights, query: GroundQuery) -> Heights:
        """The ground without the height offset that the feet of a query measure, as in the mapper.

        Soles on known ground must agree; without any, level ground ahead counts. An offset above ``limit`` is kept.
        """
        limits, errors = self._errors, [self._ground.height_under(ground, sole) - sole.z for sole in query.feet]
        found = [error for error in errors if math.isfinite(error)]
        error = float(np.mean(found)) if found and max(found) - min(found) <= self.config.sole.flat else None
        if not found and not self._known(ground, query):
            x, y = self._ground.points.T
            ways, sides = x.max() + np.arange(0.0, limits.distance, ground.cell), np.unique(y)
            error = level_offset(
                np.concatenate([ground.at(lattice(sole, ways, sides)) - sole.z for sole in query.feet]),
                limits.known,
                self._roughness,
            )
        return ground if error is None or abs(error) > limits.limit else ground._replace(values=ground.values - error)

    def plan(self, ground: Heights, query: GroundQuery) -> GroundPlan:
        """Footsteps from the feet of a query to the end of its way, or as near to it as possible.

        If there are none because a leg would meet ground close ahead, the feet may first step back by ``retreat``. If
        they end within ``short_way``, plans along the parallel lines are tried too: wide soles can stand on both sides
        of a gap along the way. It is used if no ground between it and the line is too high for a step.
        """
        found, way, met = self._plan_along(ground, query, query.line)
        if met and not found.steps:
            found, way, _ = self._plan_along(ground, query, query.line, retreat=self.config.retreat)
        begin = max(query.line.relative(sole.x, sole.y)[0] for sole in query.feet)
        if not found.reason or way >= begin + self.config.short_way:
            return found
        shift, aside = self.config.shift, self.config.aside
        ways = np.arange(begin, begin + self.config.short_way, ground.cell)
        sides = np.arange(-shift - aside, shift + aside, ground.cell)
        heights = ground.at(lattice(query.line, ways, sides))
        if (heights > max(sole.z for sole in query.feet) + self._limits.rise).any():
            return found
        for side in (shift, -shift):
            x, y = query.line.moved(0.0, side)
            least = way + self._limits.stride
            other, end, _ = self._plan_along(ground, query, structs.replace(query.line, x=x, y=y), least)
            if end > least:
                found, way = other, end
        return found

    def _plan_along(
        self, ground: Heights, query: GroundQuery, line: Foothold, least: float = -math.inf, retreat: float = 0.0
    ) -> tuple[GroundPlan, float, bool]:
        """Plan along a line, the position of its leading foot [m], and whether a leg would meet ground otherwise.

        There is no plan if no sole fits as far as ``least`` [m]. The first places are ``retreat`` [m] behind the feet.
        """
        at = np.array([(*line.relative(sole.x, sole.y), sole.z) for sole in query.feet])
        count = max(math.ceil((query.distance - float(at[:, 0].min()) + retreat) / GRID[0]), 0) + 1
        ways: Vector = np.asarray(query.distance - GRID[0] * np.arange(count)[::-1], dtype=np.float64)
        half = round(self.config.aside / GRID[1])
        sides: Vector = np.asarray(GRID[1] * np.arange(-half, half + 1), dtype=np.float64)
        places = Places(ways, sides, self._ground.survey(ground, line, ways, sides))
        if places.farthest < least:
            return GroundPlan([], ""), -math.inf, False
        known = self._known(ground, query)
        found, met = self._search.steps(places, at, query.foot, known=known, distance=query.distance)
        steps = [_footstep(line, places, step, self.config.sole.beside) for step in found]
        refusal = self._refusal(steps, query.feet)
        if refusal:
            steps = []
        feet = list(query.feet)
        for step in steps:
            feet[step.foot] = step.hold
        leading = max(feet, key=lambda sole: line.relative(sole.x, sole.y)[0])
        way = line.relative(leading.x, leading.y)[0]
        arrived = query.distance - way <= self.config.arrived
        reason = "" if arrived else refusal or self._obstacle(ground, leading, line.yaw, met)
        return GroundPlan(steps, reason), way, met

    def level(self, ground: Heights, query: GroundQuery) -> bool | None:
        """Whether the ground along the way is level where the feet step, so that no plan is needed.

        Unknown ground counts as low as the lowest ground of the map: on a landing it may be an edge, on a floor it is
        more floor. None if nothing on the way is known and the map has no lower ground.
        """
        half = 0.5 * self._limits.width + self._ground.points[:, 1].max()
        start = min(query.line.relative(sole.x, sole.y)[0] for sole in query.feet)
        ways = np.arange(start, query.distance + self._ground.points[:, 0].max(), ground.cell)
        sides = np.arange(-half, half + 1e-6, ground.cell)
        heights = ground.at(lattice(query.line, ways, sides)).reshape(len(ways), len(sides))
        level = float(np.mean([sole.z for sole in query.feet]))
        unknown = np.isnan(heights)
        if unknown.any():
            known = ground.values[np.isfinite(ground.values)]
            lowest = min(float(np.percentile(known, self.config.lowest)), level) if len(known) else level
            if unknown.all() and lowest >= level - self.config.level:
                return None
            heights[unknown] = lowest
        return float(off_level(heights, level, self.config.level).sum()) < self.config.stray

    def blocked(self, ground: Heights, query: GroundQuery) -> bool:
        """Whether the ground under, between or beside the planned footsteps has changed since they were planned."""
        feet, points, off, most = list(query.feet), self._ground.points, self.config.level, self.config.changed
        slopes = [(0.0, 0.0), (0.0, 0.0)]
        for step in query.planned:
            last, hold, stance = feet[step.foot], step.hold, feet[1 - step.foot]
            tilted = slopes[step.foot], slopes[1 - step.foot], step.tread.slope if step.tread else (0.0, 0.0)
            feet[step.foot], slopes[step.foot] = hold, tilted[2]
            if step.tread is None:
                continue
            places = np.array([hold.moved(x, y) for x, y in points.tolist()])
            level = np.array([step.tread.height(hold, x, y) for x, y in places.tolist()])
            if (np.abs(ground.at(places) - level) > off).mean() > most:
                return True
            if self._legs_in_ground(ground, (last, stance, hold), tilted, step.tread.over):
                return True
            way = np.array([last.x - hold.x, last.y - hold.y])
            between = np.concatenate([places + share * way for share in np.arange(0.0, 1.0, _WAY_STEP)])
            if (ground.at(between) > max(last.z, hold.z) + step.over + off).mean() > most:
                return True
        return False

    def _legs_in_ground(
        self, ground: Heights, feet: tuple[Foothold, ...], slopes: tuple[Point, ...], over: float
    ) -> bool:
        """Whether a leg is ``level`` deep in ground in a step: foot before it, stance foot, foot after it; slopes."""
        line, limits = feet[2], self._search.sweep
        at = np.array([(*line.relative(foot.x, foot.y), foot.z) for foot in feet])
        (back, right), (front, left) = at[:, :2].min(axis=0), at[:, :2].max(axis=0)
        reach = float(np.abs(limits.legs.table).max())
        ways, sides = np.arange(back - reach, front + reach, GRID[0]), np.arange(right, left + GRID[1], GRID[1])
        tops = Tops(ways, sides, self._ground.tops(ground, line, ways, sides))
        c, s = math.cos(line.yaw), math.sin(line.yaw)
        first, second, third = (c * x + s * y for x, y in slopes)
        before, stance, place = at
        return sweeps_ground(before, stance, place, (first, second, third), over, tops, limits, -self.config.level)

    @staticmethod
    def _known(ground: Heights, query: GroundQuery) -> bool:
        """Whether the ground at the origin of at least one sole is known."""
        return bool(np.isfinite(ground.at(np.array([sole.pose[:2] for sole in query.feet]))).any())

    def _refusal(self, steps: list[Footstep], feet: Sequence[Foothold]) -> str:
        """Reason why the gait would refuse the steps, e.g. feet turned from the line or steep ground; empty if none."""
        try:
            if steps:
                check_footsteps(steps, feet, self._gait)
        except PoiseError as error:
            return str(error)
        return ""

    def _obstacle(self, ground: Heights, stance: Foothold, yaw: float, met: bool) -> str:
        """Reason why no foot can be placed ahead of a stance foot; ``met``: whether a leg would meet ground."""
        reach, pose = self._gait.reach, Foothold(stance.x, stance.y, yaw)
        rises = ground.at(lattice(pose, np.arange(_AHEAD_MIN, reach.forward, 0.02), 0.0)) - stance.z
        beyond = rises[np.abs(rises) > reach.rise]
        if len(beyond):
            rise = float(np.median(beyond[np.sign(beyond) == np.sign(beyond[0])]))  # of the sign that comes first
            way = "higher" if rise > 0.0 else "lower"
            return f"the ground ahead is {abs(rise):.2f} m {way}, at most {reach.rise:.2f} m"
        if np.isnan(rises).any():
            return "the ground ahead is not known, perhaps an edge"
        over = float(rises.max())
        if met and over > self.config.level:
            return f"a leg would meet the ground ahead, which is {over:.2f} m higher"
        why = f"no room for a sole up to {reach.forward:.2f} m ahead"
        most = self._limits.over
        return why if over <= most else f"{why}, and it is {over:.2f} m higher, at most {most:.2f} m to step over"


def _footstep(line: Foothold, places: Places, step: Step, beside: float) -> Footstep:
    """Footstep to a place, with extra room ``beside`` it [m]; without ``Tread``, so felt, if no sole fits there."""
    survey, at = places.survey, (step.row, step.column)
    x, y = line.moved(float(places.ways[step.row]), float(places.sides[step.column]))
    hold = Foothold(x, y, line.yaw, step.height)
    if survey.fits[at] != 1:
        return Footstep(step.foot, hold)
    back, forward, right, left = survey.room[at].tolist()
    slope = rotated(line.yaw, float(survey.along[at]), float(survey.across[at]))
    return Footstep(step.foot, hold, Tread(slope, (back, forward, right + beside, left + beside), step.over))
