"""Swing-foot trajectory toward a target that may move."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from msgspec import Struct, structs

from models.numerics.compiled import njit
from models.spline import quintic_step
from models.types import Matrix, Vector
from planners.gait.config import SwingConfig

X, Y, Z, YAW = range(4)


class SwingShape(NamedTuple):
    """Fields of ``SwingConfig`` that the reaction of the swing leg depends on."""

    apex: float
    clearance: float
    landing_velocity: float
    freeze: float


class SwingState(Struct, frozen=True):
    """Reference of the swing foot at one tick."""

    motion: Matrix  # position, velocity and acceleration: x, y, z [m] and yaw [rad] in W (3, 4)
    floor: float  # height at lift-off [m]
    duration: float  # from lift-off to the planned touchdown [s]
    tilt: Vector  # slope of the sole: its rise along x and along y of W (2,) [-]
    trips: int = 0  # detected so far
    rising_until: float = 0.0  # time since lift-off until which the foot only rises [s]
    place: tuple[float, float] | None = None  # measured at the last tick, in W [m]; None at lift-off
    speed: tuple[float, float] = (0.0, 0.0)  # measured velocity, filtered [m/s]

    @property
    def position(self) -> Vector:
        """x, y, z [m] and yaw [rad] (4,)."""
        position: Vector = self.motion[0]
        return position

    @property
    def velocity(self) -> Vector:
        """(4,) [m/s, rad/s]."""
        velocity: Vector = self.motion[1]
        return velocity

    def shifted(self, x: float, y: float) -> SwingState:
        """Moved in W [m]."""
        motion = self.motion.copy()
        motion[0, X] += x
        motion[0, Y] += y
        return structs.replace(self, motion=motion)


AT_REST = SwingState(np.zeros((3, 4)), 0.0, 0.0, np.zeros(2))


class SwingFoot:
    """Moves the reference of a foot from lift-off to touchdown.

    Every tick, x, y and yaw follow the quintic from the present reference state to rest at the target in the time left:
    the target and the time may move, and the reference stays smooth to its acceleration. The height goes likewise to
    the clearance at the apex, then to the target with the landing velocity. Later than planned, the foot continues down
    at ``late_velocity``, at most ``depth_max``, and follows its target.

    A foot that stays behind its reference and hardly moves has tripped, over the edge of a tile for instance. The
    harder it is pushed on, the faster friction holds it. Its reference returns to the measured place, and on the way
    up it only rises for ``trip_time``.
    """

    def __init__(self, config: SwingConfig) -> None:
        self._config = config
        self.shape = SwingShape(config.apex, config.clearance, config.landing_velocity, config.freeze)

    def lift(self, pose: Vector, duration: float, tilt: Vector, trips: int = 0) -> SwingState:
        """Start from rest at a pose x, y, z, yaw (4,), for a swing of this duration [s], on a slope (2,) [-]."""
        motion = np.zeros((3, 4))
        motion[0] = pose
        return SwingState(motion, float(pose[Z]), duration, tilt, trips)

    def detect_trip(
        self, swing: SwingState, x: float, y: float, elapsed: float, duration: float, dt: float
    ) -> SwingState:
        """Return to the measured place x, y of the sole in W [m] when the foot has tripped; times in [s]."""
        config, (last_x, last_y) = self._config, swing.place or (x, y)
        share = min(dt / config.trip_filter, 1.0)
        vx, vy = swing.speed
        vx, vy = vx + share * ((x - last_x) / dt - vx), vy + share * ((y - last_y) / dt - vy)
        motion, trips, rising_until = swing.motion, swing.trips, swing.rising_until
        (at_x, at_y, _, _), (ref_vx, ref_vy, _, _), _ = motion.tolist()
        stuck = vx * ref_vx + vy * ref_vy < config.trip_speed * (ref_vx * ref_vx + ref_vy * ref_vy)
        lag = math.hypot(at_x - x, at_y - y)
        if lag >= config.trip_lag and stuck and elapsed >= rising_until:
            trips += 1
            motion = motion.copy()
            motion[0, :2] = x, y
            motion[1:, :2] = 0.0
            if elapsed < config.apex * duration:
                rising_until = elapsed + config.trip_time
        return SwingState(motion, swing.floor, swing.duration, swing.tilt, trips, rising_until, (x, y), (vx, vy))

    def step(
        self, swing: SwingState, target: Vector, slope: Vector, elapsed: float, duration: float, dt: float
    ) -> SwingState:
        """Advance by ``dt`` towards a pose x, y, z, yaw (4,) on a slope (2,); times count from lift-off [s]."""
        config = self._config
        tilt = swing.tilt + min(dt / config.tilt_time, 1.0) * (slope - swing.tilt)
        left = duration - elapsed + dt
        if left < dt:
            motion = self._late(swing.motion, target, dt)
        else:
            rising = elapsed < swing.rising_until
            apex = max(config.apex * duration, swing.rising_until) - (elapsed - dt)
            end, final, height_left = float(target[Z]), -config.landing_velocity, left
            if apex > config.freeze or rising:
                end, final, height_left = max(swing.floor, end) + config.clearance, 0.0, max(apex, config.freeze)
            # A quintic over the last moments would turn every millimetre into a jerk: it is stretched instead.
            steady = max(left, config.freeze)
            motion = _advance(swing.motion, target, rising, steady, end, final, height_left, dt)
        return SwingState(
            motion, swing.floor, duration, tilt, swing.trips, swing.rising_until, swing.place, swing.speed
        )

    def _late(self, motion: Matrix, target: Vector, dt: float) -> Matrix:
        config, position = self._config, motion[0].copy()
        late = np.zeros((3, 4))
        late[1, :2] = (target[:2] - position[:2]) / config.late_time
        position[:2] += dt * late[1, :2]
        if position[Z] > target[Z] - config.depth_max:
            late[1, Z] = -config.late_velocity
            position[Z] += dt * late[1, Z]
        late[0] = position
        return late


@njit(cache=True)
def _advance(
    motion: Matrix,
    target: Vector,
    rising: bool,
    left: float,
    height: float,
    sinking: float,
    height_left: float,
    dt: float,
) -> Matrix:
    """Each coordinate of the motion (3, 4) on its quintic to the target pose (4,), ``left`` [s] ahead.

    While ``rising``, x and y stay. The height reaches ``height`` [m] after ``height_left`` [s], with the vertical
    velocity ``sinking`` [m/s].
    """
    after = motion.copy()
    for i in range(4):
        if rising and i < Z:
            continue
        end = (height, sinking, 0.0) if i == Z else (target[i], 0.0, 0.0)
        time = height_left if i == Z else left
        after[0, i], after[1, i], after[2, i] = quintic_step(motion[0, i], motion[1, i], motion[2, i], end, time, dt)
    return after
