"""What the gait reads off a robot state: DCM and sole poses."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from models.compiled import njit
from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.types import Matrix, RobotState, Vector
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
        self._data = data = model.data()
        self._frames = tuple(foot.frame_id for foot in model.feet)
        self._weight = model.mass * GRAVITY
        self.com = np.zeros(3)
        self.com_velocity = np.zeros(3)
        self.soles = [Foothold(0.0, 0.0, 0.0), Foothold(0.0, 0.0, 0.0)]
        self.tilts = np.zeros((2, 2))
        self.loads = [0.0, 0.0]
        self.cops, self.turning = np.zeros((2, 2)), np.zeros((2, 2))
        self.active = [True, True]
        # Pinocchio's arrays stay where they are.
        self._com, self._com_velocity = data.com[0], data.vcom[0]
        self._views = []
        for i, frame_id in enumerate(self._frames):
            frame, pose = model.pin.frames[frame_id], data.oMf[frame_id]
            spin, mounting = data.v[frame.parentJoint].angular, np.array(frame.placement.rotation, order="F")
            self._views.append((pose.rotation, spin, mounting, self.tilts[i], self.turning[i], pose.translation))

    def update(self, state: RobotState) -> None:
        """Evaluate one state."""
        model, data = self._pin, self._data
        pin.centerOfMass(model, data, state.q, state.v, False)
        self.com[:] = self._com
        self.com_velocity[:] = self._com_velocity
        for i, (rotation, spin, mounting, tilt, turning, position) in enumerate(self._views):
            pin.updateFramePlacement(model, data, self._frames[i])
            yaw = _read_sole(rotation, spin, mounting, tilt, turning)
            x, y, z = position.tolist()
            self.soles[i] = Foothold(x, y, yaw, z)
            contact = state.contacts[i]
            _, _, force, mx, my, _ = contact.wrench.tolist()
            self.loads[i] = force / self._weight
            if self.loads[i] > _LOADED:
                self.cops[i, 0], self.cops[i, 1] = -my / force, mx / force
            self.active[i] = contact.active

    def dcm(self, omega: float) -> Vector:
        """``xi = c + c' / omega``, horizontal (2,) [m]."""
        dcm: Vector = self.com[:2] + self.com_velocity[:2] / omega
        return dcm


@njit("float64(float64[::1, :], float64[::1], float64[::1, :], float64[::1], float64[::1])", cache=True)
def _read_sole(rotation: Matrix, spin: Vector, mounting: Matrix, tilt: Vector, turning: Vector) -> float:
    """Heading of a sole [rad].

    Args:
        rotation: Of the sole in W (3, 3).
        spin: Angular velocity of the link that carries it, in the frame of its joint (3,) [rad/s].
        mounting: Rotation of the sole in that frame (3, 3).
        tilt: Out: slope of the sole (2,) [-].
        turning: Out: angular velocity about its own x and y (2,) [rad/s].
    """
    upright = max(rotation[2, 2], _UPRIGHT_MIN)
    for i in range(2):
        tilt[i] = -rotation[i, 2] / upright
        turning[i] = mounting[0, i] * spin[0] + mounting[1, i] * spin[1] + mounting[2, i] * spin[2]
    return math.atan2(rotation[1, 0], rotation[0, 0])
