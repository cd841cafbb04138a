"""Simulated depth camera and lidar: rays are cast in a copy of the world of the plant."""

from collections import deque
from collections.abc import Iterator
from typing import Generic, TypeVar

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from bridge.plants.world import SeenWorld
from controllers.estimation.stamps import Due
from models.camera import Pinhole
from models.constants import NANOSECONDS
from models.errors import ConfigError
from models.mujoco_spec import ROBOT_GROUP, WORLD_GROUP
from models.range_sensor import DEPTH_FRAME, LIDAR_FRAME, DepthSensor, LidarSensor, PointCloud, RangeSensor
from models.robot_model import RobotModel
from models.terrain import FLAT, Terrain
from models.types import Matrix, Vector

Item = TypeVar("Item")

_HIDDEN = mujoco.mjNGROUP - 1  #: Group of geoms that rays ignore
#: Steps of azimuth and elevation between two lidar rays, as shares: r^-k mod 1 with r^3 = r + 1. The sequence fills
#: a rectangle evenly and repeats in no turn (Roberts: The unreasonable effectiveness of quasirandom sequences, 2018)
_PATTERN = np.array([0.7548776662466927, 0.5698402909980532])


class RayWorld(SeenWorld):
    """World for the ray casts of range sensors."""

    def __init__(self, robot: RobotModel, terrain: str | Terrain = FLAT) -> None:
        super().__init__(robot, terrain)
        self._seen: NDArray[np.bool_] = self._model.geom_group != ROBOT_GROUP

    def cast(self, frame: str, rays: Matrix, most: float) -> Vector:
        """Distances (n,) along rays (n, 3) of a frame, in units of the ray lengths, at least up to ``most``; else inf.

        The link that carries the sensor is invisible to it, as from inside a housing. Geoms beyond the reach or outside
        the cone of the rays are excluded first, since MuJoCo would test every ray against each of them.
        """
        model, data = self._model, self._data
        site = int(model.site(frame).id)
        axes, position, own = data.site_xmat[site].reshape(3, 3), data.site_xpos[site], model.site_bodyid[site]
        lengths = np.linalg.norm(rays, axis=1)
        reach, cosine = most * float(lengths.max()), float((rays[:, 2] / lengths).min())
        seen = self._seen & (model.body_weldid[model.geom_bodyid] != model.body_weldid[own])
        seen &= (self._in_cone(position, axes, cosine) & self._near(position, reach)) | (model.geom_rbound == 0.0)
        model.geom_group[:] = np.where(seen, WORLD_GROUP, _HIDDEN)
        groups = np.zeros(mujoco.mjNGROUP, dtype=np.uint8)
        groups[WORLD_GROUP] = 1
        count = len(rays)
        geoms, distances = np.empty(count, dtype=np.int32), np.empty(count)
        far = reach / float(lengths.min())
        directions = np.ascontiguousarray(rays @ axes.T).ravel()
        mujoco.mj_multiRay(
            model, data, position, directions, groups, True, -1, geoms, distances, None, count, far
        )  # fmt: skip
        distances[geoms < 0] = np.inf
        return distances

    def _near(self, position: Vector, reach: float) -> NDArray[np.bool_]:
        distance = np.linalg.norm(self._data.geom_xpos - position, axis=1)
        near: NDArray[np.bool_] = distance - self._model.geom_rbound <= reach
        return near

    def _in_cone(self, position: Vector, axes: Matrix, cosine: float) -> NDArray[np.bool_]:
        """Whether the bounding sphere of each geom meets the cone about z; ``cosine`` is of its half angle (ngeom,)."""
        half = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
        offset = (self._data.geom_xpos - position) @ axes
        distance = np.linalg.norm(offset, axis=1)
        safe = np.maximum(distance, 1e-9)
        angle = np.arccos(np.clip(offset[:, 2] / safe, -1.0, 1.0))
        size = np.arcsin(np.clip(self._model.geom_rbound / safe, 0.0, 1.0))
        seen: NDArray[np.bool_] = (distance <= self._model.geom_rbound) | (angle - size <= half)
        return seen


