"""Swing-foot trajectory toward a target that may move."""

from __future__ import annotations

import numpy as np

from models.types import Vector
from planners.gait.config import SwingConfig

X, Y, Z, YAW = range(4)


def quintic_step(
    position: float, velocity: float, acceleration: float, end: tuple[float, float, float], left: float, dt: float
) -> tuple[float, float, float]:
    """State after ``dt`` on the quintic from a present state to an end state ``left`` seconds ahead.

    Args:
        position: Present position.
        velocity: Present velocity.
        acceleration: Present acceleration.
        end: Position, velocity and acceleration at the end.
        left: Time to the end [s]; at least ``dt``.
        dt: Step [s].

    Returns:
        Position, velocity, acceleration.
    """
    h = left
    dp = end[0] - position - velocity * h - 0.5 * acceleration * h * h
    dv = end[1] - velocity - acceleration * h
    da = end[2] - acceleration
    c3 = (10.0 * dp - 4.0 * dv * h + 0.5 * da * h * h) / h**3
    c4 = (-15.0 * dp + 7.0 * dv * h - da * h * h) / h**4
    c5 = (6.0 * dp - 3.0 * dv * h + 0.5 * da * h * h) / h**5
    t = dt
    return (
        position + t * (velocity + t * (0.5 * acceleration + t * (c3 + t * (c4 + t * c5)))),
        velocity + t * (acceleration + t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5))),
        acceleration + t * (6.0 * c3 + t * (12.0 * c4 + t * 20.0 * c5)),
    )


class SwingFoot:
    """Reference of a foot from lift-off to touchdown.

    Every tick, x, y and yaw follow the quintic from the present reference state to rest at the target in the time that
    is left: the target and the time may move, and the reference stays smooth to its acceleration. The height goes
    likewise to the clearance at the apex, then to the target with the landing velocity. Later than planned, the foot
    goes on down at that velocity, at most ``depth_max``.

    Args:
        config: Clearance and landing.

    Attributes:
        position: x, y, z [m] and yaw [rad] (4,).
        velocity: (4,).
        acceleration: (4,).
        floor: Height that it lifted from [m].
        duration: Of the swing, from lift-off to the planned touchdown [s].
        clearance, apex, landing_velocity, freeze: As configured.
    """

    def __init__(self, config: SwingConfig) -> None:
        self._config = config
        self.clearance, self.apex = config.clearance, config.apex
        self.landing_velocity, self.freeze = config.landing_velocity, config.freeze
        self.position = np.zeros(4)
        self.velocity = np.zeros(4)
        self.acceleration = np.zeros(4)
        self.floor, self.duration = 0.0, 0.0

    def lift(self, pose: Vector, duration: float) -> None:
        """Start from rest at a pose x, y, z, yaw (4,), for a swing of this duration [s]."""
        self.position[:] = pose
        self.velocity[:] = 0.0
        self.acceleration[:] = 0.0
        self.floor, self.duration = float(pose[Z]), duration

    def step(self, target: Vector, elapsed: float, duration: float, dt: float) -> None:
        """Advance.

        Args:
            target: Pose to land on: x, y, z [m], yaw [rad] (4,).
            elapsed: Time since lift-off at the end of this step [s].
            duration: Planned time from lift-off to touchdown [s].
            dt: Step [s].
        """
        config = self._config
        self.duration = duration
        left = duration - elapsed + dt
        if left < dt:
            self._late(target, dt)
            return
        # A quintic over the last moments would turn every millimetre into a jerk: it is stretched instead.
        steady = max(left, config.freeze)
        for i in (X, Y, YAW):
            self._advance(i, (float(target[i]), 0.0, 0.0), steady, dt)
        apex = config.apex * duration - (elapsed - dt)
        if apex > config.freeze:
            height = max(self.floor, float(target[Z])) + config.clearance
            self._advance(Z, (height, 0.0, 0.0), apex, dt)
        else:
            self._advance(Z, (float(target[Z]), -config.landing_velocity, 0.0), max(left, dt), dt)

    def _advance(self, i: int, end: tuple[float, float, float], left: float, dt: float) -> None:
        self.position[i], self.velocity[i], self.acceleration[i] = quintic_step(
            float(self.position[i]), float(self.velocity[i]), float(self.acceleration[i]), end, left, dt
        )

    def _late(self, target: Vector, dt: float) -> None:
        config = self._config
        self.acceleration[:] = 0.0
        self.velocity[:] = 0.0
        if self.position[Z] > target[Z] - config.depth_max:
            self.velocity[Z] = -max(config.landing_velocity, 0.05)
            self.position[Z] += dt * self.velocity[Z]
