"""What the gait reads off a robot state: DCM and sole poses."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.types import RobotState, Vector
from planners.gait.footsteps import Foothold

_UPRIGHT_MIN = 0.1
"""Least cosine of a sole's tilt that its slope is computed from [-]: that of an upturned foot means nothing."""


_LOADED = 0.05
"""Share of the weight from which a sole has a centre of pressure [-]."""


class GaitMeasurement:
    """CoM, DCM and soles of the last state.

    Args:
        model: The robot.

    Attributes:
        com: In W (3,) [m].
        com_velocity: In W (3,) [m/s].
        soles: Measured pose of each sole.
        tilts: Slope of each sole: its rise along x and along y of W (2, 2) [-].
        loads: Vertical force on each sole, share of the weight (2,) [-].
        cops: Centre of pressure of each sole that bears, in its frame (2, 2) [m].
        turning: Angular velocity of each sole about its own x and y (2, 2) [rad/s].
        active: Whether each foot bears, as the estimator has it.
    """

    def __init__(self, model: RobotModel) -> None:
        self._pin = model.pin
        self._data = model.data()
        self._frames = tuple(foot.frame_id for foot in model.feet)
        self._weight = model.mass * GRAVITY
        self.com = np.zeros(3)
        self.com_velocity = np.zeros(3)
        self.soles = [Foothold(0.0, 0.0, 0.0), Foothold(0.0, 0.0, 0.0)]
        self.tilts = np.zeros((2, 2))
        self.loads = [0.0, 0.0]
        self.cops, self.turning = np.zeros((2, 2)), np.zeros((2, 2))
        self.active = [True, True]

    def update(self, state: RobotState) -> None:
        """Evaluate one state."""
        model, data = self._pin, self._data
        pin.centerOfMass(model, data, state.q, state.v, False)
        self.com[:] = data.com[0]
        self.com_velocity[:] = data.vcom[0]
        for i, frame in enumerate(self._frames):
            pose = pin.updateFramePlacement(model, data, frame)
            x, y, z = (float(value) for value in pose.translation)
            rotation = pose.rotation
            self.soles[i] = Foothold(x, y, math.atan2(float(rotation[1, 0]), float(rotation[0, 0])), z)
            upright = max(float(rotation[2, 2]), _UPRIGHT_MIN)
            self.tilts[i] = -float(rotation[0, 2]) / upright, -float(rotation[1, 2]) / upright
            force, (mx, my) = float(state.contacts[i].wrench[2]), state.contacts[i].wrench[3:5]
            self.loads[i] = force / self._weight
            if self.loads[i] > _LOADED:
                self.cops[i] = -my / force, mx / force
            self.turning[i] = pin.getFrameVelocity(model, data, frame, pin.LOCAL).angular[:2]
            self.active[i] = state.contacts[i].active

    def dcm(self, omega: float) -> Vector:
        """``xi = c + c' / omega``, horizontal (2,) [m]."""
        dcm: Vector = self.com[:2] + self.com_velocity[:2] / omega
        return dcm
