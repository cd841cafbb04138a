"""Which part of each planted sole bears: one that turns over an edge has ground under one side of it only."""

from __future__ import annotations

import numpy as np

from models.robot_model import RobotModel
from models.types import Matrix, Vector
from planners.gait.config import FootingConfig
from planners.gait.measurement import GaitMeasurement

GRAIN = 0.002
"""Areas are told in steps of this: each change costs the QP a new wrench cone [m]."""


class Footing:
    """Rectangle of each sole that has ground under it.

    A sole that bears and turns has its CoP on the edge that it turns over, and nothing under the side that goes down:
    that side is taken off, so that no law asks for a CoP on it, which is what turns the sole. While the sole lies still
    the area grows again, and the whole one is believed in when the foot lifts.

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
        self._config = config
        self._whole = np.array([foot.rectangle for foot in model.feet])
        self.areas, self._bounds = self._whole.copy(), self._whole.copy()
        self._turned = np.zeros((2, 2))

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
        self._turned[foot] = 0.0

    def _look(self, foot: int, measured: GaitMeasurement, dt: float) -> None:
        """One planted sole."""
        config, bounds = self._config, self._bounds[foot]
        turning = measured.turning[foot]
        self._turned[foot] += dt * (turning - self._turned[foot] / config.forget_time)
        if measured.loads[foot] < config.load:
            return
        for axis in range(2):
            # About x, turning forwards lifts the left side (high y); about y it lowers the front (high x).
            about, sign = (1, -1.0) if axis == 0 else (0, 1.0)
            speed, angle = sign * float(turning[about]), sign * float(self._turned[foot, about])
            span, whole = slice(2 * axis, 2 * axis + 2), self._whole[foot]
            self._cut(bounds[span], whole[span], float(measured.cops[foot, axis]), speed, angle)
        whole = self._whole[foot]
        if float(np.abs(turning).max()) < config.still:
            way = config.regain * dt
            bounds[::2] = np.maximum(bounds[::2] - way, whole[::2])
            bounds[1::2] = np.minimum(bounds[1::2] + way, whole[1::2])
        self.areas[foot] = np.where(bounds == whole, whole, np.round(bounds / GRAIN) * GRAIN)

    def _cut(self, span: Vector, whole: Vector, edge: float, speed: float, angle: float) -> None:
        """Take off the side that goes down: that of low coordinates where the speed is positive.

        Not while the other side is off: the sole then falls back to what bears.
        """
        config = self._config
        if speed > config.turning and angle > config.turned and span[1] == whole[1]:
            span[0] = max(span[0], min(edge, span[1] - config.strip))
        elif speed < -config.turning and angle < -config.turned and span[0] == whole[0]:
            span[1] = min(span[1], max(edge, span[0] + config.strip))
