"""Puts a gait's footholds, swing foot and DCM into the reference of the whole-body controller."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from models.robot_model import RobotModel
from models.types import Matrix, Reference, Vector
from planners.gait.config import GaitConfig
from planners.gait.footsteps import Foothold, wrap
from planners.gait.reaction import SwingReaction
from planners.gait.swing import SwingFoot


def yaw_matrix(yaw: float) -> Matrix:
    """Rotation about the vertical (3, 3)."""
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def sole_matrix(yaw: float, tilt: Vector) -> Matrix:
    """Rotation of a sole that heads along ``yaw`` on a slope that rises by ``tilt`` along x and y of W (3, 3)."""
    across, along = np.array([-tilt[0], -tilt[1], 1.0]), np.array([math.cos(yaw), math.sin(yaw), 0.0])
    normal = across / math.sqrt(float(across @ across))
    along -= (along @ normal) * normal
    along /= math.sqrt(float(along @ along))
    left = (
        normal[1] * along[2] - normal[2] * along[1],
        normal[2] * along[0] - normal[0] * along[2],
        normal[0] * along[1] - normal[1] * along[0],
    )
    return np.column_stack([along, left, normal])


class ReferenceBuilder:
    """Reference of one tick of a gait: base and torso upright at the mean heading of the feet, constant CoM height.

    Args:
        model: The robot.
        config: The gait.
        reaction: Of the swing leg.

    Attributes:
        height: Wanted CoM height above the soles [m].
    """

    def __init__(self, model: RobotModel, config: GaitConfig, reaction: SwingReaction) -> None:
        self._config = config
        self._reaction = reaction
        self._posture = model.posture("stand")
        self._zero = np.zeros(model.nj)
        data = model.data()
        q = model.standing_configuration()
        pin.centerOfMass(model.pin, data, q)
        torso = pin.updateFramePlacement(model.pin, data, model.frame_id("torso"))
        self._standing_height = float(data.com[0][2])
        self._base: Matrix = data.oMi[1].rotation.copy()
        self._torso: Matrix = torso.rotation.copy()
        self.height = self._standing_height
        self._ground: float | None = None

    def reset(self, height: float) -> None:
        """Start at a measured CoM height [m]."""
        self.height = height
        self._ground = None

    def build(
        self,
        footholds: list[Foothold],
        tilts: Matrix,
        swing: SwingFoot | None,
        foot: int,
        load: tuple[float, float],
        dcm: Vector,
        dcm_rate: Vector,
        *,
        upright: bool,
        dt: float,
    ) -> Reference:
        """Build it.

        Args:
            footholds: Of both feet.
            tilts: Slope under each planted sole (2, 2) [-].
            swing: The swing foot's reference; None in double support.
            foot: Which foot swings.
            load: Share of the load of each foot.
            dcm: (2,) [m].
            dcm_rate: (2,) [m/s].
            upright: Whether to rise to the standing height.
            dt: Time since the last tick [s].
        """
        config = self._config
        wanted = self._standing_height - (0.0 if upright else config.crouch)
        step = config.height_rate * dt
        change = min(max(wanted - self.height, -step), step)
        self.height += change
        rotations, positions = np.empty((2, 3, 3)), np.empty((2, 3))
        velocities, accelerations = np.zeros((2, 6)), np.zeros((2, 6))
        yaws, rate = [hold.yaw for hold in footholds], 0.0
        cmp_offset = None
        for i, hold in enumerate(footholds):
            positions[i] = hold.x, hold.y, hold.z
        if swing is not None:
            positions[foot] = swing.position[:3]
            velocities[foot, :3], velocities[foot, 5] = swing.velocity[:3], swing.velocity[3]
            accelerations[foot, :3], accelerations[foot, 5] = swing.acceleration[:3], swing.acceleration[3]
            yaws[foot] = float(swing.position[3])
            rate = 0.5 * float(swing.velocity[3])
            cmp_offset = self._reaction.cmp_offset(swing)
        for i in range(2):
            rotations[i] = sole_matrix(yaws[i], tilts[i] if swing is None or i != foot else swing.tilt)
        turn = yaw_matrix(yaws[0] + 0.5 * wrap(yaws[1] - yaws[0]))
        planted = [footholds[i].z for i in range(2) if swing is None or i != foot]
        ground = sum(planted) / len(planted)
        if self._ground is None:
            self._ground = ground
        self._ground += min(max(ground - self._ground, -step), step)
        contacts = (True, True) if swing is None else (foot != 0, foot != 1)
        return Reference(
            com=np.array([dcm[0], dcm[1], self._ground + self.height]),
            com_velocity=np.array([0.0, 0.0, change / dt]),
            com_acceleration=self._zero[:3],
            base_orientation=turn @ self._base,
            torso_orientation=turn @ self._torso,
            posture=self._posture,
            posture_velocity=self._zero,
            posture_acceleration=self._zero,
            sole_rotations=rotations,
            sole_positions=positions,
            sole_velocities=velocities,
            sole_accelerations=accelerations,
            contacts=contacts,
            load=load,
            dcm=dcm,
            dcm_velocity=dcm_rate,
            heading_rate=rate,
            cmp_offset=cmp_offset,
        )
