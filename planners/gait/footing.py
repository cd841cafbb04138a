"""Partial contact: the area of each planted sole that bears load. A sole that turns over an edge bears on it alone."""

from dataclasses import astuple
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from models.numerics.compiled import njit, register_jitable
from models.numerics.unboxed import Unboxed, unbox
from models.robot_model import RobotModel
from models.types import Matrix, Vector
from planners.gait.config import FootingConfig
from planners.gait.measurement import Measurement

_BEARS = 0.05  #: Least share of the weight on a sole with a centre of pressure [-]


class FootingLimits(NamedTuple):
    """Fields of ``FootingConfig`` in their order, for compiled code."""

    load: float
    turning: float
    turned: float
    forget_time: float
    edge: float
    rest: float
    tilted: float
    regain: float
    grain: float
    rim: float
    lie_angle: float
    lie_time: float


class _Soles(NamedTuple):
    """Constants of ``Footing``."""

    whole: Matrix  # rectangles (2, 4) [m]
    limits: FootingLimits


class SoleRotation(NamedTuple):
    """Rotation of the soles over edges; rectangles are x_min, x_max, y_min, y_max in the sole's frame."""

    edges: Matrix  # CoP of each sole, held while it moves less than ``edge`` (2, 2) [m]
    turned: Matrix  # recent rotation of each sole while its CoP is held (2, 2) [rad]
    fallen: Matrix  # rotation of each sole since it last lay still on its whole area (2, 2) [rad]
    rested: Vector  # time for which each sole has lain still (2,) [s]
    bounds: Matrix  # bearing rectangle of each sole (2, 4) [m]
    tipped: Matrix  # rotation of each sole from the ground over its rim; zero if the CoP is inside (2, 2) [rad]


@register_jitable
def _views(block: Matrix) -> SoleRotation:
    """Views of one array (2, 13); copying and passing it takes a fifth of the time of six arrays."""
    return SoleRotation(block[:, 0:2], block[:, 2:4], block[:, 4:6], block[:, 6], block[:, 7:11], block[:, 11:13])


class FootingState(Struct, frozen=True):
    """Rotation of the soles and their bearing areas."""

    block: Matrix  # a ``SoleRotation``, see ``_views`` (2, 13)
    areas: Matrix  # bearing rectangles in steps of ``grain`` (2, 4) [m]

    def lies_flat(self, foot: int) -> bool:
        """Whether a planted sole bears on an area, not on an edge."""
        x_min, x_max, y_min, y_max = self.areas[foot].tolist()
        return bool(x_min < x_max and y_min < y_max)


class Footing:
    """Determines the rectangle of each sole that has ground under it.

    The CoP of a loaded sole that turns is on the edge it turns over, and only that line has ground under it. The sole
    is treated as an edge contact, since a CoP commanded beside the line would turn it. If the CoP moves during the
    rotation, the sole rolls flat and no edge is detected. A sole that returns to its last orientation turns over no new
    edge. A sole that comes to rest in a turned orientation has found ground on the other side of the edge (a slope or a
    lower tile); its rectangle is whole again. If it has turned back or turned less, its rectangle grows again while it
    lies still. A foot that lifts lands on its whole sole.

    A sole that has tipped over its rim bears on that line. Its rectangle has no width, and the whole-body QP treats it
    as an edge contact. The same holds for a sole that lands tilted, until it lies flat or its CoP leaves the rim. A
    sole on its rim turns freely; if it rests, the slope of the ground differs from the expected one.

    References:
        G. Wiedebach et al., Walking on partial footholds including line contacts with the humanoid robot Atlas,
        Humanoids 2016.
    """

    def __init__(self, model: RobotModel, config: FootingConfig) -> None:
        self._whole = np.array([foot.rectangle for foot in model.feet])
        self._constants = unbox(_Soles(self._whole, FootingLimits(*astuple(config))))

    def whole(self, before: FootingState | None = None) -> FootingState:
        """State with whole soles and the CoP of ``before``."""
        block = np.zeros((2, 13))
        soles = _views(block)
        soles.bounds[:] = self._whole
        if before is not None:
            soles.edges[:] = _views(before.block).edges
        return FootingState(block, self._whole)

    def update(
        self,
        footing: FootingState,
        measured: Measurement,
        swinging: int | None,
        slope: Vector,
        dt: float,
        *,
        urgent: bool = False,
    ) -> FootingState:
        """State after one tick; the foot ``swinging`` (None in double support) lands on its whole sole or on its rim.

        ``slope`` is the ground slope at landing (2,) [-]. In an ``urgent`` step only rims count as edges.
        """
        block, areas, foot = footing.block.copy(), footing.areas.copy(), -1 if swinging is None else swinging
        if urgent:
            soles = _views(block)
            soles.bounds[:], soles.turned[:], soles.fallen[:], soles.rested[:] = self._whole, 0.0, 0.0, 0.0
        yaw = measured.soles[foot].yaw
        _update(
            foot, measured.loads, dt, measured.turning, measured.cops, measured.tilts[foot] - slope, yaw, urgent,
            self._constants, block, areas,
        )  # fmt: skip
        return FootingState(block, areas)


