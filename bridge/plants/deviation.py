"""Model errors: a simulated robot that differs, as a real one does, from the profile that the control laws use."""

import mujoco
import numpy as np
from pydantic.dataclasses import dataclass

from bridge.plants.mujoco import MujocoPlant
from models.config import STRICT, NonNegative, Positive
from models.errors import JointNameError
from models.robot_model import RobotModel
from models.types import Vector

_STREAM = 7  # random stream, separate from the sensor noise


@dataclass(frozen=True, slots=True, config=STRICT)
class Deviation:
    """Differences between the simulated robot and its profile; the defaults change nothing.

    Random values depend on the seed only.
    """

    mass: Positive = 1.0  #: Factor on all masses and inertias [-]
    com: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: Shift of the robot's CoM, by a shift of the torso's CoM [m]
    torso_mass: NonNegative = 0.0  #: Added to the mass of the torso [kg]
    torso_com: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: Shift of the torso's CoM in the torso's frame [m]
    armature: Positive | None = None  #: Rotor inertia of every joint [kg.m^2]
    friction: Positive = 1.0  #: Factor on the dry friction of every joint [-]
    frictionloss: tuple[NonNegative, NonNegative] | None = None  #: Range of the random dry friction of each joint [N.m]
    torque_limits: dict[str, Positive] | None = None  #: Torque limit by joint [N.m]
    imu: tuple[float, float, float] | None = None  #: Position of the IMU in the frame of its link's body [m]
    encoder_offset: NonNegative = 0.0  #: Bound of the uniform random offset of each encoder [rad]

    def encoder_offsets(self, model: RobotModel, seed: int) -> Vector:
        """Measured minus true position of each joint (nj,) [rad]."""
        return self.encoder_offset * np.random.default_rng([seed, _STREAM, 0]).uniform(-1.0, 1.0, model.nj)

    def apply(self, plant: MujocoPlant, seed: int) -> None:
        """Apply to the only plant of a world, and reset it; ``JointNameError`` for an unknown joint."""
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
