"""Regions of the stance frame in which a swing foot may land, each convex, and the way round the stance leg."""

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.numerics.compiled import register_jitable
from planners.gait.config import ReachConfig
from planners.gait.footsteps import LEFT, Point, StepLimits, limits_of

Array = NDArray[np.float64]

NOWHERE = (math.nan, math.nan)  #: No corner


class Region(IntEnum):
    """Where a foot lands relative to the stance foot."""

    OWN = 0  #: On its own side
    URGENT = 1  #: The same for an urgent step
    FRONT = 2  #: Crossed in front of the stance foot, or ahead of it
    BEHIND = 3  #: Crossed behind the stance foot, or behind it

    @property
    def crossing(self) -> bool:
        """Whether the foot has to round the stance foot."""
        return self in (Region.FRONT, Region.BEHIND)


#: Regions of an urgent step
URGENT_REGIONS = (Region.URGENT, Region.FRONT, Region.BEHIND)


def region_limits(reach: ReachConfig) -> tuple[StepLimits, ...]:
    """Limits of the footholds in each region."""
    own = limits_of(reach)
    crossed = own._replace(width_min=-reach.cross, width_max=reach.width_min)
    return (
        own,
        own._replace(width_max=reach.width_urgent),
        crossed._replace(backward=-reach.cross_ahead),
        crossed._replace(forward=-reach.cross_ahead),
    )


def region_boxes(limits: tuple[StepLimits, ...]) -> Array:
    """Least and largest foothold in each region, of the left and of the right foot (regions, 2, 2, 2) [m]."""
    boxes = np.empty((len(limits), 2, 2, 2))
    for box, limit in zip(boxes, limits, strict=True):
        box[:, 0, 0], box[:, 1, 0] = -limit.backward, limit.forward
        box[0, :, 1] = limit.width_min, limit.width_max
        box[1, :, 1] = -limit.width_max, -limit.width_min
    return boxes


class Passage(NamedTuple):
    """What a swing foot has to keep to, and what it can do."""

    corner: Point  #: Of the area around the stance foot that it must not enter: ahead, and to its own side [m]
    reach: Array  #: Of ``region_boxes``
    speed: float  #: Of the foot [m/s]
    quickest: float  #: Shortest single support [s]


@register_jitable
def corner_between(foot: int, place: Point, target: Point, corner: Point) -> Point:
    """The corner that the straight way of a foot would cut, in the stance frame [m]; NaN without one.

    The area to keep out of is ``|x| < corner[0]``, less to the foot's own side than ``corner[1]``. A foot that is
    inside already leaves it ahead or behind before it goes farther across.
    """
    side = 1.0 if foot == LEFT else -1.0
    first, last = side * place[1] - corner[1], side * target[1] - corner[1]
    if first < 0.0 and last < 0.0:
        if abs(place[0]) >= corner[0] or last >= first:
            return NOWHERE
        return math.copysign(corner[0], target[0]), place[1]
    if first * last >= 0.0:
        return NOWHERE
    x = place[0] + (target[0] - place[0]) * first / (first - last)
    outer = place[0] if first < 0.0 else target[0]  # end of the way beside which the stance foot is
    if abs(x) >= corner[0] or abs(outer) < corner[0]:
        return NOWHERE
    return math.copysign(corner[0], outer), side * corner[1]


@register_jitable
def missed(dcm: Point, place: Point, foot: int, half: Array, omega: float, passage: Passage) -> float:
    """Distance of a DCM from the box of both soles after the quickest urgent step of a foot [m].

    ``dcm`` and ``place``, of the foot at lift-off, are in the stance frame, from the ZMP point of the stance foot;
    ``half`` is half its sole (2,). The DCM moves away from the point of the stance sole that is nearest to it. The foot
    lands as near to it as its reach and its speed allow.
    """
    growth, box, square = math.exp(omega * passage.quickest), passage.reach[Region.URGENT, foot], 0.0
    corner = corner_between(foot, place, (place[0], box[0, 1] if foot == LEFT else box[1, 1]), passage.corner)
    detour = 0.0 if math.isnan(corner[0]) else abs(corner[0] - place[0]) + abs(corner[1] - place[1])
    way = max(passage.speed * passage.quickest - detour, 0.0)
    for i in range(2):
        cop = min(max(dcm[i], -half[i]), half[i])
        end = cop + (dcm[i] - cop) * growth
        landing = min(max(end, box[0, i], place[i] - way), box[1, i], place[i] + way)
        square += max(min(landing, 0.0) - half[i] - end, end - max(landing, 0.0) - half[i], 0.0) ** 2
    return math.sqrt(square)
