r"""A baseline that is no match: every joint held stiffly in the standing posture, nothing else.

.. math:: \tau = \tau_0 + k (q_0 - q) - d \dot q

with ``tau_0`` the torques of standing still. It uses neither attitude nor balance: what it takes of a push is
the stiffness of its ankles, and it does not walk. It is there as the pattern for a contender of your own:
``poise bench push --contender benchmarks.stability.stand_still:StandStill``.
"""

import numpy as np
import pinocchio as pin

from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.types import JointCommand, SensorData

#: Stiffness of every joint over what a pendulum of the robot's mass and height topples with, both ankles sharing it
STIFFNESS_PER_WEIGHT = 1.5
DAMPING_TIME = 0.05  # damping over stiffness [s]


class StandStill:
    """Joint PD on the standing posture."""

    torque_controlled = True

    def reset(self, model: RobotModel, seed: int) -> None:
        """Take the posture and the torques that it needs."""
        q = model.standing_configuration()
        height = float(pin.centerOfMass(model.pin, model.data(), q)[2])
        self._posture = q[7:].copy()
        self._torque = model.static_torques(q, model.data())
        self._stiffness = STIFFNESS_PER_WEIGHT * model.mass * GRAVITY * height / 2.0

    def set_velocity(self, forward: float, left: float, turn: float) -> None:
        """It does not walk."""

    def step(self, sensors: SensorData, dt: float) -> JointCommand:
        """Torques of one tick."""
        error = self._posture - sensors.q
        tau = self._torque + self._stiffness * (error - DAMPING_TIME * sensors.v)
        return JointCommand(self._posture, np.zeros_like(tau), tau)