class _SimulatedRange:
    """One sensor in a ``RayWorld``; ``noise`` scales the errors of the profile, ``seed`` is that of their generator."""

    def __init__(self, world: RayWorld, frame: str, config: RangeSensor, stream: int, seed: int, noise: float) -> None:
        self._world, self._frame, self._limits = world, frame, config
        self._stream, self._seed, self._noise = stream, seed, noise
        self.reset()

    def reset(self, seed: int | None = None) -> None:
        """Restart the error generator; a seed replaces the present one."""
        self._seed = self._seed if seed is None else seed
        self._rng = np.random.default_rng((self._seed, self._stream))  # independent of the other sensors
        turn = self._noise * self._limits.misalignment * self._rng.standard_normal(3)
        self._mount: Matrix = pin.exp3(turn)  # true rotation of the sensor in its frame (3, 3)
        self._scale = 1.0 + self._noise * self._limits.scale * float(self._rng.standard_normal())

    def _measure(self, rays: Matrix) -> Vector:
        """Measured distances (n,) along rays (n, 3), in units of their lengths; nan if nothing is in range."""
        limits = self._limits
        distances = self._world.cast(self._frame, rays @ self._mount.T, limits.range_max)
        distances[~((distances >= limits.range_min) & (distances <= limits.range_max))] = np.nan
        errors = self._noise * limits.deviation(distances) * self._rng.standard_normal(len(rays))
        measured: Vector = self._scale * distances + errors
        return measured


class SimulatedDepthCamera(_SimulatedRange):
    """The depth camera of a profile; raises ``ConfigError`` for a robot without one."""

    def __init__(self, world: RayWorld, seed: int = 0, noise: float = 1.0) -> None:
        config = world.robot.profile.sensors.depth
        if config is None:
            raise ConfigError(f"{world.robot.name}: sensors.depth: the profile has no depth camera")
        self.config: DepthSensor = config
        self.intrinsics = Pinhole.of(config)
        self._rays = self.intrinsics.rays
        super().__init__(world, DEPTH_FRAME, config, 2, seed, noise)

    def picture(self) -> Matrix:
        """Depth along the optical axis of each pixel (height, width) [m]; nan if none was measured."""
        pinhole = self.intrinsics
        return self._measure(self._rays).reshape(pinhole.height, pinhole.width)

    def cloud(self, t: float) -> PointCloud:
        """Point cloud of a picture taken now, with a stamp [s]."""
        return self.points(t, self.picture())

    def points(self, t: float, picture: Matrix) -> PointCloud:
        """Point cloud of a picture (height, width) [m], with a stamp [s]; nan pixels are left out."""
        depth = picture.ravel()
        seen = np.isfinite(depth)
        return PointCloud(t, DEPTH_FRAME, self._rays[seen] * depth[seen, None])


class SimulatedLidar(_SimulatedRange):
    """The lidar of a profile, with every turn at one instant; raises ``ConfigError`` for a robot without one."""

    def __init__(self, world: RayWorld, seed: int = 0, noise: float = 1.0) -> None:
        config = world.robot.profile.sensors.lidar
        if config is None:
            raise ConfigError(f"{world.robot.name}: sensors.lidar: the profile has no lidar")
        self.config: LidarSensor = config
        super().__init__(world, LIDAR_FRAME, config, 3, seed, noise)

    def reset(self, seed: int | None = None) -> None:
        super().reset(seed)
        self._turns = 0

    def cloud(self, t: float) -> PointCloud:
        """Points of the next turn, with a stamp [s]."""
        config = self.config
        index = self._turns * config.rays + np.arange(config.rays)
        azimuth, share = np.modf(np.outer(_PATTERN, index))[0]
        elevation = config.elevation_min + share * (config.elevation_max - config.elevation_min)
        flat = np.cos(elevation)
        turn = 2.0 * np.pi * azimuth
        rays = np.column_stack([flat * np.cos(turn), flat * np.sin(turn), np.sin(elevation)])  # (n, 3)
        self._turns += 1
        distances = self._measure(rays)
        hit = np.isfinite(distances)
        return PointCloud(t, LIDAR_FRAME, rays[hit] * distances[hit, None])


class Schedule(Generic[Item]):
    """Measurement times of a sensor, and a queue of measurements until they arrive ``latency`` later; stamps in [ns].

    ``phase`` shifts the periods by a share of their length [-].
    """

    def __init__(self, sensor: RangeSensor, phase: float = 0.0) -> None:
        self._period, self._phase = round(NANOSECONDS / sensor.rate), phase
        self._latency = round(NANOSECONDS * sensor.latency)
        self.restart()

    def restart(self) -> None:
        """Drop waiting measurements; the next stamp is due."""
        self.due = Due(self._period, self._phase)
        self._waiting: deque[tuple[int, Item]] = deque()

    def hold(self, stamp: int, item: Item) -> None:
        """Queue the measurement of a stamp."""
        self._waiting.append((stamp + self._latency, item))

    def arrived(self, stamp: int) -> Iterator[Item]:
        """Measurements that have arrived by a stamp, oldest first."""
        while self._waiting and self._waiting[0][0] <= stamp:
            yield self._waiting.popleft()[1]
