"""Reachable motion of a swing foot with limited acceleration along one axis."""

import math
from typing import NamedTuple

from models.numerics.compiled import register_jitable
from planners.gait.footsteps import Point


class FootLimits(NamedTuple):
    """Limits of a swing foot's motion along an axis."""

    speed: float  #: Largest mean speed [m/s]
    acceleration: float  #: Largest acceleration [m/s^2]


@register_jitable
def reachable_distance(time: float, velocity: float, limits: FootLimits) -> Point:
    """Distance that a foot of this velocity covers to rest in a time [m], and its time derivative [m/s].

    If the time is too short to come to rest, the foot brakes harder.
    """
    speed, acceleration = limits
    beyond = 0.25 * (acceleration * time * time - velocity * velocity / acceleration)
    way, rate = 0.5 * velocity * time, 0.5 * velocity
    if beyond > 0.0:
        way, rate = way + beyond, rate + 0.5 * acceleration * time
    if way > speed * time:
        return speed * time, speed
    return way, max(rate, 0.0)


@register_jitable
def time_to_pass(way: float, velocity: float, limits: FootLimits) -> float:
    """Least time in which a foot of this velocity covers a distance without stopping [s]."""
    if way == 0.0:
        return 0.0
    towards = velocity if way > 0.0 else -velocity
    speed, acceleration = limits
    accelerated = math.sqrt(towards * towards + 2.0 * acceleration * abs(way))
    return max((accelerated - towards) / acceleration, abs(way) / speed)


@register_jitable
def time_to_rest(way: float, velocity: float, limits: FootLimits) -> float:
    """Least time in which a foot of this velocity covers a distance and comes to rest [s]."""
    towards = velocity if way > 0.0 else -velocity
    speed, acceleration = limits
    reached = math.sqrt(2.0 * towards * towards + 4.0 * acceleration * abs(way))
    return max((reached - towards) / acceleration, abs(way) / speed)
