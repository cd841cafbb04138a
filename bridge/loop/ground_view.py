"""Depth camera, lidar and terrain mapper for the closed loop, with their rates and latencies."""

import time
from collections.abc import Callable

from bridge.loop.lockstep import Lockstep
from bridge.plants.range_sensors import RayWorld, Schedule, SimulatedDepthCamera, SimulatedLidar
from models.constants import NANOSECONDS
from models.errors import ConfigError
from models.range_sensor import PointCloud
from models.terrain import Terrain
from planners.terrain.elevation_map import Heights
from planners.terrain.mapper import Posture, TerrainMapper


class GroundView:
    """Casts the rays of the range sensors from the true state of the robot, and maps them with the estimated state.

    Where nothing has been seen, the mapper uses ``given`` heights. There are no sensors when ``sees`` is False.

    Attributes:
        mapper: The terrain mapper.
        blind: Whether the sensors measure nothing.
        delays: Latency from measurement to map, for each cloud [s]: configured latency, rounded up to a tick, and
            processor time of the update. The transport of messages is not included.
        costs: Processor time of each update [s], by sensor frame.
    """

    def __init__(
        self,
        lockstep: Lockstep,
        terrain: str | Terrain,
        seed: int,
        noise: float,
        given: Heights | None = None,
        *,
        sees: bool = True,
    ) -> None:
        self._lockstep, robot = lockstep, lockstep.plant.robot
        self._world = RayWorld(robot, terrain)
        sensors = robot.profile.sensors
        self._sensors: list[SimulatedDepthCamera | SimulatedLidar] = []
        if sensors.depth is not None and sees:
            self._sensors.append(SimulatedDepthCamera(self._world, seed, noise))
        if sensors.lidar is not None and sees:
            self._sensors.append(SimulatedLidar(self._world, seed, noise))
        if not self._sensors and given is None:
            raise ConfigError(f"terrain_map: {robot.name} has neither sensors.depth nor sensors.lidar")
        self.mapper = TerrainMapper(robot, given=given)
        self.blind = False
        self.reset()

    def reset(self, seed: int | None = None) -> None:
        """Clear the map; ``seed``, if given, replaces the current seed. ``blind`` is kept."""
        self.mapper.reset()
        self.delays: list[float] = []
        self.costs: dict[str, list[float]] = {}
        self._schedules = [Schedule[tuple[PointCloud, Posture]](sensor.config) for sensor in self._sensors]
        for sensor in self._sensors:
            sensor.reset(seed)

    def step(self) -> None:
        """Take the measurements that are due after a tick, and map the clouds that have arrived."""
        t = self._lockstep.plant.t
        stamp = round(NANOSECONDS * t)
        for sensor, schedule in zip(self._sensors, self._schedules, strict=True):
            if not self.blind and schedule.due(stamp):
                schedule.hold(stamp, self._measure(sensor.cloud))
            for cloud, posture in schedule.arrived(stamp):
                self._map(cloud, posture)
        if t - self.mapper.t >= self.mapper.config.feet.period:
            self.mapper.follow(t, self._posture())

    def _measure(self, cloud: Callable[[float], PointCloud]) -> tuple[PointCloud, Posture]:
        plant = self._lockstep.plant
        self._world.obstacle = plant.obstacle.centre
        self._world.set(plant.truth.q)
        return cloud(plant.t), self._posture()

    def _posture(self) -> Posture:
        state = self._lockstep.stack.state
        left, right = state.contacts
        return Posture(state.q.copy(), (left.active, right.active))

    def _map(self, cloud: PointCloud, posture: Posture) -> None:
        begin = time.thread_time()
        self.mapper.update(cloud, posture)
        took = time.thread_time() - begin
        self.costs.setdefault(cloud.frame, []).append(took)
        self.delays.append(self._lockstep.plant.t - cloud.t + took)
