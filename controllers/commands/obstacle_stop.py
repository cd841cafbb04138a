"""Obstacle stop: limits the walking velocity by the scan of a planar scanner in the direction of travel."""

import dataclasses
import math
from typing import Annotated

import numpy as np
import pinocchio as pin
from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, default_config
from models.errors import MessageError
from models.robot_model import RobotModel
from models.scan import SCAN_FRAME, Scan, check_scan
from models.types import Matrix, Vector, Velocity


@dataclass(frozen=True, slots=True, config=STRICT)
class ObstacleStopConfig:
    """Gaps, speeds and times of the obstacle stop."""

    stop_distance: Annotated[float, Field(gt=0, le=5)]  #: Gap at which the robot must stand [m]
    release_distance: Annotated[float, Field(gt=0, le=10)]  #: Gap above which the robot may walk again [m]
    release_time: Annotated[float, Field(ge=0, le=60)]  #: Time for which the gap must reach release_distance [s]
    margin: Annotated[float, Field(ge=0, le=2)]  #: Widening of the corridor beyond the body on each side [m]
    deceleration: Annotated[float, Field(gt=0, le=10)]  #: Assumed deceleration of a walk [m/s^2]
    reaction_time: Annotated[float, Field(ge=0, le=5)]  #: Time from a scan to its first effect [s]
    speed_min: Annotated[float, Field(gt=0, le=1)]  #: Slowest walk towards an obstacle [m/s]
    scan_timeout: Annotated[float, Field(gt=0, le=5)]  #: Oldest usable scan [s]
    points_min: Annotated[int, Field(ge=1, le=100)]  #: Minimum number of readings of an obstacle [1]

    def __post_init__(self) -> None:
        if self.release_distance <= self.latch_distance:
            raise ValueError(
                f"release_distance {self.release_distance} m is not beyond {self.latch_distance:.3f} m, "
                "where the robot stops"
            )

    @property
    def latch_distance(self) -> float:
        """Gap below which the allowed speed is less than ``speed_min`` [m]."""
        return self.stop_distance + self.speed_min * (self.reaction_time + 0.5 * self.speed_min / self.deceleration)


#: Names of directions in B, counter-clockwise in quarters from x
SIDES = ("ahead", "on the left", "behind", "on the right")
#: Cosine of the largest angle between directions that share a stop: 45 deg to either side
_SAME_WAY = math.cos(math.radians(45.0))


@dataclasses.dataclass(slots=True)
class _Stop:
    direction: Vector  # unit vector in B (2,)
    reason: str
    free_since: float | None = None  # stamp at which the gap became long enough [s]; None while it is too short


class BodyOutline:
    """Horizontal extent of a standing robot in B: hulls and soles in the 'stand' posture."""

    def __init__(self, model: RobotModel) -> None:
        self._data = model.data()
        pin.framesForwardKinematics(model.pin, self._data, model.standing_configuration())
        self._base = self._data.oMf[model.frame_id("base_link")]
        points = [(foot.frame_id, corner, 0.0) for foot in model.feet for corner in foot.corners]
        for name, hull in model.profile.hulls.items():
            frame = model.link_frame_id(hull.link, f"hull '{name}'")
            points += [(frame, np.array(end), hull.radius) for end in (hull.start, hull.end)]
        self._centres: Matrix = np.array([self.placement(frame).act(point)[:2] for frame, point, _ in points])
        self._radii: Vector = np.array([radius for _, _, radius in points])

    def placement(self, frame: int) -> pin.SE3:
        """Placement of a Pinocchio frame in B, in this posture."""
        return self._base.actInv(self._data.oMf[frame])

    def reach(self, direction: Vector) -> float:
        """Extent of the body from the origin of B along a unit vector in B (2,) [m]."""
        return float((self._centres @ direction + self._radii).max())


