"""Scores of the simulated robot from its true state: falls and foot slip."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from bridge.plants.loop_config import LoopConfig
from bridge.plants.mujoco import MujocoPlant
from models.constants import GRAVITY


class PlantMonitor:
    """Detects falls and slip of stance feet.

    Fallen, until ``reset``: the base is lower over the ground than ``fall_height`` of its height at ``reset``, or
    tilted more than ``fall_tilt``, or anything but a sole touches the floor.

    Slip of a foot, from the pose of its sole when the foot last took load: |p_xy - p_xy,0| + |yaw - yaw_0| r, with r
    the distance from the sole's origin to the farthest corner. ``foot_slip`` is the largest since ``reset`` (2,) [m];
    ``reason`` is the kind of fall, empty before one.
    """

    def __init__(self, plant: MujocoPlant, config: LoopConfig) -> None:
        self._plant = plant
        self._config = config
        model, mj = plant.model, plant.mujoco
        self._sites = np.array(mj.sole_sites)
        soles = model.site_bodyid[self._sites]
        own = model.body_rootid[model.geom_bodyid] == mj.base_body  # (ngeom,)
        self._is_limb = own & ~np.isin(model.geom_bodyid, soles)
        self._is_floor = model.geom_bodyid == 0
        self._radius = np.array([np.linalg.norm(foot.corners, axis=1).max() for foot in plant.robot.feet])
        self._load = config.slip_load * GRAVITY * plant.robot.mass
        self.reset()

    def reset(self) -> None:
        """Start over; the present height of the base becomes the standing height."""
        self.fallen = False
        self.reason = ""
        self.foot_slip = np.zeros(2)
        self._standing = np.zeros(2, dtype=bool)
        self._anchor = np.zeros((2, 3))  # x, y, yaw
        self._height = self._height_over_ground()

    def update(self) -> None:
        """Evaluate the present state."""
        if not self.fallen:
            self.reason = self._find_fall()
            self.fallen = bool(self.reason)
        self._measure_slip()

    def _find_fall(self) -> str:
        data = self._plant.data
        height = self._height_over_ground()
        upright = float(data.xmat[self._plant.mujoco.base_body, 8])  # z of W along z of B
        if not height >= self._config.fall_height * self._height:
            return f"base {height:.2f} m over the ground, {height / self._height:.2f} of its standing height"
        if not upright >= math.cos(self._config.fall_tilt):
            return f"base tilted by {math.degrees(math.acos(max(min(upright, 1.0), -1.0))):.0f} deg"
        pairs = data.contact.geom  # (ncon, 2)
        strange = self._is_floor[pairs].any(axis=1) & self._is_limb[pairs].any(axis=1)
        if strange.any():
            pair = pairs[int(np.flatnonzero(strange)[0])]
            body = self._plant.model.geom_bodyid[pair[0] if self._is_floor[pair[1]] else pair[1]]
            return f"{mujoco.mj_id2name(self._plant.model, mujoco.mjtObj.mjOBJ_BODY, body)} touches the floor"
        return ""

    def _height_over_ground(self) -> float:
        x, y, z = (float(value) for value in self._plant.data.qpos[self._plant.mujoco.qpos][:3])
        return z - self._plant.ground.height(x, y)

    def _measure_slip(self) -> None:
        data = self._plant.data
        frames = data.site_xmat[self._sites]  # (2, 9)
        now = np.empty((2, 3))
        now[:, :2] = data.site_xpos[self._sites, :2]
        now[:, 2] = np.arctan2(frames[:, 3], frames[:, 0])
        standing = self._plant.wrenches[:, 2] > self._load
        landed = standing & ~self._standing
        self._anchor[landed] = now[landed]
        moved = now - self._anchor
        turn = np.abs((moved[:, 2] + np.pi) % (2.0 * np.pi) - np.pi)
        slip = np.hypot(moved[:, 0], moved[:, 1]) + turn * self._radius
        self.foot_slip = np.where(standing, np.maximum(self.foot_slip, slip), self.foot_slip)
        self._standing = standing
