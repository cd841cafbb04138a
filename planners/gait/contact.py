"""Contact of the soles: planted footholds, expected ground, and detection of a robot off the floor."""

import math
from statistics import median
from typing import NamedTuple

import numpy as np
from msgspec import Struct, structs

from models.numerics.compiled import njit
from models.numerics.unboxed import Unboxed, unbox
from models.robot_model import RobotModel
from models.types import Matrix, Vector
from planners.gait.config import GaitConfig, LiftConfig
from planners.gait.footsteps import (
    Feet,
    Foothold,
    Place,
    Point,
    Pose,
    common_motion,
    mean_heading,
    middle,
    point_at,
    relative_to,
    replaced,
    wrap,
)
from planners.gait.measurement import Measurement
from planners.gait.route import Footstep

Extents = tuple[float, float, float]  #: Extents of the hull of both soles along the normals of its edges [m]


class AnchorLimits(NamedTuple):
    """Parameters with which planted soles follow the measured ones."""

    load: float  # least share of the weight on a sole that is followed [-]
    time: float  # time constant of its place and slope [s]
    settle_time: float  # time constant of its slope after its landing [s]


class SoleState(Struct, frozen=True):
    """Planted soles, and the ground expected at the next landing."""

    holds: Feet  # planned pose of each sole, or the target of the swing foot
    tilts: Matrix  # slope of the ground under each planted sole: rise along x and along y of W (2, 2) [-]
    slope: Vector  # expected at the next landing (2,) [-]
    samples: Matrix  # slopes of the last soles in single support, oldest first (n, 2) [-]
    measured: Feet  # soles of the last tick
    levels: Point = (0.0, 0.0)  # known ground height under each foot [m]; on unknown ground, that of the stance foot
    roughness: float = 0.0  # height by which the ground differs from the expected one [m]
    landing: Footstep | None = None  # footstep of the foot in the air, if its height is known; same zero as ``levels``

    def ground(self) -> float:
        """Mean height of the footholds [m]."""
        return 0.5 * (self.holds[0].z + self.holds[1].z)

    def landing_level(self, foot: int) -> float:
        """Known height of the ground at the landing of a foot [m]."""
        return self.levels[1 - foot] if self.landing is None else self.landing.hold.z