@register_jitable
def _turns(speed: float, turned: float, fallen: float, limits: FootingLimits) -> bool:
    """Whether a sole turns over an edge, and not back to its last orientation."""
    onward = turned * speed > 0.0 and fallen * speed > 0.0
    return onward and abs(speed) > limits.turning and min(abs(turned), abs(fallen)) > limits.turned


@register_jitable
def _tip(low: float, high: float, angle: float, on_edge: bool, cop: float, limits: FootingLimits) -> tuple[float, int]:
    """Angle over the rim, positive if the high side rises, and the rim on which the sole stands: -1, 1 or 0 (none)."""
    if cop > low + limits.rim if angle > 0.0 else cop < high - limits.rim:
        return 0.0, 0
    if abs(angle) < (0.5 if on_edge else 1.0) * limits.tilted:
        return angle, 0
    return angle, -1 if angle > 0.0 else 1


@njit(cache=True)
def _update(
    swinging: int,
    loads: tuple[float, float],
    dt: float,
    turning: Matrix,
    cops: Matrix,
    tilt: Vector,
    yaw: float,
    urgent: bool,
    constants: Unboxed[_Soles],
    block: Matrix,
    areas: Matrix,
) -> None:
    """Update ``block`` and ``areas`` in place by one tick; ``swinging`` is -1 in double support.

    ``tilt`` is the slope of the swing sole relative to the ground, in W (2,) [-].
    """
    whole, limits = constants.record
    edges, turned, fallen, rested, bounds, tipped = _views(block)
    for foot in range(2):
        if foot == swinging:
            for i in range(4):
                bounds[foot, i] = areas[foot, i] = whole[foot, i]
            for about in range(2):
                turned[foot, about] = fallen[foot, about] = 0.0
            rested[foot] = 0.0
            c, s = np.cos(yaw), np.sin(yaw)
            tipped[foot, 0], tipped[foot, 1] = c * tilt[1] - s * tilt[0], -(c * tilt[0] + s * tilt[1])
            continue
        for about in range(0 if urgent else 2):
            speed, axis = turning[foot, about], 1 - about
            if abs(cops[foot, axis] - edges[foot, axis]) > limits.edge:
                edges[foot, axis], turned[foot, about] = cops[foot, axis], 0.0
            turned[foot, about] += dt * (speed - turned[foot, about] / limits.forget_time)
            fallen[foot, about] += dt * speed
        if loads[foot] >= limits.load and not urgent:
            for axis in range(2):
                # About x, turning forwards lifts the left side (high y); about y it lowers the front (high x).
                about, low, high, sign = 1 - axis, 2 * axis, 2 * axis + 1, 1.0 if axis == 0 else -1.0
                speed, edge = turning[foot, about], min(max(cops[foot, axis], whole[foot, low]), whole[foot, high])
                ahead = whole[foot, high] - edge if sign * speed > 0.0 else edge - whole[foot, low]  # descending side
                if ahead > limits.rim and _turns(speed, turned[foot, about], fallen[foot, about], limits):
                    bounds[foot, low] = bounds[foot, high] = edge
            still = max(abs(turning[foot, 0]), abs(turning[foot, 1])) < 0.5 * limits.turning
            rested[foot] = rested[foot] + dt if still else 0.0
            for axis in range(2 if still else 0):
                about, low, high = 1 - axis, 2 * axis, 2 * axis + 1
                rests = rested[foot] >= limits.rest
                growth = np.inf if rests and abs(fallen[foot, about]) > limits.tilted else limits.regain * dt
                bounds[foot, low] = max(bounds[foot, low] - growth, whole[foot, low])
                bounds[foot, high] = min(bounds[foot, high] + growth, whole[foot, high])
                if rests and bounds[foot, low] == whole[foot, low] and bounds[foot, high] == whole[foot, high]:
                    fallen[foot, about] = 0.0
        on_edge = areas[foot, 0] == areas[foot, 1], areas[foot, 2] == areas[foot, 3]
        for i in range(4):
            bound = bounds[foot, i]
            areas[foot, i] = bound if bound == whole[foot, i] else np.rint(bound / limits.grain) * limits.grain
            if i % 2 == 1 and bound == bounds[foot, i - 1]:
                areas[foot, i] = areas[foot, i - 1]
        for axis in range(2):
            about, sign = (1, -1.0) if axis == 0 else (0, 1.0)
            low, high = whole[foot, 2 * axis], whole[foot, 2 * axis + 1]
            angle, rim = sign * (tipped[foot, about] + dt * turning[foot, about]), 0
            if loads[foot] >= _BEARS:
                stillness = max(1.0 - 2.0 * abs(turning[foot, about]) / limits.turning, 0.0)
                angle *= 1.0 - min(dt / limits.lie_time, 1.0) * stillness
                angle, rim = _tip(low, high, angle, on_edge[axis], cops[foot, axis], limits)
            tipped[foot, about] = sign * angle
            if rim != 0:
                areas[foot, 2 * axis] = areas[foot, 2 * axis + 1] = low if rim < 0 else high
