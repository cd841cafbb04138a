"""Puts a gait's footholds, swing foot and DCM into the reference of the whole-body controller."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from models.robot_model import RobotModel
from models.types import Matrix, Reference, Vector
from planners.gait.config import GaitConfig
from planners.gait.footsteps import Foothold
from planners.gait.kernels_steps import wrap
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
        soles = [pin.updateFramePlacement(model.pin, data, foot.frame_id).translation[:2] for foot in model.feet]
        self._under = [np.array(sole - data.com[0][:2]) for sole in soles]
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
        yaw = footholds[0].yaw + 0.5 * wrap(footholds[1].yaw - footholds[0].yaw)
        turn = yaw_matrix(yaw)
        wanted = min(wanted, self._in_reach(footholds, None if swing is None else foot, com[:2], lean, turn[:2, :2]))
        step = config.height_rate * dt
        change = min(max(wanted - self.height, -config.drop_rate * dt), step)
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
            sole_areas=areas,
        )

    def _in_reach(
        self, footholds: list[Foothold], swinging: int | None, com: Vector, lean: float, turn: Matrix
    ) -> float:
        """CoM height at which no leg is longer than in the 'stand' posture [m].

        A planted foot is as far from under its hip as it is measured, and will be as far as ``lean`` of the way
        between the feet when the swing foot lands.
        """
        feet = [np.array([hold.x, hold.y]) for hold in footholds]
        under = [turn @ place for place in self._under]
        apart = feet[0] - feet[1] - (under[0] - under[1])
        square = lean * lean * float(apart @ apart)
        for foot in range(2):
            if foot != swinging:
                off = feet[foot] - com - under[foot]
                square = max(square, float(off @ off))
        leg = self._config.leg
        return self._standing_height - leg + math.sqrt(max(leg * leg - square, 0.25 * leg * leg))
