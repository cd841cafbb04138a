"""Footsteps over stairs of known geometry."""

from __future__ import annotations

import math
from typing import NamedTuple

from msgspec import Struct

from models.errors import UnreachableError
from models.robot_model import RobotModel
from planners.gait.config import GaitConfig
from planners.gait.footsteps import LEFT, Foothold, side_of
from planners.gait.route import Footstep
from planners.gait.tread import Tread

_FEW = 1e-6  #: Rounding tolerance of the number of stations [-]


class Stairs(Struct, frozen=True):
    """Straight stairs ahead of a robot that faces them: a flight up, a landing, and as many steps down."""

    ahead: float  #: Distance from the middle between the sole frames to the first riser [m]
    rise: float  #: Height of each step [m]; negative if the first flight goes down
    tread: float  #: Depth of a tread [m]
    count: int  #: Number of risers up
    landing: float  #: Depth of the landing [m]
    width: float  #: Width of the stairs [m]; the robot is at their middle


class Station(NamedTuple):
    """Position of a sole on the way over stairs."""

    way: float  #: Distance from the start [m]
    height: float  #: Height above the start [m]
    room: tuple[float, float] | None = None  #: Room backward and forward up to the edge margin [m]; None: no edge


def stair_stations(stairs: Stairs, heel: float, toe: float, stride: float, edge: float) -> list[Station]:
    """Positions of a sole on its way over stairs.

    ``heel`` and ``toe`` are the extents of the sole behind and ahead of its frame [m]. On every tread, and next to the
    stairs on both levels, the sole is ``edge`` [m] from the edge of the tread. This is the largest distance from the
    riser, which knee, shin or heel might touch. On the levels, positions are at most ``stride`` [m] apart. Raises
    ``UnreachableError`` if a tread or the landing is too short.
    """
    for what, depth in (("a landing", stairs.landing), ("treads", stairs.tread)):
        spare = depth - heel - toe - 2.0 * edge
        if spare < 0.0:
            raise UnreachableError(
                f"{what} of {depth:.3f} m: at least {heel + toe + 2.0 * edge:.3f} m for this robot's sole"
            )
    wall = edge + spare  # distance from the sole to the riser of a tread
    sides = ((edge, wall), (wall, edge)) if stairs.rise > 0.0 else ((wall, edge), (edge, wall))
    end = stairs.ahead + (stairs.count - 1) * stairs.tread + stairs.landing
    stations: list[Station] = []
    height = 0.0
    for (behind, before), riser, rise in zip(sides, (stairs.ahead, end), (stairs.rise, -stairs.rise), strict=True):
        room, last = (behind - edge, before - edge), riser - before - toe
        start = stations[-1].way if stations else 0.0
        stations += [Station(way, height) for way in _spread(start, last, stride)]
        stations.append(Station(last, height, room))
        for k in range(stairs.count):
            height += rise
            stations.append(Station(riser + k * stairs.tread + behind + heel, height, room))
    return stations


def _spread(begin: float, end: float, stride: float) -> list[float]:
    """Evenly spaced positions between ``begin`` and ``end``, at most ``stride`` apart [m]."""
    parts = math.ceil((end - begin) / stride - _FEW)
    return [begin + (end - begin) * i / parts for i in range(1, parts)]


def stair_footsteps(
    stairs: Stairs,
    start: Foothold,
    model: RobotModel,
    config: GaitConfig,
    *,
    stride: float = 0.25,
    together: bool = True,
) -> list[Footstep]:
    """Footsteps over stairs ahead of a robot that stands at ``start``, the pose between its soles.

    With ``together``, both feet step on every tread, one after the other; otherwise each foot steps on every second
    tread. A sole may move on its tread up to ``swing.edge`` from front and rear edge, and sideways up to the side of
    the stairs. Raises ``UnreachableError`` if a tread or the landing is too short or too narrow.
    """
    width, edge = config.reach.width, config.swing.edge
    heel, toe = -model.feet[LEFT].rectangle[0], model.feet[LEFT].rectangle[1]
    stations = stair_stations(stairs, heel, toe, stride, edge)
    beside = 0.5 * (stairs.width - width) - model.feet[LEFT].rectangle[3]
    if beside < 0.0:
        raise UnreachableError(f"stairs of {stairs.width:.3f} m are too narrow for soles {width:.3f} m apart")
    steps, foot = [], LEFT
    for i, (way, height, room) in enumerate(stations):
        tread = Tread(room=None if room is None else (*room, beside, beside))
        for _ in range(2 if (room and together) or i == len(stations) - 1 else 1):
            x, y = start.moved(way, side_of(foot) * 0.5 * width)
            steps.append(Footstep(foot, Foothold(x, y, start.yaw, start.z + height), tread))
            foot = 1 - foot
    return steps