class ObstacleStop:
    """Limits the walking velocity by the gap between the body and the nearest obstacle in the direction of travel.

    The corridor is the area that the body sweeps on a straight walk in the commanded direction, widened by ``margin``.
    ``g`` is the gap between body and obstacle along the corridor. The speed ``v`` is bounded so that the walk halts at
    ``stop_distance``:

        v t_r + v^2 / (2 a) <= g - stop_distance,    t_r = reaction_time, a = deceleration

    If the bound is below ``speed_min``, translation in this direction stops. It is released once the gap has been at
    least ``release_distance`` for ``release_time``. Turning is always allowed. A scan older than ``scan_timeout`` stops
    translation in every direction. The velocity of a robot without a scanner in its profile is not limited.

    Directions are expressed in B, so turning away from an obstacle releases the robot. The frame ``scan`` is level and
    has its pose in the 'stand' posture.

    Assumptions:
        The scan contains only obstacles. Returns from the floor are farther away than ``release_distance`` unless the
        robot leans more than it can while standing. The scanner driver removes returns from the robot itself.
    """

    def __init__(self, model: RobotModel, config: ObstacleStopConfig | None = None) -> None:
        self.config = config or default_config(ObstacleStopConfig, "controllers", "obstacle_stop")
        self._outline = BodyOutline(model)
        self._rotation, self._origin = np.eye(2), np.zeros(2)
        self.expected = model.profile.sensors.scan is not None
        if self.expected:
            mount = self._outline.placement(model.frame_id(SCAN_FRAME))
            self._rotation, self._origin = mount.rotation[:2, :2], mount.translation[:2]
        self.reset()

    def reset(self) -> None:
        """Discard every scan and every stop."""
        self.stamp: float | None = None  #: Stamp of the newest scan [s]
        self._points: Matrix = np.empty((0, 2))
        self._stops: list[_Stop] = []

    @property
    def stopped(self) -> bool:
        """Whether an obstacle stops the robot in any direction."""
        return bool(self._stops)

    def update(self, scan: Scan) -> None:
        """Accept the newest scan; ``MessageError`` names the field if it is malformed or not newer than the last."""
        check_scan(scan)
        if self.stamp is not None and scan.t <= self.stamp:
            raise MessageError(f"t: {scan.t:.6f} s is not after {self.stamp:.6f} s")
        self.stamp = scan.t
        self._points = scan.points @ self._rotation.T + self._origin  # (k, 2) in B
        self._stops = [stop for stop in self._stops if not self._released(stop, scan.t)]

    def limit(self, velocity: Velocity, t: float) -> tuple[Velocity, str]:
        """Allowed velocity in B [m/s, m/s, rad/s] at ``t`` [s], and the reason of a reduction; empty if unchanged."""
        forward, left, turn = velocity
        if not all(math.isfinite(value) for value in velocity):
            return (0.0, 0.0, 0.0), "stopped: the velocity is not finite"
        speed = math.hypot(forward, left)
        if not self.expected or speed == 0.0:
            return velocity, ""
        direction = np.array([forward / speed, left / speed])
        reason = self._blind(t) or self._stop(direction)
        if reason:
            return (0.0, 0.0, turn), reason
        share = self._speed_within(self.gap(direction)) / speed
        if share >= 1.0:
            return velocity, ""
        return (share * forward, share * left, turn), f"slowed: obstacle {_side(forward, left)}"

    def gap(self, direction: Vector) -> float:
        """Gap between body and obstacle along a unit vector in B (2,) [m]; inf without an obstacle."""
        across = np.array([-direction[1], direction[0]])
        side = self._points @ across  # (k,)
        margin, outline = self.config.margin, self._outline
        inside = (side <= outline.reach(across) + margin) & (side >= -outline.reach(-across) - margin)
        along = self._points[inside] @ direction
        along = along[along > 0.0]
        count = self.config.points_min
        if len(along) < count:
            return math.inf
        return float(np.partition(along, count - 1)[count - 1]) - outline.reach(direction)

    def _blind(self, t: float) -> str:
        """Reason why no scan is usable; empty if one is."""
        if self.stamp is None:
            return "stopped: no scan"
        if abs(t - self.stamp) > self.config.scan_timeout:
            return f"stopped: no scan within {self.config.scan_timeout:g} s"
        return ""

    def _stop(self, direction: Vector) -> str:
        """Reason of a new or present stop in a direction (2,); empty if the robot may walk."""
        for stop in self._stops:
            if stop.direction @ direction >= _SAME_WAY:
                return stop.reason
        gap = self.gap(direction)
        if gap >= self.config.latch_distance:
            return ""
        reason = f"stopped: obstacle {gap:.2f} m {_side(*direction)}"
        self._stops.append(_Stop(direction, reason))
        return reason

    def _released(self, stop: _Stop, t: float) -> bool:
        """Whether a new scan with stamp ``t`` [s] ends a stop."""
        if self.gap(stop.direction) < self.config.release_distance:
            stop.free_since = None
            return False
        stop.free_since = t if stop.free_since is None else stop.free_since
        return t - stop.free_since >= self.config.release_time

    def _speed_within(self, gap: float) -> float:
        """Largest speed [m/s] from which the robot halts at ``stop_distance`` before an obstacle at ``gap`` [m]."""
        config = self.config
        lag = config.deceleration * config.reaction_time
        return math.sqrt(lag**2 + 2.0 * config.deceleration * max(gap - config.stop_distance, 0.0)) - lag


def _side(forward: float, left: float) -> str:
    return SIDES[round(math.atan2(left, forward) / (0.5 * math.pi)) % 4]
