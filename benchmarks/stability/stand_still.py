r"""Baseline that holds every joint stiffly in the standing posture.

.. math:: \tau = \tau_0 + k (q_0 - q) - d \dot q

where ``tau_0`` are the static torques of standing. It uses neither attitude nor balance: only the stiffness of its
ankles resists a push, and it does not walk. It is a template for other contenders:
``poise bench push --contender benchmarks.stability.stand_still:StandStill``.
"""

import numpy as np
import pinocchio as pin

from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.types import JointCommand, SensorData

#: Stiffness of every joint over the toppling stiffness of a pendulum with the robot's mass and height, for two ankles
STIFFNESS_PER_WEIGHT = 1.5
DAMPING_TIME = 0.05  # damping over stiffness [s]


class StandStill:
    """Joint PD on the standing posture."""

    torque_controlled = True

    def reset(self, model: RobotModel, seed: int) -> None:
        """Set the posture and its static torques."""
        q = model.standing_configuration()
        height = float(pin.centerOfMass(model.pin, model.data(), q)[2])
        self._posture = q[7:].copy()
        self._torque = model.static_torques(q, model.data())
        self._stiffness = STIFFNESS_PER_WEIGHT * model.mass * GRAVITY * height / 2.0

    def set_velocity(self, forward: float, left: float, turn: float) -> None:
        """Ignore the velocity: the robot does not walk."""

    def step(self, sensors: SensorData, dt: float) -> JointCommand:
        """Return the torques of one tick."""
        error = self._posture - sensors.q
        tau = self._torque + self._stiffness * (error - DAMPING_TIME * sensors.v)
        return JointCommand(self._posture, np.zeros_like(tau), tau)
