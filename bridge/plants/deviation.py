"""A simulated robot that differs from its profile, which the laws still have: what a real robot does, and a tool."""

import mujoco
import numpy as np
from pydantic.dataclasses import dataclass

from bridge.plants.mujoco import MujocoPlant
from models.config import STRICT, NonNegative, Positive
from models.errors import JointNameError
from models.robot_model import RobotModel
from models.types import Vector

_STREAM = 7  # of random numbers, apart from that of the sensor noise


@dataclass(frozen=True, slots=True, config=STRICT)
class Deviation:
    """Differences between the true robot and its profile; those left out are none.

    Values drawn at random depend on the seed alone.
    """

    mass: Positive = 1.0  #: Factor on all masses and inertias [-]
    com: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: Shift of the robot's CoM, made by that of the torso [m]
    torso_mass: NonNegative = 0.0  #: Added to that of the torso [kg]
    torso_com: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: Shift of the torso's CoM in the torso's frame [m]
    armature: Positive | None = None  #: Rotor inertia of every joint [kg.m^2]
    friction: Positive = 1.0  #: Factor on the dry friction of every joint [-]
    frictionloss: tuple[NonNegative, NonNegative] | None = None  #: Range of a joint's dry friction, drawn [N.m]
    torque_limits: dict[str, Positive] | None = None  #: By joint [N.m]
    imu: tuple[float, float, float] | None = None  #: Place of the IMU in the frame of its link's body [m]
    encoder_offset: NonNegative = 0.0  #: Bound of the offset of each encoder, drawn uniformly [rad]

    def encoder_offsets(self, model: RobotModel, seed: int) -> Vector:
        """Measured minus true position of each joint (nj,) [rad]."""
        return self.encoder_offset * np.random.default_rng([seed, _STREAM, 0]).uniform(-1.0, 1.0, model.nj)

    def apply(self, plant: MujocoPlant, seed: int) -> None:
        """Change a plant that is alone in its world, which is reset; ``JointNameError`` for an unknown joint."""
        mj, robot = plant.model, plant.robot
        self._set_masses(plant)
        dofs = plant.mujoco.joint_qvel
        if self.armature is not None:
            mj.dof_armature[dofs] = self.armature
        if self.frictionloss is not None:
            mj.dof_frictionloss[dofs] = np.random.default_rng([seed, _STREAM, 1]).uniform(*self.frictionloss, robot.nj)
        mj.dof_frictionloss[dofs] *= self.friction
        for name, limit in (self.torque_limits or {}).items():
            if name not in robot.joint_names:
                raise JointNameError(f"torque_limits: unknown joint '{name}'; `poise joints` lists all")
            actuator = plant.mujoco.actuator[robot.joint_names.index(name)]
            mj.jnt_actfrcrange[mj.actuator_trnid[actuator, 0]] = mj.actuator_ctrlrange[actuator] = -limit, limit
        if self.imu is not None:
            mj.site_pos[plant.mujoco.imu_site] = self.imu
        mujoco.mj_setConst(mj, mujoco.MjData(mj))
        plant.reset(seed)

    def _set_masses(self, plant: MujocoPlant) -> None:
        mj, torso = plant.model, plant.mujoco.bodies["torso"]
        mj.body_mass[:] *= self.mass
        mj.body_inertia[:] *= self.mass
        mj.body_inertia[torso] *= 1.0 + self.torso_mass / mj.body_mass[torso]
        mj.body_mass[torso] += self.torso_mass
        mj.body_ipos[torso] += self.torso_com
        mj.body_ipos[torso] += np.array(self.com) * mj.body_mass.sum() / mj.body_mass[torso]
