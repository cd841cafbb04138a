"""Footsteps over stairs of known geometry."""

from __future__ import annotations

import math

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


def stair_stations(stairs: Stairs, heel: float, toe: float, stride: float) -> list[tuple[float, float, bool]]:
    """Places of a sole: way [m], height [m], and whether an edge follows or comes before.

    ``heel`` and ``toe`` are how far the sole reaches behind and ahead of its frame [m]. On every tread it is in the
    middle, and as far from the edges on the levels before and after it. On these, places are at most ``stride`` [m]
    apart.
    """
    margin = 0.5 * (stairs.tread - heel - toe)
    first, last = margin + heel, margin + toe  # from the edge behind, and to the edge ahead
    top = stairs.ahead + (stairs.count - 1) * stairs.tread
    stations = [(x, 0.0, False) for x in _spread(0.0, stairs.ahead - last, stride)]
    stations.append((stairs.ahead - last, 0.0, True))
    stations += [(stairs.ahead + k * stairs.tread + first, (k + 1) * stairs.rise, True) for k in range(stairs.count)]
    height, edge = stairs.count * stairs.rise, top + stairs.landing
    stations += [(x, height, False) for x in _spread(top + first, edge - last, stride)]
    if edge - last > top + first + _FEW:
        stations.append((edge - last, height, True))
    return stations + [
        (edge + k * stairs.tread + first, (stairs.count - 1 - k) * stairs.rise, True) for k in range(stairs.count)
    ]


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
    is too short for that.
    """
    width, edge = config.reach.width, config.swing.edge
    heel, toe = -model.feet[LEFT].rectangle[0], model.feet[LEFT].rectangle[1]
    stations = stair_stations(stairs, heel, toe, stride)
    along = 0.5 * (stairs.tread - heel - toe) - edge
    beside = 0.5 * stairs.width - 0.5 * width - model.feet[LEFT].rectangle[3]
    if min(along, beside) < 0.0:
        raise UnreachableError(f"treads of {stairs.tread:.3f} m by {stairs.width:.3f} m leave a sole no room")
    steps, foot = [], LEFT
    for i, (way, height, near) in enumerate(stations):
        tread = Tread(room=(along, along, beside, beside) if near else None)
        for _ in range(2 if (near and together) or i == len(stations) - 1 else 1):
            x, y = start.moved(way, side_of(foot) * 0.5 * width)
            steps.append(Footstep(foot, Foothold(x, y, start.yaw, start.z + height), tread))
            foot = 1 - foot
    return steps
