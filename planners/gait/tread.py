"""Known ground under footsteps: slope and room, swings over edges, and the crouch of the body."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from models.numerics.compiled import register_jitable
from models.types import Matrix
from planners.gait.footsteps import Foothold, Point, rotated, wrap

Room = tuple[float, float, float, float]

PEAK = 10.0 / math.sqrt(3.0)  #: Largest acceleration of a quintic from rest to rest, for unit way and time [way/time^2]
ANYWHERE = np.array([[-np.inf, -np.inf], [np.inf, np.inf]])  #: Bounds of an unbounded position (2, 2) [m]
_OVER = 0.01  #: Distance by which the bounds of a turned sole may exceed its room [m]
_HALVINGS = 20  #: Bisections for the time at which a quintic has covered a share of its way


class Tread(Struct, frozen=True):
    """Known ground under a footstep, whose height is then used; without one, the ground is felt: found by contact."""

    slope: Point = (0.0, 0.0)  #: Rise along x and along y of W [-]
    room: Room | None = None  #: Distance that the sole may move backward, forward, right, left [m]; None: any
    over: float = 0.0  #: Height of an obstacle that the foot passes, above the higher end of the swing [m]

    def height(self, hold: Foothold, x: float, y: float) -> float:
        """Height of the ground at a point of W, for the foothold ``hold`` on it [m]."""
        return hold.z + self.slope[0] * (x - hold.x) + self.slope[1] * (y - hold.y)


def bounds_in(stance: Foothold, hold: Foothold, tread: Tread | None) -> Matrix:
    """Lower and upper bounds of the position of a sole on a tread, along x and y of the stance frame (2, 2) [m].

    If the stance frame is turned from the tread, the bounds are a box within the room extended by ``_OVER``. Otherwise,
    on a tread hardly longer than the sole, half a degree would take all room to the sides.
    """
    if tread is None or tread.room is None:
        return ANYWHERE
    back, forward, right, left = tread.room
    x, y = stance.relative(hold.x, hold.y)
    turn = abs(wrap(hold.yaw - stance.yaw))
    c, s = abs(math.cos(turn)), math.sin(turn)
    room = back + forward, right + left
    long, wide = (size + 2.0 * _OVER for size in room)
    share = min(long / (c * long + s * wide), wide / (s * long + c * wide))  # box inscribed in the turned one
    middle = rotated(hold.yaw - stance.yaw, 0.5 * (forward - back), 0.5 * (left - right))
    x, y = x + middle[0], y + middle[1]
    half = 0.5 * min(share * long, room[0]), 0.5 * min(share * wide, room[1])
    return np.array([[x - half[0], y - half[1]], [x + half[0], y + half[1]]])


class SwingShares(NamedTuple):
    """Times of a swing as shares of its duration."""

    apex: float  #: Time of the highest point
    wait: float = 0.0  #: Time in which the foot only rises, before it moves forward over an edge
    settle: float = 0.0  #: Time in which the foot only descends at the end, beyond an edge

    @property
    def moving(self) -> float:
        """Share in which the foot moves to its target."""
        return 1.0 - self.wait - self.settle


@register_jitable
def clearance_over(rise: float, level: float, edge: float, over: float = 0.0) -> float:
    """Clearance above the higher end of a swing [m], from ``level`` on level ground to ``edge`` over an edge.

    It is increased by ``over``, the height of an obstacle above that end [m].
    """
    return over + max(level, min(level + abs(rise) + over, edge))


@register_jitable
def swing_shares(
    rise: float, clearance: float, way: float, apex: float, edge: float, early: float, over: float = 0.0
) -> tuple[float, float, float]:
    """``SwingShares`` of a swing with a known ``rise`` of its end [m], negative down, over a way [m].

    The times of ascent and descent are in the ratio of the square roots of their heights, for equal accelerations;
    ``apex`` is that of a level swing. Between the footholds is an edge, or an obstacle higher than both by ``over``
    [m], at least ``edge`` [m] from the sole on either of them. The foot is above it, by up to half its clearance, from
    before it arrives until it has passed. It turns from the apex to the landing ``early``, a share of its duration.
    """
    begin, end = over + max(rise, 0.0), over + max(-rise, 0.0)  # height of the obstacle above either end
    up, down = clearance + max(rise, 0.0), clearance + max(-rise, 0.0)
    top = apex / (apex + (1.0 - apex) * math.sqrt(down / up))
    if way <= edge:
        return top, 0.0, 0.0
    passing, margin = _quintic_time(edge / way), 0.5 * (clearance - over)
    rising = _quintic_time((begin + min(begin, margin)) / up) * top if begin > 0.0 else 0.0
    falling = _quintic_time((end + min(end, margin)) / down) * (1.0 - top + early) if end > 0.0 else 0.0
    wait, settle = max(rising - passing, 0.0) / (1.0 - passing), max(falling - passing, 0.0) / (1.0 - passing)
    if (wait > 0.0 and falling > passing * (1.0 - wait)) or (settle > 0.0 and rising > passing * (1.0 - settle)):
        passing *= (1.0 - rising - falling) / (1.0 - 2.0 * passing)  # times the share in which the foot moves
        return top, max(rising - passing, 0.0), max(falling - passing, 0.0)
    return top, wait, settle


@register_jitable
def _quintic_time(share: float) -> float:
    """Share of the time after which a quintic from rest to rest has covered a share of its way."""
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        u = 0.5 * (low + high)
        if u * u * u * (10.0 + u * (6.0 * u - 15.0)) < share:
            low = u
        else:
            high = u
    return 0.5 * (low + high)


def swing_time(rise: float, clearance: float, apex: float, acceleration: float) -> float:
    """Duration [s] of a swing with a known rise [m], at a largest vertical acceleration [m/s^2]."""
    up = swing_shares(abs(rise), clearance, 0.0, apex, 0.0, 0.0)[0]
    return math.sqrt(PEAK * (abs(rise) + clearance) / acceleration) / up


@register_jitable
def leg_height(square: float, leg: float) -> float:
    """Height of the hip above a foot [m], from their squared horizontal distance [m^2] and the leg length [m]."""
    return math.sqrt(max(leg * leg - square, 0.25 * leg * leg))


def crouch_between(first: Foothold, last: Foothold, side: float, width: float, leg: float) -> float:
    """Descent of the body from standing, half-way between two soles, so that no leg is longer than ``leg`` [m].

    ``last`` is on the ``side`` of ``first`` (+1 left), in the nominal stance ``width`` away [m].
    """
    along, left = first.relative(last.x, last.y)
    return step_crouch(along, left - side * width, last.z - first.z, leg)


@register_jitable
def step_crouch(along: float, wider: float, rise: float, leg: float) -> float:
    """``crouch_between`` for soles this far apart along the way, beyond the nominal width, and in height [m]."""
    return leg - leg_height(0.25 * (along * along + wider * wider), leg) + 0.5 * abs(rise)
