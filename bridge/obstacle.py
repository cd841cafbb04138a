"""The box that may be put into the robot's way while the simulation runs."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from models.errors import CommandError
from models.mujoco_spec import OBSTACLE, parked
from models.terrain import Ground, Terrain
from models.types import Vector


class Obstacle:
    """Places the box of a terrain that has one. Nothing moves it but this.

    Args:
        terrain: The terrain.
        ground: Its height.
        model: MuJoCo's model.
        data: MuJoCo's state; a new place takes effect with the next step.
    """

    def __init__(self, terrain: Terrain, ground: Ground, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._terrain, self._ground, self._data = terrain, ground, data
        self._mocap = -1 if terrain.obstacle is None else int(model.body(OBSTACLE).mocapid[0])

    def place(self, x: float, y: float) -> None:
        """Stand the box on the ground with its middle at a point of W [m].

        Raises:
            CommandError: The terrain has no box, or the point is none.
        """
        if self._terrain.obstacle is None:
            raise CommandError("obstacle: this terrain has none; start with the terrain 'box' or 'wall'")
        if not (math.isfinite(x) and math.isfinite(y)):
            raise CommandError(f"obstacle: ({x}, {y}) m is no place")
        height = self._ground.height(x, y) + 0.5 * self._terrain.obstacle.size[2]
        self._data.mocap_pos[self._mocap] = x, y, height

    @property
    def centre(self) -> Vector | None:
        """Middle of the box in W (3,) [m]; None for a terrain without."""
        return None if self._mocap < 0 else np.array(self._data.mocap_pos[self._mocap])

    def remove(self) -> None:
        """Take the box out of the way; a terrain without is left as it is."""
        if self._terrain.obstacle is not None:
            self._data.mocap_pos[self._mocap] = parked(self._terrain.obstacle)
