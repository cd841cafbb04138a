"""Partial contact: the part of each planted sole that bears. A sole that turns over an edge has ground on one side."""

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


class FootingLimits(NamedTuple):
    """Fields of ``FootingConfig`` in their order, for compiled code."""

    load: float
    turning: float
    turned: float
    forget_time: float
    edge: float
    still: float
    rest: float
    fallen: float
    regain: float
    strip: float
    grain: float


class _Soles(NamedTuple):
    """Constants of ``Footing``."""

    whole: Matrix  # rectangles (2, 4) [m]
    limits: FootingLimits


class SoleRotation(NamedTuple):
    """Rotation of the soles over edges; rectangles are x_min, x_max, y_min, y_max in the sole's frame."""

    edges: Matrix  # CoP of each sole, held while it moves less than ``edge`` (2, 2) [m]
    turned: Matrix  # recent rotation of each sole while its CoP rests there (2, 2) [rad]
    fallen: Matrix  # rotation of each sole since it last lay still and whole (2, 2) [rad]
    rested: Vector  # time for which each sole has lain still (2,) [s]
    bounds: Matrix  # rectangle of each sole that bears (2, 4) [m]


@register_jitable
def _views(block: Matrix) -> SoleRotation:
    """The fields as views of one array (2, 11): to copy and pass it takes a fifth of the time of five."""
    return SoleRotation(block[:, 0:2], block[:, 2:4], block[:, 4:6], block[:, 6], block[:, 7:11])


class FootingState(Struct, frozen=True):
    """Rotation of the soles and the parts that bear."""

    block: Matrix  # a ``SoleRotation``, see ``_views`` (2, 11)
    areas: Matrix  # its rectangles in steps of ``grain`` (2, 4) [m]


class Footing:
    """Determines the rectangle of each sole that has ground under it.

    A sole that bears and turns has its CoP on the edge that it turns over, and nothing under the side that goes down.
    That side is removed, because a CoP commanded there is what turns the sole. A sole whose CoP moves while it turns
    rolls flat and has no edge under it, and one that falls back to its last orientation turns over nothing new. One
    that comes to rest turned has found ground on the other face of the edge, a slope or a lower tile, and is whole
    again; one that came back or went no farther grows again while it lies still. A foot that lifts lands on its whole
    sole.

    References:
        G. Wiedebach et al., Walking on partial footholds including line contacts with the humanoid robot Atlas,
        Humanoids 2016.
    """

    def __init__(self, model: RobotModel, config: FootingConfig) -> None:
        self._whole = np.array([foot.rectangle for foot in model.feet])
        self._constants = unbox(_Soles(self._whole, FootingLimits(*astuple(config))))

    def whole(self, before: FootingState | None = None) -> FootingState:
        """Both soles whole; they keep the CoP of ``before``."""
        block = np.zeros((2, 11))
        soles = _views(block)
        soles.bounds[:] = self._whole
        if before is not None:
            soles.edges[:] = _views(before.block).edges
        return FootingState(block, self._whole)

    def update(
        self, footing: FootingState, measured: Measurement, swinging: int | None, dt: float, *, urgent: bool = False
    ) -> FootingState:
        """One tick; ``swinging`` (None in double support) lands on a whole sole, as do both while ``urgent``."""
        if urgent:
            return self.whole(footing)
        block, areas, foot = footing.block.copy(), np.empty((2, 4)), -1 if swinging is None else swinging
        _update(foot, measured.loads, dt, measured.turning, measured.cops, self._constants, block, areas)
        return FootingState(block, areas)


@register_jitable
def _cut(
    low: float,
    high: float,
    whole_low: float,
    whole_high: float,
    edge: float,
    speed: float,
    angle: float,
    fallen: float,
    limits: FootingLimits,
) -> tuple[float, float]:
    """Remove the side that goes down, except while the sole falls back or the other side is removed."""
    if speed > limits.turning and min(angle, fallen) > limits.turned and high == whole_high:
        low = max(low, min(edge, high - limits.strip))
    elif speed < -limits.turning and max(angle, fallen) < -limits.turned and low == whole_low:
        high = min(high, max(edge, low + limits.strip))
    return low, high


@njit(cache=True)
def _update(
    swinging: int,
    loads: tuple[float, float],
    dt: float,
    turning: Matrix,
    cops: Matrix,
    constants: Unboxed[_Soles],
    block: Matrix,
    areas: Matrix,
) -> None:
    """The rotation of the soles after one tick, in place, and ``areas``; ``swinging`` is -1 in double support."""
    whole, limits = constants.record
    edges, turned, fallen, rested, bounds = _views(block)
    for foot in range(2):
        if foot == swinging:
            for i in range(4):
                bounds[foot, i] = areas[foot, i] = whole[foot, i]
            for about in range(2):
                turned[foot, about] = fallen[foot, about] = 0.0
            rested[foot] = 0.0
            continue
        for about in range(2):
            speed, axis = turning[foot, about], 1 - about
            if abs(cops[foot, axis] - edges[foot, axis]) > limits.edge:
                edges[foot, axis], turned[foot, about] = cops[foot, axis], 0.0
            turned[foot, about] += dt * (speed - turned[foot, about] / limits.forget_time)
            fallen[foot, about] += dt * speed
        if loads[foot] >= limits.load:
            for axis in range(2):
                # About x, turning forwards lifts the left side (high y); about y it lowers the front (high x).
                about, sign = (1, -1.0) if axis == 0 else (0, 1.0)
                low, high = 2 * axis, 2 * axis + 1
                bounds[foot, low], bounds[foot, high] = _cut(
                    bounds[foot, low],
                    bounds[foot, high],
                    whole[foot, low],
                    whole[foot, high],
                    cops[foot, axis],
                    sign * turning[foot, about],
                    sign * turned[foot, about],
                    sign * fallen[foot, about],
                    limits,
                )
            still = max(abs(turning[foot, 0]), abs(turning[foot, 1])) < limits.still
            rested[foot] = rested[foot] + dt if still else 0.0
            for axis in range(2 if still else 0):
                about, low, high = 1 - axis, 2 * axis, 2 * axis + 1
                rests = rested[foot] >= limits.rest
                growth = np.inf if rests and abs(fallen[foot, about]) > limits.fallen else limits.regain * dt
                bounds[foot, low] = max(bounds[foot, low] - growth, whole[foot, low])
                bounds[foot, high] = min(bounds[foot, high] + growth, whole[foot, high])
                if rests and bounds[foot, low] == whole[foot, low] and bounds[foot, high] == whole[foot, high]:
                    fallen[foot, about] = 0.0
        for i in range(4):
            bound = bounds[foot, i]
            areas[foot, i] = bound if bound == whole[foot, i] else np.rint(bound / limits.grain) * limits.grain
