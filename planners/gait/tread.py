"""Known ground under footsteps: its slope and its room, the swing over the edges between, and the crouch it takes."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from models.numerics.compiled import register_jitable
from models.types import Matrix
from planners.gait.footsteps import Foothold, Point, rotated, wrap

Room = tuple[float, float, float, float]

PEAK = 10.0 / math.sqrt(3.0)  #: Largest acceleration of a quintic from rest to rest over a way in a time [way/time^2]
ANYWHERE = np.array([[-np.inf, -np.inf], [np.inf, np.inf]])  #: Bounds of a place that has none (2, 2) [m]
_OVER = 0.01  #: By which a sole that is turned may come nearer to the edges than its room has it [m]
_HALVINGS = 20  #: Of the time at which a quintic has covered a share of its way


class Tread(Struct, frozen=True):
    """Ground that is known under a footstep, whose height then counts; without one, the foot feels it."""

    slope: Point = (0.0, 0.0)  #: Rise along x and along y of W [-]
    room: Room | None = None  #: How far the sole may move backward, forward, right, left on it [m]; None: anywhere
    over: float = 0.0  #: Height of what the foot passes on its way there, above the higher one of both ends [m]

    def height(self, hold: Foothold, x: float, y: float) -> float:
        """Height of the ground at a point of W, with the foothold ``hold`` on it [m]."""
        return hold.z + self.slope[0] * (x - hold.x) + self.slope[1] * (y - hold.y)


def bounds_in(stance: Foothold, hold: Foothold, tread: Tread | None) -> Matrix:
    """Least and largest place of a sole on a tread along both axes of the stance frame (2, 2) [m].

    Where that is turned from the tread, the places are within the room and ``_OVER`` around it: on a tread hardly
    longer than the sole, half a degree would otherwise take all room to the sides.
    """
    if tread is None or tread.room is None:
        return ANYWHERE
    back, forward, right, left = tread.room
    x, y = stance.relative(hold.x, hold.y)
    turn = abs(wrap(hold.yaw - stance.yaw))
    c, s = abs(math.cos(turn)), math.sin(turn)
    room = back + forward, right + left
    long, wide = (size + 2.0 * _OVER for size in room)
    share = min(long / (c * long + s * wide), wide / (s * long + c * wide))  # box within the turned one
    middle = rotated(hold.yaw - stance.yaw, 0.5 * (forward - back), 0.5 * (left - right))
    x, y = x + middle[0], y + middle[1]
    half = 0.5 * min(share * long, room[0]), 0.5 * min(share * wide, room[1])
    return np.array([[x - half[0], y - half[1]], [x + half[0], y + half[1]]])


class SwingShares(NamedTuple):
    """Times of a swing as shares of its duration."""

    apex: float  #: When the foot is highest
    wait: float = 0.0  #: For which it only rises, before it goes forward over an edge
    settle: float = 0.0  #: For which it only descends at the end, beyond an edge

    @property
    def moving(self) -> float:
        """Share in which the foot goes to its target."""
        return 1.0 - self.wait - self.settle


@register_jitable
def clearance_over(rise: float, level: float, edge: float, over: float = 0.0) -> float:
    """Height of the sole over the higher end of a swing, from that on the ``level`` to that over an ``edge`` [m].

    What it passes is higher than that end by ``over`` [m].
    """
    return over + max(level, min(level + abs(rise) + over, edge))


@register_jitable
def swing_shares(
    rise: float, clearance: float, way: float, apex: float, edge: float, early: float, over: float = 0.0
) -> tuple[float, float, float]:
    """``SwingShares`` of a swing that ends higher by a known ``rise`` [m], negative down, over a way [m].

    Up and down take times in the ratio of the square roots of their heights: equal accelerations; ``apex`` is that of a
    level swing. Between the footholds is an edge, or what is higher than both by ``over`` [m], at least ``edge`` [m]
    away from the sole on either of them. The foot is up to half its clearance above it before it gets there, and until
    it has passed it. It turns from the apex to the landing ``early``, a share of its duration.
    """
    begin, end = over + max(rise, 0.0), over + max(-rise, 0.0)  # of what it passes above its ends
    up, down = clearance + max(rise, 0.0), clearance + max(-rise, 0.0)
    top = apex / (apex + (1.0 - apex) * math.sqrt(down / up))
    if way <= edge:
        return top, 0.0, 0.0
    passing, margin = _quintic_time(edge / way), 0.5 * (clearance - over)
    rising = _quintic_time((begin + min(begin, margin)) / up) * top if begin > 0.0 else 0.0
    falling = _quintic_time((end + min(end, margin)) / down) * (1.0 - top + early) if end > 0.0 else 0.0
    wait, settle = max(rising - passing, 0.0) / (1.0 - passing), max(falling - passing, 0.0) / (1.0 - passing)
    if (wait > 0.0 and falling > passing * (1.0 - wait)) or (settle > 0.0 and rising > passing * (1.0 - settle)):
        passing *= (1.0 - rising - falling) / (1.0 - 2.0 * passing)  # of the time in which it goes on
        return top, max(rising - passing, 0.0), max(falling - passing, 0.0)
    return top, wait, settle


@register_jitable
def _quintic_time(share: float) -> float:
    """Share of the time after which the quintic from rest to rest has covered a share of its way."""
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        u = 0.5 * (low + high)
        if u * u * u * (10.0 + u * (6.0 * u - 15.0)) < share:
            low = u
        else:
            high = u
    return 0.5 * (low + high)


def swing_time(rise: float, clearance: float, apex: float, acceleration: float) -> float:
    """Duration of a swing with a known rise [m] at a vertical acceleration [m/s^2], in [s]."""
    up = swing_shares(abs(rise), clearance, 0.0, apex, 0.0, 0.0)[0]
    return math.sqrt(PEAK * (abs(rise) + clearance) / acceleration) / up


@register_jitable
def leg_height(square: float, leg: float) -> float:
    """Height of the hip over a foot at the root of a ``square`` [m^2] beside it, on a leg of a length [m]."""
    return math.sqrt(max(leg * leg - square, 0.25 * leg * leg))


def crouch_between(first: Foothold, last: Foothold, side: float, width: float, leg: float) -> float:
    """How much lower than standing the body is half-way between two soles, with no leg longer than ``leg`` [m].

    ``last`` is to the ``side`` of ``first`` (+1 left), in the nominal stance by ``width`` [m].
    """
    along, left = first.relative(last.x, last.y)
    square = 0.25 * (along * along + (left - side * width) ** 2)
    return leg - leg_height(square, leg) + 0.5 * abs(last.z - first.z)