class Soles:
    """Geometry of the soles, and update of footholds and ground from the measurement.

    ``centres`` are the centres of the soles, ``half`` their half sizes and ``points`` the ZMP points of single support,
    each in the frames of the soles (2, 2) [m].
    """

    def __init__(self, model: RobotModel, config: GaitConfig) -> None:
        self._config = config
        rectangles = [foot.bearing for foot in model.feet]
        self.centres = np.array([(0.5 * (r[0] + r[1]), 0.5 * (r[2] + r[3])) for r in rectangles])
        self.half = np.array([(0.5 * (r[1] - r[0]), 0.5 * (r[3] - r[2])) for r in rectangles])
        self.points = config.zmp * self.centres  # the frame of a sole is under its ankle
        self._points: list[Point] = [(x, y) for x, y in self.points.tolist()]
        self._anchor = unbox(AnchorLimits(config.anchor_load, config.anchor_time, config.ground.settle_time))

    def point_of(self, foot: int, hold: Foothold) -> Vector:
        """ZMP point of a foot on a foothold, in W (2,) [m]."""
        return np.array(hold.moved(*self._points[foot]))

    def stance_point(self, soles: SoleState, stance: int) -> Vector:
        """ZMP point of the stance foot (2,) [m]."""
        return self.point_of(stance, soles.holds[stance])

    def middle(self, holds: Feet) -> Vector:
        """Midpoint between the centres of both soles (2,) [m]."""
        left, right = (hold.moved(*centre) for hold, centre in zip(holds, self.centres.tolist(), strict=True))
        return np.array((0.5 * (left[0] + right[0]), 0.5 * (left[1] + right[1])))

    def nearest(self, holds: Feet, dcm: Vector) -> int:
        """Foot whose ZMP point is nearer to a DCM (2,) [m]."""
        left, right = (float(np.linalg.norm(dcm - self.point_of(foot, holds[foot]))) for foot in range(2))
        return 0 if left < right else 1

    def standing_support(self, holds: Feet, dcm: Vector) -> tuple[Extents, Extents]:
        """Distance of a DCM from the middle of the hull of both soles along its normals, and half its extents [m].

        Both soles are assumed to have their mean heading. The hull then has three pairs of edges: along that heading,
        across it, and along the line from foot to foot.
        """
        places, half = _standing_support(holds[0].pose, holds[1].pose, dcm, self.centres, self.half)
        return places, half

    def beyond_standing(self, holds: Feet, dcm: Vector) -> bool:
        """Whether a DCM (2,) is too close to the edge of the hull of both soles to recover without a step."""
        share, (places, half) = self._config.step_share, self.standing_support(holds, dcm)
        return any(place > share * extent for place, extent in zip(places, half, strict=True))

    def astride(self, holds: Feet, allowed: float) -> bool:
        """Whether a sole is more than ``allowed`` [m] from its place in the nominal stance."""
        left, right = holds
        forward, side = Foothold(right.x, right.y, middle(holds).yaw).relative(left.x, left.y)
        return math.hypot(forward, side - self._config.reach.width) > allowed

    def shares(self, holds: Feet, zmp: Vector) -> tuple[float, float]:
        """Share of the weight on each foot for a ZMP (2,) [m] between their ZMP points."""
        left, right = self.point_of(0, holds[0]), self.point_of(1, holds[1])
        way = right - left
        share = min(max(float((zmp - left) @ way / (way @ way)), 0.0), 1.0)
        return 1.0 - share, share

    def planted(self, measured: Measurement) -> SoleState:
        """State with both feet planted at their measured places."""
        slope = measured.tilts.mean(axis=0)
        samples = np.tile(slope, (self._config.ground.slope_steps, 1))
        return SoleState(measured.soles, measured.tilts, slope, samples, measured.soles)

    def landing_height(self, soles: SoleState, foot: int, measured: Measurement) -> float:
        """Expected landing height of a foot on its foothold [m].

        It is on the plane of the expected slope through the stance sole, or on the known ground.
        """
        return _ground(soles, foot, soles.holds[foot], measured)

    def expected_slope(self, soles: SoleState) -> Vector:
        """Slope of the ground at the landing of the foot in the air (2,) [-]."""
        known = None if soles.landing is None else soles.landing.tread
        return soles.slope if known is None else np.array(known.slope)

    def landed(self, soles: SoleState, foot: int, measured: Measurement, *, flat: bool = True) -> SoleState:
        """State after the touchdown of a foot, at its measured place.

        The share ``drift_share`` of the error of a known height is attributed to drift of the estimate, which shifts
        all following heights; the rest is an error of this foothold only. If all of it were drift, the error would
        return with every plan that has heights in W and begins after footsteps of the last plan. The expected slope is
        the median of the last soles in single support. The other sole is included only if it is ``flat``: on an edge,
        its tilt is the expected slope.
        """
        config, ground, sole = self._config.swing, self._config.ground, measured.soles[foot]
        error = sole.z - _ground(soles, foot, sole, measured)
        level = soles.landing_level(foot)
        if soles.landing is not None and soles.landing.tread is not None:
            level += (1.0 - config.drift_share) * error
        tilts = soles.tilts.copy()
        tilts[foot] = measured.tilts[foot]
        samples = np.vstack([soles.samples[1:], measured.tilts[1 - foot]]) if flat else soles.samples
        return SoleState(
            holds=replaced(soles.holds, foot, sole),
            tilts=tilts,
            slope=self._expected_slope(samples),
            samples=samples,
            measured=soles.measured,
            roughness=self._rougher(soles.roughness * (1.0 - 1.0 / ground.rough_steps), abs(error) - ground.even),
            levels=replaced(soles.levels, foot, level),
        )

    def tripped(self, soles: SoleState) -> SoleState:
        """State after a foot has tripped over an obstacle."""
        return structs.replace(soles, roughness=self._rougher(soles.roughness, self._config.ground.rough_trip))

    def _rougher(self, before: float, height: float) -> float:
        """Roughness after a new sample [m]: maximum of both, bounded."""
        return min(max(before, height), self._config.ground.rough_max)

    def standing_on(self, soles: SoleState, stance: int, measured: Measurement) -> SoleState:
        """State in single support, with the slope of the ``stance`` sole as the last sample of the expected slope."""
        samples = np.vstack([soles.samples[1:], measured.tilts[stance]])
        return structs.replace(soles, slope=self._expected_slope(samples))

    def _expected_slope(self, samples: Matrix) -> Vector:
        """Median of the slopes of the last soles (n, 2), bounded (2,) [-]."""
        steepest = self._config.ground.slope_max
        return np.clip([median(axis) for axis in samples.T.tolist()], -steepest, steepest)

    def followed(
        self, soles: SoleState, measured: Measurement, swinging: int | None, landed: int | None, dt: float
    ) -> tuple[SoleState, Point]:
        """State after one tick, and drift in W [m].

        Footholds move with the drift, the translation of the ``common_motion`` of the loaded soles since the last tick.
        Planted footholds and their slopes also approach the loaded soles. ``swinging`` is None in double support;
        ``landed`` is the foot that has just landed and settles on the ground.
        """
        (old_left, old_right), (left, right), (hold_left, hold_right) = soles.measured, measured.soles, soles.holds
        tilts = soles.tilts.copy()
        first, second, drift = _follow(
            (old_left.place, old_right.place),
            (left.place, right.place),
            (hold_left.place, hold_right.place),
            measured.loads,
            -1 if swinging is None else swinging,
            -1 if landed is None else landed,
            dt,
            self._anchor,
            measured.tilts,
            tilts,
        )
        holds = Foothold(*first), Foothold(*second)
        return structs.replace(soles, holds=holds, tilts=tilts, measured=measured.soles), drift


