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

_FEW = 1e-6  #: Rounding of a number of stations [-]


class Stairs(Struct, frozen=True):
    """A straight flight up, a landing, and as many steps down again, across the heading of a robot in front of it."""

    ahead: float  #: First riser from the middle between the soles' frames [m]
    rise: float  #: Of each step, negative down first [m]
    tread: float  #: Depth of a step [m]
    count: int  #: Risers up
    landing: float  #: Depth of the upper level [m]
    width: float  #: Of the flight, the robot in its middle [m]


class Station(NamedTuple):
    """Place of a sole on the way over stairs."""

    way: float  #: From the start [m]
    height: float  #: Above it [m]
    room: tuple[float, float] | None = None  #: Backward and forward to where an edge is too near [m]; None: no edge


def stair_stations(stairs: Stairs, heel: float, toe: float, stride: float, edge: float) -> list[Station]:
    """Places of a sole on its way over stairs.

    ``heel`` and ``toe`` are how far the sole reaches behind and ahead of its frame [m]. On every tread, and on the
    levels before and after it, the sole is ``edge`` [m] from the edge of the tread, and so as far from the riser as it
    can be, which knee, shin and heel might touch. On the levels, places are at most ``stride`` apart [m]. Raises
    ``UnreachableError`` when a tread is too short.
    """
    spare = stairs.tread - heel - toe - 2.0 * edge
    if spare < 0.0:
        raise UnreachableError(
            f"treads of {stairs.tread:.3f} m: at least {heel + toe + 2.0 * edge:.3f} m for this robot's sole"
        )
    wall = edge + spare  # from the sole to the riser
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
    """Places between two, evenly and at most ``stride`` apart [m]."""
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
    """Footsteps of a robot that stands at ``start``, the pose between its soles, over stairs ahead of it.

    ``together`` puts both feet on every tread, one after the other; else each foot goes from one tread to the next but
    one. A sole may move on its tread as far as ``swing.edge`` from its edges. Raises ``UnreachableError`` when a tread
    is too short or too narrow.
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
