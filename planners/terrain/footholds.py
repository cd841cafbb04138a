"""Footsteps straight ahead on a measured elevation map, up to what cannot be stepped on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from models.errors import UnreachableError
from models.heading import turned
from models.types import Matrix
from planners.gait.config import GaitConfig
from planners.gait.footsteps import LEFT, Foothold, rotated, side_of
from planners.gait.route import Footstep, check_footsteps, soles_at
from planners.gait.tread import Tread
from planners.terrain.mapper import TerrainMapper

_GRID = 0.01  #: Between two places that are tried [m]
_ASIDE = (0.0, 0.03, -0.03)  #: Outwards of the nominal width that are tried [m]
_BESIDE = 0.02  #: To either side of a sole, the ground that its plane is fitted to as well [m]
_FLAT = 0.012  #: Largest deviation of that ground from its plane [m]
_LEVEL = 0.03  #: Difference of height up to which both feet are on one level [m]
_ROOMS = (0.0, 0.02, 0.04)  #: Ways by which a sole may move ahead and back on its ground that are tried [m]
_COMFORT = 0.02  #: Such a way from which on an edge does not matter [m]
_EDGE_WEIGHT = 4.0  #: Of the lack of it, against the distance from the wished place [-]
_FARTHER = 0.3  #: How much farther than wished a step may be [m]
_PROGRESS = 0.5  #: Share of a wished step ahead that is worth a step [-]


class GroundPlan(NamedTuple):
    """Footsteps, and why they end before the wished distance; empty when they do not."""

    steps: list[Footstep]
    reason: str


class GroundPlanner:
    """Plans footsteps on the ground as a ``mapper`` knows it now; where it knows nothing, the feet will feel it."""

    def __init__(self, mapper: TerrainMapper, config: GaitConfig) -> None:
        self._map, self._reference, self._config = mapper.map, mapper.reference, config
        x_min, x_max, y_min, y_max = mapper.robot.feet[LEFT].rectangle
        across = np.arange(y_min - _BESIDE, y_max + _BESIDE + 1e-6, self._map.cell)
        self._fits: list[tuple[Matrix, Matrix]] = []  # points of the sole and its room, and the inverse of their plane
        for room in _ROOMS:
            more = config.swing.edge + room
            along = np.arange(x_min - more, x_max + more + 1e-6, self._map.cell)
            points = np.array([(x, y) for x in along for y in across])
            self._fits.append((points, np.linalg.pinv(np.column_stack([points, np.ones(len(points))]))))

    def plan_ahead(self, start: Foothold, distance: float, stride: float = 0.25) -> GroundPlan:
        """Footsteps of a robot that stands at ``start``, a pose between its soles, for a ``distance`` ahead of it [m].

        On one level the feet go ahead in turn, by at most ``stride`` [m]; before and after a step to another level, and
        at the end, they come side by side.
        """
        begin = soles_at(start, self._config.reach.width)
        feet, foot, reason = list(begin), LEFT, ""
        steps: list[Footstep] = []
        while len(steps) < self._config.route.steps_max:
            stance, step, seen = feet[1 - foot], None, any(step.tread is not None for step in steps)
            left = distance - start.relative(stance.x, stance.y)[0]
            apart = abs(stance.z - feet[foot].z) > _LEVEL
            if not (apart or reason) and left > _GRID:
                wish = min(stride, left)
                most = min(wish + _FARTHER, self._config.reach.forward)
                step = self._best(feet, foot, wish, _PROGRESS * wish, most, seen=seen)
                reason = "" if step else self._obstacle(stance)
            together = not apart and abs(stance.relative(feet[foot].x, feet[foot].y)[0]) <= _LEVEL
            if step is None and together:
                break
            if step is None or not (together or abs(step.hold.z - stance.z) <= _LEVEL):  # beside the other foot
                step = self._best(feet, foot, 0.0, -_LEVEL, _LEVEL, seen=seen, beside=True)
            if step is None:
                break
            steps.append(step)
            feet[foot], foot = step.hold, 1 - foot
        while steps and abs(feet[0].z - feet[1].z) > _LEVEL:  # it stands on one level
            last = steps.pop().foot
            feet[last] = next((step.hold for step in reversed(steps) if step.foot == last), begin[last])
        return GroundPlan(steps, reason)

    def _best(
        self,
        feet: Sequence[Foothold],
        foot: int,
        wish: float,
        least: float,
        most: float,
        *,
        seen: bool,
        beside: bool = False,
    ) -> Footstep | None:
        """The step nearest to ``wish`` ahead of the stance foot that has room; ``beside`` it: on its level.

        Near the feet, where no ground has been ``seen`` yet, a step is felt.
        """
        stance, side, width = feet[1 - foot], side_of(foot), self._config.reach.width
        felt = Foothold(*stance.moved(wish, side * width), stance.yaw, stance.z)
        above = (
            np.zeros(1)
            if seen
            else self._reference + self._map.at(turned(self._fits[-1][0], felt.yaw) + felt.pose[:2]) - stance.z
        )
        if np.isnan(above).any() and not (np.abs(above) > _LEVEL).any():  # what is known there is level with the stance
            return Footstep(foot, felt)
        best, cost = None, np.inf
        for ahead in np.arange(least, most, _GRID).tolist():
            for aside in _ASIDE:
                step, room = self._lie(foot, Foothold(*stance.moved(ahead, side * (width + aside)), stance.yaw))
                if step is None or (beside and abs(step.hold.z - stance.z) > _LEVEL):
                    continue
                value = (ahead - wish) ** 2 + aside**2 + _EDGE_WEIGHT * max(_COMFORT - room, 0.0) ** 2
                if value >= cost:
                    continue
                try:
                    check_footsteps([step], feet, self._config)
                except UnreachableError:
                    continue
                best, cost = step, value
        return best

    def _lie(self, foot: int, place: Foothold) -> tuple[Footstep | None, float]:
        """Step onto the ground at a place, and the room ahead and back [m]; None where no sole lies."""
        found, room = None, 0.0
        for way, (points, inverse) in zip(_ROOMS, self._fits, strict=True):
            heights = self._map.at(turned(points, place.yaw) + place.pose[:2])
            along, across, middle = inverse @ heights
            if not np.abs(points @ (along, across) + middle - heights).max() <= _FLAT:
                break
            slope = rotated(place.yaw, float(along), float(across))
            hold = Foothold(place.x, place.y, place.yaw, self._reference + float(middle))
            found, room = Footstep(foot, hold, Tread(slope, (way, way, _BESIDE, _BESIDE))), way
        return found, room

    def _obstacle(self, stance: Foothold) -> str:
        """Why no foot can be put down ahead of a stance foot."""
        reach = self._config.reach
        places = np.array([stance.moved(ahead, 0.0) for ahead in np.arange(0.1, reach.forward, 0.02).tolist()])
        rises = self._reference + self._map.at(places) - stance.z
        beyond = rises[np.abs(rises) > reach.rise]
        if len(beyond):
            rise = float(beyond[np.argmin(np.abs(beyond))])
            way = "higher" if rise > 0.0 else "lower"
            return f"the ground ahead is {abs(rise):.2f} m {way}, at most {reach.rise:.2f} m"
        if np.isnan(rises).any():
            return "the ground ahead is not known"
        return f"no room for a sole up to {reach.forward:.2f} m ahead"