@njit(cache=True)
def _follow(
    old: tuple[Place, Place],
    new: tuple[Place, Place],
    holds: tuple[Place, Place],
    loads: Point,
    swinging: int,
    landed: int,
    dt: float,
    limits: Unboxed[AnchorLimits],
    slopes: Matrix,
    tilts: Matrix,
) -> tuple[Place, Place, Point]:
    """``Soles.followed`` for the last and present poses of the soles; moves ``tilts`` towards ``slopes`` (2, 2)."""
    anchor = limits.record
    planted = (0.0 if swinging == 0 else loads[0], 0.0 if swinging == 1 else loads[1])
    _, (x, y, _) = common_motion(old, new, planted, anchor.load)
    share, after = min(dt / anchor.time, 1.0), np.empty((2, 4))
    for foot in range(2):
        hold, sole = holds[foot], new[foot]
        at_x, at_y, yaw, z = hold[0] + x, hold[1] + y, hold[2], hold[3]
        if planted[foot] >= anchor.load:
            at_x, at_y = at_x + share * (sole[0] - at_x), at_y + share * (sole[1] - at_y)
            yaw, z = yaw + share * wrap(sole[2] - yaw), z + share * (sole[3] - z)
            way = min(dt / (anchor.settle_time if foot == landed else anchor.time), 1.0)
            for i in range(2):
                tilts[foot, i] += way * (slopes[foot, i] - tilts[foot, i])
        after[foot, 0], after[foot, 1], after[foot, 2], after[foot, 3] = at_x, at_y, yaw, z
    return (
        (after[0, 0], after[0, 1], after[0, 2], after[0, 3]),
        (after[1, 0], after[1, 1], after[1, 2], after[1, 3]),
        (x, y),
    )


