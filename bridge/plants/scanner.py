"""The simulated planar laser scanner."""

import math

import mujoco
import numpy as np

from bridge.plants.mujoco import MujocoPlant
from models.errors import ConfigError
from models.mujoco_spec import ROBOT_GROUP, WORLD_GROUP
from models.scan import SCAN_FRAME, Scan


class LaserScanner:
    """Casts the rays of the profile's ``sensors.scan`` in the plane of frame ``scan``, which tilts with the robot.

    All rays of a scan are cast at one instant. They hit ground, obstacles and other robots, and pass through the robot
    itself, as after a self-filter. ``noise`` is a factor on the profile's noise, which has a separate random generator.
    Raises ``ConfigError`` for a robot without a scanner.
    """

    def __init__(self, plant: MujocoPlant, seed: int = 0, noise: float = 1.0) -> None:
        config = plant.robot.profile.sensors.scan
        if config is None:
            raise ConfigError(f"{plant.robot.name}: sensors.scan: the profile has no scanner")
        self.config, self._plant = config, plant
        model, mj = plant.model, plant.mujoco
        self._site = int(model.site(mj.prefix + SCAN_FRAME).id)
        strangers = (model.geom_group == ROBOT_GROUP) & (model.body_rootid[model.geom_bodyid] != mj.base_body)
        self._strangers = np.flatnonzero(strangers)
        angles = np.linspace(config.angle_min, config.angle_max, config.rays)
        self._rays = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(config.rays)])  # (n, 3) in the frame
        self._groups = np.zeros(mujoco.mjNGROUP, dtype=np.uint8)
        self._groups[WORLD_GROUP] = 1
        self._geoms = np.empty(config.rays, dtype=np.int32)
        self._distances = np.empty(config.rays)
        self._noise = noise * config.noise
        self._seed = seed
        self.reset()

    def reset(self, seed: int | None = None) -> None:
        """Restart the noise generator; a seed replaces the present one."""
        self._seed = self._seed if seed is None else seed
        self._rng = np.random.default_rng((self._seed, 1))  # a stream separate from the other sensors'

    def scan(self, t: float) -> Scan:
        """Scan at the present state, with a stamp [s]."""
        config, model, data = self.config, self._plant.model, self._plant.data
        rays = self._rays @ data.site_xmat[self._site].reshape(3, 3).T
        model.geom_group[self._strangers] = WORLD_GROUP  # rays select geoms by group, without the robot itself
        mujoco.mj_multiRay(
            model,
            data,
            data.site_xpos[self._site],
            rays.ravel(),
            self._groups,
            True,  # include static geoms
            -1,
            self._geoms,
            self._distances,
            None,
            config.rays,
            config.range_max,
        )
        model.geom_group[self._strangers] = ROBOT_GROUP
        ranges = self._distances + self._noise * self._rng.standard_normal(config.rays)
        ranges[ranges < config.range_min] = -math.inf
        ranges[(self._geoms < 0) | (ranges > config.range_max)] = math.inf
        step = (config.angle_max - config.angle_min) / (config.rays - 1)
        return Scan(t, config.angle_min, step, ranges, config.range_min, config.range_max)
