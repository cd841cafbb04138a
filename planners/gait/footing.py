"""Partial contact: the line on which a sole bears while it turns over an edge or over its rim."""

from dataclasses import astuple
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from models.numerics.compiled import njit
from models.numerics.unboxed import Unboxed, unbox
from models.robot_model import RobotModel
from models.types import Matrix, Vector
from planners.gait.config import FootingConfig
from planners.gait.measurement import LOADED, Measurement


class FootingLimits(NamedTuple):
    """Fields of ``FootingConfig`` in their order, for compiled code."""

    tilted: float
    edge: float
    still: float
    rest_time: float
    lie_angle: float
    grain: float


class _Soles(NamedTuple):
    """Constants of ``Footing``."""

    whole: Matrix  # rectangles (2, 4) [m]
    limits: FootingLimits


class FootingState(Struct, frozen=True):
    """Rotation of the soles and their bearing areas; rectangles are x_min, x_max, y_min, y_max in the sole's frame."""

    lines: Matrix  # CoP of each sole, held while it moves less than ``edge``; NaN without load (2, 2) [m]
    turned: Matrix  # rotation of each sole from the ground about its x and y since the last restart (2, 2) [rad]
    areas: Matrix  # bearing rectangles: whole, or without width at the rim or a multiple of ``grain`` (2, 4) [m]

    def lies_flat(self, foot: int) -> bool:
        """Whether a planted sole bears on an area, not on a line."""
        x_min, x_max, y_min, y_max = self.areas[foot].tolist()
        return bool(x_min < x_max and y_min < y_max)


class Footing:
    """Determines the line on which a sole bears that does not lie on the ground.

    A sole that turns while its CoP stays turns about the line through the CoP: an edge of the ground below it, or the
    rim of the sole. Its rotation ``a`` [rad] about an axis of the sole is integrated from its angular velocity ``w``
    [rad/s] about that axis,

        a' = w - a max(1 - |w| / still, 0) / rest_time

    ``a`` restarts at zero when the CoP has moved by ``edge`` from where it was at the last restart or at the first
    load: the sole rolls, or has found other ground. Once ``|a|`` has reached ``tilted``, the sole bears on the line
    through that place alone, until ``|a|`` is below half of it. The whole-body QP then treats it as an edge contact,
    which turns freely, because a CoP commanded beside the line would turn it. ``a`` decays while the sole lies still,
    because the ground below it has another slope than expected. A sole without load is whole; its rotation is
    integrated, and counts about the line of its CoP when it bears again. At a landing, ``a`` is the tilt of the sole
    relative to the expected ground, so a foot that lands on its heel bears on it. In an urgent step, only the rim
    counts: soles then tip although there is ground under them.

    References:
        G. Wiedebach et al., Walking on partial footholds including line contacts with the humanoid robot Atlas,
        Humanoids 2016.
    """

    def __init__(self, model: RobotModel, config: FootingConfig) -> None:
        self._whole = np.array([foot.rectangle for foot in model.feet])
        self._constants = unbox(_Soles(self._whole, FootingLimits(*astuple(config))))

    def whole(self) -> FootingState:
        """State with whole soles."""
        return FootingState(np.full((2, 2), np.nan), np.zeros((2, 2)), self._whole)

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
        """State after one tick; the foot ``swinging`` (None in double support) has a whole sole.

        ``slope`` is the ground slope at landing (2,) [-]. In an ``urgent`` step a sole bears on a line only at its rim.
        """
        lines, turned, areas = footing.lines.copy(), footing.turned.copy(), footing.areas.copy()
        foot = -1 if swinging is None else swinging
        tilt, yaw = measured.tilts[foot] - slope, measured.soles[foot].yaw
        _update(
            foot, measured.loads, dt, measured.turning, measured.cops, tilt, yaw, urgent,
            self._constants, lines, turned, areas,
        )  # fmt: skip
        return FootingState(lines, turned, areas)


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
    lines: Matrix,
    turned: Matrix,
    areas: Matrix,
) -> None:
    """Update ``lines``, ``turned`` and ``areas`` in place by one tick; ``swinging`` is -1 in double support.

    ``tilt`` is the slope of the swing sole relative to the ground, in W (2,) [-].
    """
    whole, limits = constants.record
    for foot in range(2):
        if foot == swinging:
            c, s = np.cos(yaw), np.sin(yaw)  # about x, a sole turns up to its left; about y, down to its front
            turned[foot, 0], turned[foot, 1] = c * tilt[1] - s * tilt[0], -(c * tilt[0] + s * tilt[1])
            lines[foot], areas[foot] = np.nan, whole[foot]
            continue
        for axis in range(2):
            first, last, about = 2 * axis, 2 * axis + 1, 1 - axis
            low, high, speed = whole[foot, first], whole[foot, last], turning[foot, about]
            angle, line = turned[foot, about] + dt * speed, np.nan
            on_line = areas[foot, first] == areas[foot, last]
            areas[foot, first], areas[foot, last] = low, high
            if loads[foot] > LOADED:
                cop, line = min(max(cops[foot, axis], low), high), lines[foot, axis]
                if np.isnan(line):
                    line = cop
                elif abs(cop - line) > limits.edge:
                    angle, line = 0.0, cop
                stillness = max(1.0 - abs(speed) / limits.still, 0.0)
                angle *= 1.0 - min(dt / limits.rest_time, 1.0) * stillness
                if abs(angle) >= (0.5 if on_line else 1.0) * limits.tilted:
                    place = np.rint(line / limits.grain) * limits.grain
                    if line <= low + limits.edge:
                        place = low
                    elif line >= high - limits.edge:
                        place = high
                    if not urgent or place in (low, high):
                        areas[foot, first] = areas[foot, last] = place
            lines[foot, axis], turned[foot, about] = line, angle
