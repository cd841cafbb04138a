"""Terrain mapper: elevation map and planar patches from point clouds and odometry."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from models.config import default_config
from models.errors import ConfigError, MessageError
from models.range_sensor import DEPTH_FRAME, LIDAR_FRAME, PointCloud, RangeSensor, check_cloud
from models.robot_model import RobotModel
from models.types import Matrix, Vector
from planners.terrain.body_filter import BodyFilter
from planners.terrain.config import TerrainMapConfig
from planners.terrain.elevation_map import ElevationMap, Heights, level_offset
from planners.terrain.patches import Patch, find_patches


@dataclass(frozen=True, slots=True)
class Posture:
    """Estimated state of the robot at the stamp of a cloud."""

    q: Vector  # configuration (nq,)
    contacts: tuple[bool, bool]  # whether each foot bears load


class TerrainMapper:
    """Maps the ground relative to the stance foot.

    Heights of ``map`` are relative to the sole of the stance foot, so that height drift of the odometry does not deform
    the map. While a foot stands, its sole is the reference. The foot that lands next becomes the reference; the height
    between both soles follows from the joint angles. Horizontal positions are those of the odometry.

    Measured heights may have a common offset, for example from the mounting of a sensor. A Kalman filter estimates the
    offset and shifts the map and later clouds. Its measurement is the height of a sole in single support above a level
    part of the map below it. Before the first of these, once, level ground ahead of both loaded soles is used, since a
    standing robot does not see the ground below it.

    With ``given`` heights, unmeasured cells are filled from them. Their positions are those of the odometry. Their
    heights are relative to the given ground below the stance sole, so that height drift has no effect.

    Points on the robot itself are removed, see ``BodyFilter``, and points outside the range of the sensor: drivers send
    zeros for pixels without a measurement. ``update`` raises ``MessageError`` for a malformed cloud.

    Attributes:
        map: The elevation map.
        t: Stamp up to which the feet are tracked [s]; -inf before the first contact.
        reference: Height of the reference sole in W [m], from the odometry; nan before the first contact.
        bias: Estimated correction that is added to the heights of every cloud [m].
        residual: Last measured height of a sole above the map [m]; nan before the first.
        covered: Whether the given heights include the ground below the stance sole.

    Raises:
        ConfigError: The profile of the robot has neither depth camera nor lidar, and no heights are given.
    """

    def __init__(self, robot: RobotModel, config: TerrainMapConfig | None = None, given: Heights | None = None) -> None:
        self.robot, self.config = robot, config or default_config(TerrainMapConfig, "planners", "terrain_map")
        sensors = robot.profile.sensors
        fitted = {DEPTH_FRAME: sensors.depth, LIDAR_FRAME: sensors.lidar}
        self._sensors: dict[str, RangeSensor] = {frame: each for frame, each in fitted.items() if each is not None}
        if not self._sensors and given is None:
            raise ConfigError(
                f"{robot.name}: sensors.depth, sensors.lidar: the profile has neither, and no map is given"
            )
        self.map, self._given = ElevationMap(self.config), given
        self._body, self._data = BodyFilter(robot, self.config.body), robot.data()
        widths = [foot.rectangle[3] - foot.rectangle[2] for foot in robot.feet]
        self._inset = 0.5 * max(widths)
        self.reset()
        self._compile()

    def reset(self) -> None:
        """Clear the map and all estimates."""
        self.map.clear()
        self.reference = self.residual = np.nan
        self._anchor: int | None = None
        self._swinging = False  # whether the other foot is in the air
        self._checked = True  # whether the map was compared with the present reference sole
        self.bias, self._variance = 0.0, self.config.feet.bias**2  # offset of the clouds, and its variance [m, m^2]
        self.t, self.covered = -np.inf, False
        self._filled = self.map.origin  # origin of the map when it was last filled

    def follow(self, t: float, posture: Posture) -> None:
        """Track the feet and age the map up to a stamp [s]; a stamp before ``t`` has no effect on them.

        ``update`` calls this for each cloud. During longer gaps between clouds it must be called every ``feet.period``:
        a foot that lands after an untracked step may stand one stair higher.
        """
        pin.framesForwardKinematics(self.robot.pin, self._data, posture.q)
        if t < self.t:
            return
        self._follow_feet(posture)
        if self._anchor is not None:
            if np.isfinite(self.t):
                self.map.age(self.config.fusion.drift * (t - self.t))
            self.t = t
            self._fill(posture)

    def update(self, cloud: PointCloud, posture: Posture) -> int:
        """Fuse a cloud with the posture at its stamp; returns the number of measured cells.

        Clouds of several sensors may arrive in any order; only those not older than ``t`` track the feet. Clouds before
        the first contact of a foot are ignored.
        """
        check_cloud(cloud)
        sensor = self._sensors.get(cloud.frame)
        if sensor is None:
            raise MessageError(f"frame: '{cloud.frame[:32]}', expected one of {', '.join(self._sensors)}")
        robot, fusion = self.robot, self.config.fusion
        self.follow(cloud.t, posture)
        if self._anchor is None:
            return 0
        self.map.move_to(*posture.q[:2])
        place = self._data.oMf[robot.frame_id(cloud.frame)]
        rays = cloud.points @ place.rotation.T  # (n, 3) along axes of W
        points = rays + place.translation
        measured = cloud.points[:, 2] if cloud.frame == DEPTH_FRAME else np.linalg.norm(cloud.points, axis=1)  # (n,)
        kept = self._near(points) & (measured > 0.0)
        kept &= (measured >= sensor.range_min) & (measured <= sensor.range_max)
        kept[kept] = self._body.outside(points[kept], self._data)
        rays, points, measured = rays[kept], points[kept], measured[kept]
        points[:, 2] += self.bias - self.reference
        eye = place.translation + np.array([0.0, 0.0, self.bias - self.reference])
        deviations = sensor.deviation(measured) * np.abs(rays[:, 2]) / measured
        deviations = np.maximum(deviations, 0.1 * fusion.floor)  # a horizontal ray has no height error
        common = np.hypot(fusion.attitude * np.hypot(rays[:, 0], rays[:, 1]), sensor.scale * rays[:, 2])
        return self.map.fuse(cloud.t, points, deviations, common, eye)

    def ground(self) -> Heights:
        """Known ground in W."""
        return self.map.heights(self.reference)

    def patches(self) -> list[Patch]:
        """Planar patches with heights above the stance sole, inset by half the width of a sole."""
        return find_patches(self.map, self.config.patches, self._inset)

    def _near(self, points: Matrix) -> np.ndarray:
        """Whether points of W (n, 3) are in the map and within the height limits around the reference sole (n,)."""
        _, inside = self.map.index(points[:, :2])
        height = points[:, 2] - self.reference
        near: np.ndarray = inside & (height <= self.config.height_max) & (height >= -self.config.depth_max)
        return near

    def _follow_feet(self, posture: Posture) -> None:
        """Switch the reference to a foot that has landed, and compare the map with the soles."""
        soles = [self._data.oMf[foot.frame_id] for foot in self.robot.feet]
        contacts = posture.contacts
        if self._anchor is None:
            if True not in contacts:
                return
            self._anchor = contacts.index(True)
        anchor, other = self._anchor, 1 - self._anchor
        if contacts[anchor]:
            self.reference = float(soles[anchor].translation[2])
        if contacts[other] and (self._swinging or not contacts[anchor]):
            height = float(soles[other].translation[2])
            self.map.shift(self.reference - height)
            self.map.age(self.config.fusion.step)
            self.reference, self._anchor, self._checked = height, other, False
        elif contacts[anchor] and not contacts[other] and not self._checked:
            self._checked = True
            self._compare_below(anchor)
        elif all(contacts) and np.isnan(self.residual):
            self._compare_ahead()
        self._swinging = not contacts[1 - self._anchor]

    def _fill(self, posture: Posture) -> None:
        """Fill unknown cells from the given heights, if these include the ground below the stance sole."""
        if self._given is None or self._anchor is None or not posture.contacts[self._anchor]:
            return
        self.map.move_to(*posture.q[:2])
        if self.covered and (self.map.origin == self._filled).all():
            return  # there are no new cells
        below = self._given.at(self._points_of(self._anchor, *self.robot.feet[self._anchor].rectangle[:2])[:, :2])
        self.covered = bool(np.isfinite(below).any())
        if self.covered:
            self._filled = self.map.origin
            self.map.fill(self._given, float(np.nanmedian(below)), self.config.given_deviation**2)

    def _heights(self, foot: int, x_min: float, x_max: float) -> Vector:
        """Heights (n,) [m] of a sole plane above the map, from x_min to x_max [m] along it; nan if not measured."""
        points = self._points_of(foot, x_min, x_max)
        heights: Vector = points[:, 2] - self.reference - self.map.at(points[:, :2], measured=True)
        return heights

    def _points_of(self, foot: int, x_min: float, x_max: float) -> Matrix:
        """Points in W (n, 3) [m] on the plane of a sole, from x_min to x_max [m] along it."""
        sole, (_, _, y_min, y_max) = self._data.oMf[self.robot.feet[foot].frame_id], self.robot.feet[foot].rectangle
        xs, ys = np.arange(x_min, x_max, self.map.cell), np.arange(y_min, y_max, self.map.cell)
        local = np.stack(np.meshgrid(xs, ys, 0.0, indexing="ij"), axis=-1).reshape(-1, 3)
        points: Matrix = local @ sole.rotation.T + sole.translation
        return points

    def _compare_below(self, foot: int) -> None:
        """Measure the height of a sole above the map below it, if that is level."""
        self._variance += self.config.feet.drift**2
        heights = self._heights(foot, *self.robot.feet[foot].rectangle[:2])
        if not np.isnan(heights).any() and np.ptp(heights) <= 2.0 * self.config.patches.roughness:
            self._correct(float(np.median(heights)), self.config.feet.below)

    def _compare_ahead(self) -> None:
        """Measure the height of both soles above the map ahead of them, if that is level."""
        feet, toes = self.config.feet, [foot.rectangle[1] for foot in self.robot.feet]
        heights = np.concatenate([self._heights(foot, toe, toe + feet.distance) for foot, toe in enumerate(toes)])
        residual = level_offset(heights, feet.known, self.config.patches.roughness)
        if residual is not None:
            self._correct(residual, feet.ahead)

    def _correct(self, residual: float, deviation: float) -> None:
        """Correct map and bias by a measured height of a sole above the map, with its standard deviation [m]."""
        self.residual = residual
        if abs(residual) <= self.config.feet.limit:
            gain = self._variance / (self._variance + deviation**2)
            self._variance *= 1.0 - gain
            self.map.shift(gain * residual)
            self.bias += gain * residual

    def _compile(self) -> None:
        """Run every kernel once, so that the first cloud does not wait for the compiler."""
        posture = Posture(self.robot.standing_configuration(), (True, True))
        self.follow(0.0, posture)
        if self._sensors:
            self.update(PointCloud(0.0, next(iter(self._sensors)), np.ones((2, 3))), posture)
        corner = slice(self.map.cells // 2, None)
        self.map.height[:], self.map.variance[:] = 0.0, 0.0
        self.map.variance[corner, corner] = np.inf  # a patch that is cut in two
        self.patches()
        self.reset()