@njit(cache=True)
def _standing_support(left: Pose, right: Pose, dcm: Vector, centres: Matrix, half: Matrix) -> tuple[Extents, Extents]:
    """``Soles.standing_support`` for the poses of the soles."""
    first = point_at(left[0], left[1], left[2], centres[0, 0], centres[0, 1])
    second = point_at(right[0], right[1], right[2], centres[1, 0], centres[1, 1])
    x, y, yaw = 0.5 * (first[0] + second[0]), 0.5 * (first[1] + second[1]), mean_heading(left[2], right[2])
    to_foot, place = relative_to(x, y, yaw, first[0], first[1]), relative_to(x, y, yaw, dcm[0], dcm[1])
    ahead, aside, (length, width) = abs(to_foot[0]), abs(to_foot[1]), (half[0, 0], half[0, 1])
    apart = max(math.hypot(ahead, aside), 1e-9)
    across = abs(to_foot[0] * place[1] - to_foot[1] * place[0]) / apart
    extent = (aside * length + ahead * width) / apart
    return (abs(place[0]), abs(place[1]), across), (length + ahead, width + aside, extent)


def _ground(soles: SoleState, foot: int, hold: Foothold, measured: Measurement) -> float:
    """Height of the ground at a foothold [m], from its tread relative to the other sole, or from the expected slope."""
    landing = soles.landing
    if landing is None or landing.tread is None:
        return _plane(soles.slope, foot, hold, measured)
    return measured.soles[1 - foot].z + landing.tread.height(landing.hold, hold.x, hold.y) - soles.levels[1 - foot]


def _plane(slope: Vector, foot: int, hold: Foothold, measured: Measurement) -> float:
    """Height of the plane with this slope through the other sole, at a foothold [m]."""
    stance = measured.soles[1 - foot]
    return stance.z + float(slope[0]) * (hold.x - stance.x) + float(slope[1]) * (hold.y - stance.y)


class AirborneState(Struct, frozen=True):
    """Whether the robot is off the floor."""

    posture: Vector  # joint positions when ``active`` became true (nj,) [rad]
    active: bool = False  # no foot bears load, so the posture is held
    confirmed: bool = False  # ``active`` has lasted for ``up_time``, so the walk is over
    time: float = 0.0  # duration of the contacts that lead to the next change [s]
    since: float = 0.0  # time since ``confirmed`` [s]


class AirborneDetector:
    """Detects that neither foot bears load, and that the robot is put down again.

    A stance leg has no resistance in the air: its hip reaches 10 rad/s within 20 ms. The posture is therefore held
    after ``float_time``, before the lift is confirmed. If a foot bears load before ``up_time``, the gait continues.
    A lifted robot slowly returns to the standing posture, in which it can be put down. With one foot ahead of the
    other and higher, its CoM would not be above the feet.
    """

    def __init__(self, model: RobotModel, config: LiftConfig) -> None:
        self._model, self._config = model, config
        self.on_floor = AirborneState(model.posture("stand"))

    def update(
        self, airborne: AirborneState, bearing: tuple[bool, bool], joints: Vector, dt: float
    ) -> tuple[AirborneState, bool]:
        """State after one tick, and whether the robot has just been put down."""
        config, posture, active = self._config, airborne.posture, airborne.active
        counts = all(bearing) if airborne.confirmed else not any(bearing)
        time, since = airborne.time + dt if counts else 0.0, airborne.since + dt
        if airborne.confirmed:
            return AirborneState(posture, active, True, time, since), time >= config.down_time
        confirmed = False
        if not counts:
            active = False
        elif not active and time >= config.float_time:
            active = True
            posture = np.clip(joints, self._model.q_lower, self._model.q_upper)
        elif time >= config.up_time:
            confirmed, time, since = True, 0.0, 0.0
        return AirborneState(posture, active, confirmed, time, since), False
