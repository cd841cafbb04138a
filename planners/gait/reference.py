"""Puts a gait's footholds, swing foot and DCM into the reference of the whole-body controller."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from models.robot_model import RobotModel
from models.types import Matrix, Reference, Vector
from planners.gait.config import GaitConfig
from planners.gait.footsteps import Foothold, middle
from planners.gait.kernels_reference import height_in_reach, place_bodies
from planners.gait.reaction import SwingReaction
from planners.gait.swing import SwingFoot


def yaw_matrix(yaw: float) -> Matrix:
    """Rotation about the vertical (3, 3)."""
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


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
        soles = [pin.updateFramePlacement(model.pin, data, foot.frame_id).translation[:2] for foot in model.feet]
        self._under = np.array([sole - data.com[0][:2] for sole in soles])
        self._upright = np.array([data.oMi[1].rotation, torso.rotation])  # of base and torso (2, 3, 3)
        self._no_motion, self._no_tilt = np.zeros((3, 4)), np.zeros(2)
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
        com: Vector,
        lean: float,
        dcm: Vector,
        dcm_rate: Vector,
        *,
        areas: Matrix,
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
            com: Measured CoM (3,) [m].
            lean: Share of the way between the feet at which the body will be when the swing foot lands.
            dcm: (2,) [m].
            dcm_rate: (2,) [m/s].
            areas: What bears of each sole, in its frame (2, 4) [m].
            upright: Whether to rise to the standing height.
            dt: Time since the last tick [s].
        """
        config = self._config
        wanted = self._standing_height - (0.0 if upright else config.crouch)
        left, right = footholds
        yaw = middle(footholds).yaw
        wanted = min(wanted, self._in_reach(footholds, None if swing is None else foot, com, lean, yaw))
        step = config.height_rate * dt
        change = min(max(wanted - self.height, -config.drop_rate * dt), step)
        self.height += change
        rotations, positions = np.empty((2, 3, 3)), np.empty((2, 3))
        motions, bodies = np.empty((2, 2, 6)), np.empty((2, 3, 3))
        place_bodies(
            ((left.x, left.y, left.z, left.yaw), (right.x, right.y, right.z, right.yaw)),
            tilts,
            -1 if swing is None else foot,
            self._no_motion if swing is None else swing.motion,
            self._no_tilt if swing is None else swing.tilt,
            self._upright,
            rotations,
            positions,
            motions,
            bodies,
        )
        ground = 0.5 * (left.z + right.z) if swing is None else footholds[1 - foot].z
        if self._ground is None:
            self._ground = ground
        self._ground += min(max(ground - self._ground, -step), step)
        contacts = (True, True) if swing is None else (foot != 0, foot != 1)
        return Reference(
            com=np.array([dcm[0], dcm[1], self._ground + self.height]),
            com_velocity=np.array([0.0, 0.0, change / dt]),
            com_acceleration=self._zero[:3],
            base_orientation=bodies[0],
            torso_orientation=bodies[1],
            posture=self._posture,
            posture_velocity=self._zero,
            posture_acceleration=self._zero,
            sole_rotations=rotations,
            sole_positions=positions,
            sole_velocities=motions[0],
            sole_accelerations=motions[1],
            contacts=contacts,
            load=load,
            dcm=dcm,
            dcm_velocity=dcm_rate,
            heading_rate=0.0 if swing is None else 0.5 * float(swing.velocity[3]),
            cmp_offset=None if swing is None else self._reaction.cmp_offset(swing),
            sole_areas=areas,
        )

    def _in_reach(self, footholds: list[Foothold], swinging: int | None, com: Vector, lean: float, yaw: float) -> float:
        """CoM height at which no leg is longer than in the 'stand' posture [m]; see ``height_in_reach``."""
        left, right = footholds
        height: float = height_in_reach(
            ((left.x, left.y), (right.x, right.y)),
            self._under,
            -1 if swinging is None else swinging,
            com,
            lean,
            yaw,
            self._config.leg,
            self._standing_height,
        )
        return height
