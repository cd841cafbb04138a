"""Which part of each planted sole bears: one that turns over an edge has ground under one side of it only."""

from __future__ import annotations

from dataclasses import astuple

import numpy as np

from models.compiled import njit
from models.robot_model import RobotModel
from models.types import Matrix, Vector
from planners.gait.config import FootingConfig
from planners.gait.measurement import GaitMeasurement

# Fields of FootingConfig.
_LOAD, _TURNING, _TURNED, _FORGET_TIME, _EDGE, _STILL, _REST, _FALLEN, _REGAIN, _STRIP, _GRAIN = range(11)


class Footing:
    """Rectangle of each sole that has ground under it.

    A sole that bears and turns has its CoP on the edge that it turns over, and nothing under the side that goes down:
    that side is taken off, so that no law asks for a CoP on it, which is what turns the sole. A sole whose CoP wanders
    while it turns lies down and has no edge under it, and one that falls back to how it lay turns over nothing new. One
    that comes to rest turned has found ground on the other face of the edge, a slope or a lower tile, and is whole
    again; one that came back or went no farther grows again while it lies still. The whole one is believed in when the
    foot lifts.

    Args:
        model: The robot: its soles.
        config: When a sole counts as turning.

    Attributes:
        areas: x_min, x_max, y_min, y_max of each sole, in its frame (2, 4) [m].

    References:
        G. Wiedebach et al., Walking on partial footholds including line contacts with the humanoid robot Atlas,
        Humanoids 2016.
    """

    def __init__(self, model: RobotModel, config: FootingConfig) -> None:
        self._limits = np.array(astuple(config))
        self._whole = np.array([foot.rectangle for foot in model.feet])
        self.areas, self._bounds = self._whole.copy(), self._whole.copy()
        self._turned, self._fallen, self._edges = np.zeros((3, 2, 2))
        self._rested = np.zeros(2)

    def reset(self) -> None:
        """Count on both whole soles."""
        for foot in range(2):
            self._believe(foot)

    def update(self, measured: GaitMeasurement, swinging: int | None, dt: float, *, hurried: bool = False) -> Matrix:
        """One tick.

        Args:
            measured: Loads, centres of pressure and angular velocities of the soles.
            swinging: The foot in the air, which will land on its whole sole; None for none.
            dt: Time since the last tick [s].
            hurried: Whether a push is being caught, in which soles tip that have ground under them.

        Returns:
            ``areas``; the next call overwrites it.
        """
        for foot in range(2):
            if foot == swinging or hurried:
                self._believe(foot)
            else:
                self._look(foot, measured, dt)
        return self.areas

    def _believe(self, foot: int) -> None:
        self._bounds[foot] = self.areas[foot] = self._whole[foot]
        self._turned[foot] = self._fallen[foot] = self._rested[foot] = 0.0

    def _look(self, foot: int, measured: GaitMeasurement, dt: float) -> None:
        """One planted sole."""
        turning, cops, load = measured.turning, measured.cops, measured.loads[foot]
        seen = (self._edges, self._turned, self._fallen, self._rested)
        _look(foot, load, dt, turning, cops, self._whole, self._limits, *seen, self._bounds, self.areas)


@njit(
    "UniTuple(float64, 2)(float64, float64, float64, float64, float64, float64, float64, float64, float64[::1])",
    cache=True,
)
def _cut(
    low: float,
    high: float,
    whole_low: float,
    whole_high: float,
    edge: float,
    speed: float,
    angle: float,
    fallen: float,
    limits: Vector,
) -> tuple[float, float]:
    """Take off the side that goes down: that of low coordinates where the speed is positive.

    Not where the sole falls back to how it last lay, nor while the other side is off.
    """
    turning, turned, strip = limits[_TURNING], limits[_TURNED], limits[_STRIP]
    if speed > turning and min(angle, fallen) > turned and high == whole_high:
        low = max(low, min(edge, high - strip))
    elif speed < -turning and max(angle, fallen) < -turned and low == whole_low:
        high = min(high, max(edge, low + strip))
    return low, high


@njit(
    "void(int64, float64, float64, float64[:, ::1], float64[:, ::1], float64[:, ::1], float64[::1],"
    " float64[:, ::1], float64[:, ::1], float64[:, ::1], float64[::1], float64[:, ::1], float64[:, ::1])",
    cache=True,
)
def _look(
    foot: int,
    load: float,
    dt: float,
    turning: Matrix,
    cops: Matrix,
    whole: Matrix,
    limits: Vector,
    edges: Matrix,
    turned: Matrix,
    fallen: Matrix,
    rested: Vector,
    bounds: Matrix,
    areas: Matrix,
) -> None:
    """One planted sole; rectangles are x_min, x_max, y_min, y_max of each sole (2, 4) [m].

    Args:
        foot: Which one.
        load: Share of the weight that it bears [-].
        dt: Time since the last tick [s].
        turning: Angular velocity of each sole about its own x and y (2, 2) [rad/s].
        cops: Centre of pressure of each sole, in its frame (2, 2) [m].
        whole: The whole soles.
        limits: Of ``FootingConfig``, in the order of its fields (11,).
        edges: In and out: where the CoP rests, in x and y (2, 2) [m].
        turned: In and out: by how much each sole has turned of late, its CoP at these (2, 2) [rad].
        fallen: In and out: by how much it has turned in all since it last lay still, whole (2, 2) [rad].
        rested: In and out: time for which it has lain still (2,) [s].
        bounds: In and out: what bears.
        areas: Out: what bears, in steps of ``grain``.
    """
    for about in range(2):
        speed, axis = turning[foot, about], 1 - about
        if abs(cops[foot, axis] - edges[foot, axis]) > limits[_EDGE]:
            edges[foot, axis], turned[foot, about] = cops[foot, axis], 0.0
        turned[foot, about] += dt * (speed - turned[foot, about] / limits[_FORGET_TIME])
        fallen[foot, about] += dt * speed
    if load < limits[_LOAD]:
        return
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
    still = max(abs(turning[foot, 0]), abs(turning[foot, 1])) < limits[_STILL]
    rested[foot] = rested[foot] + dt if still else 0.0
    if still:
        for axis in range(2):
            about = 1 - axis
            low, high = 2 * axis, 2 * axis + 1
            lies = rested[foot] >= limits[_REST]
            way = np.inf if lies and abs(fallen[foot, about]) > limits[_FALLEN] else limits[_REGAIN] * dt
            bounds[foot, low] = max(bounds[foot, low] - way, whole[foot, low])
            bounds[foot, high] = min(bounds[foot, high] + way, whole[foot, high])
            if lies and bounds[foot, low] == whole[foot, low] and bounds[foot, high] == whole[foot, high]:
                fallen[foot, about] = 0.0
    for i in range(4):
        bound = bounds[foot, i]
        areas[foot, i] = bound if bound == whole[foot, i] else np.rint(bound / limits[_GRAIN]) * limits[_GRAIN]
