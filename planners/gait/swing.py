"""Swing-foot trajectory toward a target that may move."""

from __future__ import annotations

import math

import numpy as np

from models.compiled import njit
from models.spline import quintic_step
from models.types import Matrix, Vector
from planners.gait.config import SwingConfig

X, Y, Z, YAW = range(4)


class SwingFoot:
    """Reference of a foot from lift-off to touchdown.

    Every tick, x, y and yaw follow the quintic from the present reference state to rest at the target in the time that
    is left: the target and the time may move, and the reference stays smooth to its acceleration. The height goes
    likewise to the clearance at the apex, then to the target with the landing velocity. Later than planned, the foot
    goes on down at ``late_velocity``, at most ``depth_max``, and follows its target.

    A foot that stays behind its reference and hardly moves has been caught, by the edge of a tile for instance: the
    harder it were pushed on, the faster friction would hold it. Its reference returns to where it is, and on the way up
    it only rises for ``trip_time``.

    Args:
        config: Clearance and landing.

    Attributes:
        position: x, y, z [m] and yaw [rad] (4,).
        velocity: (4,).
        acceleration: (4,).
        motion: These three, of which they are the rows (3, 4).
        floor: Height that it lifted from [m].
        duration: Of the swing, from lift-off to the planned touchdown [s].
        apex, freeze: As configured.
        shape: Apex, clearance and landing velocity, as configured (3,).
        tilt: Slope of the sole: its rise along x and along y of W (2,) [-].
        trips: How often a foot was caught so far.
    """

    def __init__(self, config: SwingConfig) -> None:
        self._config = config
        self.apex, self.freeze = config.apex, config.freeze
        self.shape = np.array([config.apex, config.clearance, config.landing_velocity])
        self.motion = np.zeros((3, 4))
        self.position, self.velocity, self.acceleration = self.motion
        self.floor, self.duration = 0.0, 0.0
        self.tilt = np.zeros(2)
        self.trips = 0
        self._rising_until = 0.0
        self._place: tuple[float, float] | None = None  # measured, in W [m]
        self._speed = (0.0, 0.0)  # [m/s]

    def lift(self, pose: Vector, duration: float, tilt: Vector) -> None:
        """Start from rest at a pose x, y, z, yaw (4,), for a swing of this duration [s], on a slope (2,) [-]."""
        self.position[:] = pose
        self.velocity[:] = 0.0
        self.acceleration[:] = 0.0
        self.floor, self.duration = float(pose[Z]), duration
        self.tilt[:] = tilt
        self._rising_until = 0.0
        self._place, self._speed = None, (0.0, 0.0)

    def heed(self, x: float, y: float, elapsed: float, duration: float, dt: float) -> None:
        """Compare with where the foot is measured, in W [m], and give way if it has been caught.

        Args:
            x: Of the sole.
            y: Of the sole.
            elapsed: Time since lift-off [s].
            duration: Planned time from lift-off to touchdown [s].
            dt: Time since the last call of this swing [s].
        """
        config, (last_x, last_y) = self._config, self._place or (x, y)
        self._place, share = (x, y), min(dt / config.trip_filter, 1.0)
        vx, vy = self._speed
        vx, vy = vx + share * ((x - last_x) / dt - vx), vy + share * ((y - last_y) / dt - vy)
        self._speed = vx, vy
        (at_x, at_y, _, _), (wanted_x, wanted_y, _, _), _ = self.motion.tolist()
        stuck = vx * wanted_x + vy * wanted_y < config.trip_speed * (wanted_x * wanted_x + wanted_y * wanted_y)
        lag = math.hypot(at_x - x, at_y - y)
        if lag < config.trip_lag or not stuck or elapsed < self._rising_until:
            return
        self.trips += 1
        self.position[:2] = x, y
        self.velocity[:2] = 0.0
        self.acceleration[:2] = 0.0
        if elapsed < config.apex * duration:
            self._rising_until = elapsed + config.trip_time

    def step(self, target: Vector, slope: Vector, elapsed: float, duration: float, dt: float) -> None:
        """Advance.

        Args:
            target: Pose to land on: x, y, z [m], yaw [rad] (4,).
            slope: Of the ground expected there (2,) [-].
            elapsed: Time since lift-off at the end of this step [s].
            duration: Planned time from lift-off to touchdown [s].
            dt: Step [s].
        """
        config = self._config
        self.duration = duration
        self.tilt += min(dt / config.tilt_time, 1.0) * (slope - self.tilt)
        left = duration - elapsed + dt
        if left < dt:
            self._late(target, dt)
            return
        rising = elapsed < self._rising_until
        apex = max(config.apex * duration, self._rising_until) - (elapsed - dt)
        end, final, height_left = float(target[Z]), -config.landing_velocity, left
        if apex > config.freeze or rising:
            end, final, height_left = max(self.floor, end) + config.clearance, 0.0, max(apex, config.freeze)
        # A quintic over the last moments would turn every millimetre into a jerk: it is stretched instead.
        steady = max(left, config.freeze)
        _advance(self.motion, target, rising, steady, end, final, height_left, dt)

    def _late(self, target: Vector, dt: float) -> None:
        config = self._config
        self.acceleration[:] = 0.0
        self.velocity[:] = 0.0
        for i in (X, Y):
            self.velocity[i] = (target[i] - self.position[i]) / config.late_time
            self.position[i] += dt * self.velocity[i]
        if self.position[Z] > target[Z] - config.depth_max:
            self.velocity[Z] = -config.late_velocity
            self.position[Z] += dt * self.velocity[Z]


@njit(
    "void(float64[:, ::1], float64[::1], boolean, float64, float64, float64, float64, float64)",
    cache=True,
)
def _advance(
    motion: Matrix,
    target: Vector,
    rising: bool,
    left: float,
    height: float,
    sinking: float,
    height_left: float,
    dt: float,
) -> None:
    """Each coordinate on its quintic.

    Args:
        motion: In and out: position, velocity and acceleration (3, 4).
        target: Pose to land on (4,).
        rising: Whether x and y stay as they are.
        left: Time to the target [s].
        height: That the foot goes to [m].
        sinking: Its vertical velocity there [m/s].
        height_left: Time to there [s].
        dt: Step [s].
    """
    for i in range(4):
        if rising and i < Z:
            continue
        end = (height, sinking, 0.0) if i == Z else (target[i], 0.0, 0.0)
        time = height_left if i == Z else left
        motion[0, i], motion[1, i], motion[2, i] = quintic_step(motion[0, i], motion[1, i], motion[2, i], end, time, dt)
