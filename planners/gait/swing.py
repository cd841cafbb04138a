"""Swing-foot trajectory towards a moving target."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from msgspec import Struct, structs

from models.numerics.compiled import njit, register_jitable
from models.numerics.unboxed import Unboxed, unbox
from models.spline import quintic_step
from models.types import Matrix, Vector
from planners.gait.config import SwingConfig
from planners.gait.footsteps import Foothold, Place, Point
from planners.gait.measurement import points_up
from planners.gait.tread import SwingShares, clearance_over, swing_shares

X, Y, Z, YAW = range(4)
_SHARES = (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)  #: Candidate times to pass a corner, as shares of the time left [-]


class Via(NamedTuple):
    """Corner that a swing foot passes, in W."""

    x: float  #: [m]
    y: float  #: [m]
    velocity: Point  #: Velocity at the corner [m/s]
    time: float  #: Time since lift-off [s]

    def shifted(self, x: float, y: float) -> Via:
        """The corner moved in W [m]."""
        return self._replace(x=self.x + x, y=self.y + y)


NO_VIA = Via(0.0, 0.0, (0.0, 0.0), -math.inf)


class SwingShape(NamedTuple):
    """Fields of ``SwingConfig`` that the reaction of the swing leg depends on."""

    apex: float
    landing_velocity: float
    freeze: float
    edge: float
    edge_clearance: float


#: Present swing, for the leg's reaction: motion of the foot, see ``SwingState`` (3, 4), heights of apex and landing
#: [m], ``SwingShares``, time from lift-off to touchdown [s], acceleration at touchdown [m/s^2] and target [m] in W
SwingMotion = tuple[Matrix, Point, tuple[float, float, float], float, Point, Point]


class SwingLimits(NamedTuple):
    """Constants of ``SwingFoot``: the shape, then fields of ``SwingConfig``."""

    shape: SwingShape
    late_velocity: float  # [m/s]
    late_time: float  # [s]
    depth_max: float  # [m]
    tilt_time: float  # [s]
    trip_lag: float  # [m]
    trip_force: float  # [-]


class SwingState(Struct, frozen=True):
    """Reference of the swing foot at one tick."""

    motion: Matrix  # position, velocity and acceleration: x, y, z [m] and yaw [rad] in W (3, 4)
    floor: float  # height at lift-off [m]
    clearance: float  # height of the apex above lift-off or target, whichever is higher [m]
    duration: float  # from lift-off to the planned touchdown [s]
    start: Point  # position at lift-off, in W [m]
    braking: Point  # acceleration at the planned touchdown, along x and y of W [m/s^2]
    tilt: Vector  # slope of the sole: its rise along x and along y of W (2,) [-]
    shares: SwingShares  # times of this swing
    rise: float = 0.0  # known height of the target above that at lift-off [m]
    trips: int = 0  # number of detected trips
    rising_until: float = 0.0  # time since lift-off until which the foot only rises [s]
    edge: float = -math.inf  # height of the foot when it tripped; the edge is at least as high [m]

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

    def towards(self, x: float, y: float) -> SwingMotion:
        """The swing to a target in W [m], for the reaction of the leg."""
        apex, wait, settle = self.shares
        heights = self.floor + max(self.rise, 0.0) + self.clearance, self.floor + self.rise
        return self.motion, heights, (apex, wait, settle), self.duration, self.braking, (x, y)

    def via(self, corner: Point, target: Point, elapsed: float, left: Point, last: Via | None, freeze: float) -> Via:
        """Time and velocity at which the foot passes a corner on its way to a target, both in W (2,) [m].

        ``left`` is the time to the end of the swing, now and in the last plan [s]. The first plan chooses the time of
        least effort. Later plans keep its share of the time left; ``last`` is the result of the last plan. Within twice
        ``freeze`` [s] before the corner, nothing changes.
        """
        if last is not None and last.time - elapsed <= 2.0 * freeze:
            return last
        time, speeds = max(left[0], 1e-3), self.velocity[:2].tolist()
        before = [corner[i] - float(self.motion[0, i]) for i in range(2)]
        ways = list(zip(before, (target[X] - corner[X], target[Y] - corner[Y]), speeds, strict=True))
        if last is None:
            share = min(
                _SHARES, key=lambda share: sum(_effort(*way, time * share, time * (1.0 - share)) for way in ways)
            )
        else:
            share = min(max((last.time - elapsed) / max(left[1], 1e-3), 0.0), 0.9)
        x, y = (_passing_speed(*way, time * share, time * (1.0 - share)) for way in ways)
        return Via(*corner, (x, y), elapsed + time * share)

    def shifted(self, x: float, y: float) -> SwingState:
        """The reference moved in W [m]."""
        motion = self.motion.copy()
        motion[0, X] += x
        motion[0, Y] += y
        return structs.replace(self, motion=motion, start=(self.start[0] + x, self.start[1] + y))


AT_REST = SwingState(np.zeros((3, 4)), 0.0, 0.0, 0.0, (0.0, 0.0), (0.0, 0.0), np.zeros(2), SwingShares(0.5))


class SwingFoot:
    """Generates the reference of a foot from lift-off to touchdown.

    Every tick, x, y and yaw follow the quintic from the present reference state to rest at the target in the time left.
    Target and time may change; the reference is continuous up to its acceleration. The accelerations at both ends along
    x and y are ``effort`` times those of the cubic, which has the least mean square acceleration and so the least load
    on the hip; at 0 the path has the least jerk. The height follows quintics to the clearance at the apex and to the
    target with the landing velocity. A late foot follows its target and descends at ``late_velocity``, at most
    ``depth_max`` below it. On the way around the stance leg, x and y first pass a corner, ``via``. On the way to a
    foothold of another known height, the foot passes over the edge in between, see ``swing_shares``.

    A foot ``trip_lag`` away from its reference has tripped, for example over the edge of a tile, if a force of at least
    ``trip_force`` of the weight, more horizontal than vertical, pushes it away from the reference. Otherwise it only
    lags. Pushing harder would increase the friction that holds the foot. The reference therefore moves back, to
    ``trip_back`` beyond the measured position, and before the planned touchdown it only rises for ``trip_time``.
    """

    def __init__(self, config: SwingConfig) -> None:
        self.shape = SwingShape(**{name: getattr(config, name) for name in SwingShape._fields})
        others = (getattr(config, name) for name in SwingLimits._fields[1:])
        self._limits = unbox(SwingLimits(self.shape, *others))
        self._trip_time, self._trip_back = config.trip_time, config.trip_back

    def lift(
        self,
        pose: Vector,
        clearance: float,
        duration: float,
        tilt: Vector,
        trips: int = 0,
        target: Point | None = None,
        effort: float = 0.0,
        rise: float = 0.0,
        over: float = 0.0,
    ) -> SwingState:
        """Start a swing of this height [m] and duration [s] at rest, from a pose x, y, z, yaw (4,) on a slope (2,) [-].

        ``target`` is the planned end in W [m], on a path of this ``effort``, see ``SwingFoot``. Without a target, the
        foot starts without acceleration. The target is higher than the pose by ``rise`` [m]; an obstacle on the way is
        higher than the higher end by ``over`` [m].
        """
        motion, start = np.zeros((3, 4)), (float(pose[X]), float(pose[Y]))
        motion[0] = pose
        way = 0.0 if target is None else math.dist(start, target)
        shape = self.shape
        clearance = clearance_over(rise, clearance, shape.edge_clearance, over)
        early = shape.freeze / duration
        shares = SwingShares(*swing_shares(rise, clearance, way, shape.apex, shape.edge, early, over))
        braking = (0.0, 0.0) if target is None else _braking(start, target, shares.moving * duration, effort)
        if shares.wait == 0.0:
            motion[2, :Z] -= braking
        return SwingState(motion, float(pose[Z]), clearance, duration, start, braking, tilt, shares, rise, trips)

    def detect_trip(
        self, swing: SwingState, sole: Foothold, force: Vector, elapsed: float, duration: float
    ) -> SwingState:
        """Detect a trip, and move the reference back from the measured place of the sole; times in [s].

        ``force`` is the force of the ground on the sole in W, as a share of the weight (3,) [-].
        """
        if elapsed < min(swing.rising_until, duration) or not _is_caught(self._limits, swing.motion, sole.place, force):
            return swing
        motion, until = swing.motion.copy(), swing.rising_until
        away = np.array([sole.x, sole.y]) - motion[0, :Z]
        motion[0, :Z] += (1.0 + self._trip_back / math.hypot(*away)) * away
        motion[1:, :Z] = 0.0
        if elapsed < duration:
            until = elapsed + self._trip_time
        return structs.replace(swing, motion=motion, trips=swing.trips + 1, rising_until=until, edge=sole.z)

    def step(
        self,
        swing: SwingState,
        target: Vector,
        slope: Vector,
        elapsed: float,
        duration: float,
        dt: float,
        via: Via | None = None,
        effort: float = 0.0,
        target_velocity: Point = (0.0, 0.0),
    ) -> SwingState:
        """Advance by ``dt`` towards a pose x, y, z, yaw (4,) on a slope (2,); times count from lift-off [s].

        ``effort`` is the share of the path of least effort [-], see ``SwingFoot``. ``target_velocity`` is the velocity
        of the target of a late foot in W [m/s].
        """
        motion, tilt, rising_until = swing.motion.copy(), swing.tilt.copy(), swing.rising_until
        heights = swing.floor, swing.clearance
        limits, passing = self._limits, via or NO_VIA
        braking = _braking(swing.start, target.tolist(), swing.shares.moving * duration, effort)
        times, shares = (elapsed, duration, dt), swing.shares
        _advance(
            limits, motion, tilt, braking, target, target_velocity, slope, heights, rising_until, passing, times, shares
        )
        return structs.replace(swing, motion=motion, duration=duration, tilt=tilt, braking=braking)


@register_jitable
def end_acceleration(way: float, duration: float, effort: float) -> float:
    """Acceleration at the end of a swing over a way [m/s^2], opposite to that at its start; see ``SwingFoot``."""
    return -6.0 * effort * way / (duration * duration)


def _passing_speed(before: float, after: float, speed: float, first: float, last: float) -> float:
    """Passing speed of the cubic spline over two ways in two times, from a start speed to rest [m/s].

    Limited so that the first way does not begin backwards for a run-up.
    """
    passing = (1.5 * (before / first**2 + after / last**2) - 0.5 * speed / first) / (1.0 / first + 1.0 / last)
    most = 3.0 * before / first - 2.0 * speed
    return min(max(passing, min(most, 0.0)), max(most, 0.0))


def _effort(before: float, after: float, speed: float, first: float, last: float) -> float:
    """A quarter of the integral of the squared acceleration of that spline [m^2/s^3]."""
    passing = _passing_speed(before, after, speed, first, last)
    return sum(
        3.0 * way * (way - time * (start + end)) / time**3 + (start**2 + start * end + end**2) / time
        for way, time, start, end in ((before, first, speed, passing), (after, last, passing, 0.0))
    )


def _braking(start: Point, target: Sequence[float], duration: float, effort: float) -> Point:
    x, y = (end_acceleration(target[i] - start[i], duration, effort) for i in range(2))
    return x, y


@njit(cache=True)
def _is_caught(constants: Unboxed[SwingLimits], motion: Matrix, place: Place, force: Vector) -> bool:
    """Whether a foot at a measured ``Place`` is pushed away from its reference motion (3, 4), see ``SwingFoot``."""
    limits = constants.record
    x, y = place[0] - motion[0, X], place[1] - motion[0, Y]
    lag, push = math.hypot(x, y), force[0] * x + force[1] * y
    return bool(lag >= limits.trip_lag and push >= limits.trip_force * lag and not points_up(force))


@njit(cache=True)
def _advance(
    constants: Unboxed[SwingLimits],
    motion: Matrix,
    tilt: Vector,
    braking: Point,
    target: Vector,
    target_velocity: Point,
    slope: Vector,
    heights: Point,
    rising_until: float,
    via: Via,
    times: tuple[float, float, float],
    shares: SwingShares,
) -> None:
    """One tick of the motion (3, 4) and the slope (2,) of the sole, see ``SwingFoot.step``.

    ``heights`` are the height at lift-off in W and the clearance of the apex [m]. ``times`` are the time since
    lift-off, the duration of the swing, and the tick [s].
    """
    limits, (floor, clearance), (elapsed, duration, dt) = constants.record, heights, times
    shape, share, (top, wait, settle) = limits.shape, min(dt / limits.tilt_time, 1.0), shares
    for i in range(2):
        tilt[i] += share * (slope[i] - tilt[i])
    left = duration - elapsed + dt
    if left < dt:
        for i in range(2):
            rate = (target[i] - motion[0, i]) / limits.late_time + target_velocity[i]
            motion[0, i], motion[1, i] = motion[0, i] + dt * rate, rate
        sinking = motion[0, Z] > target[Z] - limits.depth_max
        motion[1, Z], motion[1, YAW] = -limits.late_velocity if sinking else 0.0, 0.0
        motion[0, Z] += dt * motion[1, Z]
        motion[2] = 0.0
        return
    rising = elapsed < rising_until
    apex = max(top * duration, rising_until) - (elapsed - dt)
    height, sink, height_left = target[Z], -shape.landing_velocity, left
    if apex > shape.freeze or rising:
        height, sink, height_left = max(floor, height) + clearance, 0.0, max(apex, shape.freeze)
    # The quintic is stretched at its end: over a very short time every millimetre would cause a large jerk.
    steady, waits = max(left, shape.freeze), elapsed < wait * duration
    over = max(left - settle * duration, shape.freeze)
    corner, passing = (via.x, via.y), via.time - elapsed + dt
    for i in range(4):
        if rising and i < Z:
            continue
        if waits and i < Z:
            motion[1, i], motion[2, i] = 0.0, -braking[i] if elapsed + dt >= wait * duration else 0.0
            continue
        end, time = (target[i], 0.0, 0.0), steady
        if i < Z:
            end, time = (target[i], 0.0, braking[i] if left > settle * duration else 0.0), over
        if i == Z:
            end, time = (height, sink, 0.0), height_left
        elif i < Z and passing > 0.0:
            beyond = max(shape.freeze - passing, 0.0)
            end, time = (corner[i] + beyond * via.velocity[i], via.velocity[i], 0.0), passing + beyond
        motion[0, i], motion[1, i], motion[2, i] = quintic_step(motion[0, i], motion[1, i], motion[2, i], end, time, dt)
