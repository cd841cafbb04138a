"""Convex regions of the stance frame in which a swing foot may land, and its path round the stance leg."""

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.numerics.compiled import register_jitable
from planners.gait.config import ReachConfig
from planners.gait.foot_motion import FootLimits, reachable_distance, time_to_pass, time_to_rest
from planners.gait.footsteps import LEFT, Point, StepLimits, limits_of

Array = NDArray[np.float64]

NOWHERE = (math.nan, math.nan)  #: No corner
_RIM = 1e-3  #: Tolerance of the edge of the area around the stance foot [m]


class Region(IntEnum):
    """Region of a foothold relative to the stance foot."""

    OWN = 0  #: Side of the swing foot
    URGENT = 1  #: Side of the swing foot, in an urgent step
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
    """Bounds of the footholds in each region, of the left and of the right foot (regions, 2, 2, 2) [m]."""
    boxes = np.empty((len(limits), 2, 2, 2))
    for box, limit in zip(boxes, limits, strict=True):
        box[:, 0, 0], box[:, 1, 0] = -limit.backward, limit.forward
        box[0, :, 1] = limit.width_min, limit.width_max
        box[1, :, 1] = -limit.width_max, -limit.width_min
    return boxes


@register_jitable
def arrival(place: Point, velocity: Point, corner: Point, limits: FootLimits) -> tuple[float, Point]:
    """Least time to a corner of ``corner_between`` [s], and the velocity of the foot there [m/s].

    The foot comes to rest along the axis that is blocked before the corner, and passes along the other one without
    braking. The blocked axis is x, or y on the way back from across the stance foot.
    """
    outside = place[1] == corner[1] or place[1] * corner[1] >= corner[1] * corner[1]
    x, y = corner[0] - place[0], corner[1] - place[1]
    rest, way, speed = (x, y, velocity[1]) if outside else (y, x, velocity[0])
    resting, passing = time_to_rest(rest, velocity[0 if outside else 1], limits), time_to_pass(way, speed, limits)
    if way != 0.0:
        speed = math.copysign(math.sqrt(speed * speed + 2.0 * limits[1] * abs(way)), way)
    return max(resting, passing), ((0.0, speed) if outside else (speed, 0.0))


class Passage(NamedTuple):
    """Limits of a swing foot's path and motion."""

    corner: Point  #: Corner of the prohibited area around the stance foot: ahead, and to the side of the swing foot [m]
    reach: Array  #: Result of ``region_boxes``
    foot_limits: FootLimits  #: Limits of the foot along each axis
    quickest: float  #: Shortest single support [s]


@register_jitable
def corner_between(foot: int, place: Point, target: Point, corner: Point) -> Point:
    """Corner that the straight path of a foot would cut, in the stance frame [m]; NaN without one.

    The prohibited area is ``|x| < corner[0]``, with y less than ``corner[1]`` towards the side of the swing foot. A
    foot that is already inside leaves it ahead or behind before it moves farther across. Paths round both corners are
    excluded by ``divided``.
    """
    side = 1.0 if foot == LEFT else -1.0
    first, last = side * place[1] - corner[1], side * target[1] - corner[1]
    if first < 0.0 and last < 0.0:
        if abs(place[0]) >= corner[0] - _RIM or last >= first:
            return NOWHERE
        return math.copysign(corner[0], target[0]), place[1]
    if first * last >= 0.0:
        return NOWHERE
    x = place[0] + (target[0] - place[0]) * first / (first - last)
    crossed = place[0] if first < 0.0 else target[0]  # end of the path in front of or behind the stance foot
    ahead = math.copysign(1.0, crossed)
    if ahead * x >= corner[0] - _RIM or abs(crossed) < corner[0] - _RIM:
        return NOWHERE
    return ahead * corner[0], side * corner[1]


def divided(foot: int, place: Point, region: Region, corner: Point) -> bool:
    """Whether the stance foot is between a position of the foot and a region, so that the path rounds both corners."""
    side, ahead = 1.0 if foot == LEFT else -1.0, 1.0 if region is Region.FRONT else -1.0
    return region.crossing and side * place[1] < corner[1] and ahead * place[0] < 0.0


@register_jitable
def missed(dcm: Point, place: Point, foot: int, half: Array, omega: float, passage: Passage) -> float:
    """Distance of a DCM from the box of both soles after the quickest urgent step of a foot [m].

    ``dcm`` and ``place``, the position of the foot at lift-off, are in the stance frame, relative to the ZMP point of
    the stance foot; ``half`` is the half size of its sole (2,). The DCM diverges from the nearest point of the stance
    sole. The foot lands as close to the DCM as its reach and speed allow.
    """
    growth, box, square = math.exp(omega * passage.quickest), passage.reach[Region.URGENT, foot], 0.0
    way, _ = reachable_distance(passage.quickest, 0.0, passage.foot_limits)
    for i in range(2):
        cop = min(max(dcm[i], -half[i]), half[i])
        end = cop + (dcm[i] - cop) * growth
        landing = min(max(end, box[0, i], place[i] - way), box[1, i], place[i] + way)
        square += max(min(landing, 0.0) - half[i] - end, end - max(landing, 0.0) - half[i], 0.0) ** 2
    return math.sqrt(square)
