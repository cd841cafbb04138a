"""Every model term that one tick needs, updated once and shared by tasks, contacts and assembly."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from controllers.qp.kernels_terms import centroidal_terms, frame_terms, quaternion_matrix
from models.robot_model import RobotModel
from models.types import RobotState, Vector

GRAVITY = 9.81
"""Standard magnitude used by Pinocchio's default model and by the plant [m/s^2]."""


class FrameTerms:
    """Pose, Jacobian, twist and drift of one operational frame, all expressed in the frame.

    Attributes:
        pose: Homogeneous transform in W (4, 4).
        jacobian: Linear then angular (6, nv).
        twist: Velocity (6,) [m/s, rad/s].
        drift: Classical acceleration at zero generalised acceleration (6,) [m/s^2, rad/s^2].
    """

    def __init__(self, model: RobotModel, frame_id: int) -> None:
        self.frame_id = frame_id
        joint = model.pin.frames[frame_id].parentJoint
        columns: list[int] = []
        while joint > 0:
            first, count = model.pin.idx_vs[joint], model.pin.nvs[joint]
            columns.extend(range(first, first + count))
            joint = model.pin.parents[joint]
        self.columns = np.array(sorted(columns), dtype=np.int64)
        self.pose = np.eye(4)
        self.jacobian = np.zeros((6, model.nv))
        self.twist = np.zeros(6)
        self.drift = np.zeros(6)

    @property
    def rotation(self) -> np.ndarray:
        """Rotation of the frame in W (3, 3)."""
        return self.pose[:3, :3]

    @property
    def position(self) -> Vector:
        """Origin of the frame in W (3,) [m]."""
        return self.pose[:3, 3]


class Terms:
    """Dynamics, centroidal quantities and frames of the current state.

    Attributes:
        mass_matrix: M with rotor inertia (nv, nv).
        bias: Coriolis and gravity (nv,).
        base_rotation: R_WB (3, 3).
        com, com_velocity, com_drift: In W (3,) [m, m/s, m/s^2].
        com_jacobian: In W (3, nv).
        momentum, momentum_drift: Angular momentum about the CoM and its rate at zero acceleration, in W (3,).
        momentum_matrix: In W (3, nv).
        soles: Left and right sole frames.
        torso: Torso frame.
    """

    def __init__(self, model: RobotModel) -> None:
        self.model = model
        self._pin = model.pin
        self._data = model.data()
        nv = model.nv
        self.q = np.zeros(model.nq)
        self.v = np.zeros(nv)
        self.mass_matrix = np.zeros((nv, nv))
        self.bias = np.zeros(nv)
        self.base_rotation = np.eye(3)
        self.com = np.zeros(3)
        self.com_velocity = np.zeros(3)
        self.com_jacobian = np.zeros((3, nv))
        self.com_drift = np.zeros(3)
        self.momentum = np.zeros(3)
        self.momentum_matrix = np.zeros((3, nv))
        self.momentum_drift = np.zeros(3)
        self.soles = tuple(FrameTerms(model, foot.frame_id) for foot in model.feet)
        self.torso = FrameTerms(model, model.frame_id("torso"))
        self._frames = (*self.soles, self.torso)

    def update(self, state: RobotState) -> None:
        """Evaluate everything at one state; the arrays of this object are overwritten."""
        self.q[:] = state.q
        self.v[:] = state.v
        self.call_pinocchio()
        data = self._data
        self.mass_matrix = data.M
        self.bias = data.nle
        jacobian, rate = data.J, data.dJ
        quaternion_matrix(self.q[3:7], self.base_rotation)
        centroidal_terms(
            self.mass_matrix,
            self.bias,
            self.base_rotation,
            self.q[:3],
            self.v,
            self.model.mass,
            GRAVITY,
            self.com,
            self.com_velocity,
            self.com_jacobian,
            self.com_drift,
            self.momentum,
            self.momentum_matrix,
            self.momentum_drift,
        )
        for frame in self._frames:
            frame.pose = data.oMf[frame.frame_id].homogeneous
            frame_terms(jacobian, rate, frame.columns, frame.pose, self.v, frame.jacobian, frame.twist, frame.drift)

    def call_pinocchio(self) -> None:
        """Run only the Pinocchio algorithms of ``update`` (the benchmark times them alone)."""
        model, data = self._pin, self._data
        pin.computeJointJacobiansTimeVariation(model, data, self.q, self.v)
        pin.crba(model, data, self.q)
        pin.nonLinearEffects(model, data, self.q, self.v)
        for frame in self._frames:
            pin.updateFramePlacement(model, data, frame.frame_id)
