"""Every model term that one tick needs, updated once and shared by tasks, contacts and assembly."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from controllers.memory import Block
from controllers.qp.kernels_read import TERMS, read_terms
from models.robot_model import RobotModel
from models.types import Matrix, RobotState, Vector

GRAVITY = 9.81
"""Standard magnitude used by Pinocchio's default model and by the plant [m/s^2]."""


class FrameTerms:
    """Pose, Jacobian, twist and drift of one operational frame, all expressed in the frame.

    Attributes:
        frame_id: Pinocchio's id of the frame.
        pose: Homogeneous transform in W (4, 4).
        jacobian: Linear then angular (6, nv).
        twist: Velocity (6,) [m/s, rad/s].
        drift: Classical acceleration at zero generalised acceleration (6,) [m/s^2, rad/s^2].
        rotation: Rotation of the frame in W, part of ``pose`` (3, 3).
        position: Origin of the frame in W, part of ``pose`` (3,) [m].
    """

    def __init__(self, frame_id: int, block: Block, index: int) -> None:
        self.frame_id = frame_id
        self.pose: Matrix = block["pose"][index]
        self.jacobian: Matrix = block["jacobian"][index]
        self.twist: Vector = block["twist"][index]
        self.drift: Vector = block["drift"][index]
        self.rotation: Matrix = self.pose[:3, :3]
        self.position: Vector = self.pose[:3, 3]


class Terms:
    """Dynamics, centroidal quantities and frames of the current state.

    The arrays are always the same ones, overwritten by ``update``; those of the dynamics belong to Pinocchio.

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
        block: All but the dynamics, for kernels.
    """

    def __init__(self, model: RobotModel) -> None:
        self.model = model
        self._pin = model.pin
        self._data = data = model.data()
        nv = model.nv
        frames = ((3, 4, 4), (3, 6, nv), (3, 6), (3, 6))
        shapes = ((model.nq,), (nv,), (3, 3), (3,), (3,), (3, nv), (3,), (3,), (3, nv), (3,), *frames)
        self.block = block = Block(dict(zip(TERMS, shapes, strict=True)))
        self.q, self.v, self.base_rotation = (block[name] for name in ("q", "v", "base_rotation"))
        self.com, self.com_velocity = block["com"], block["com_velocity"]
        self.com_jacobian, self.com_drift = block["com_jacobian"], block["com_drift"]
        self.momentum, self.momentum_drift = block["momentum"], block["momentum_drift"]
        self.momentum_matrix = block["momentum_matrix"]
        block["pose"][:] = np.eye(4)
        self._frames = (model.feet[0].frame_id, model.feet[1].frame_id, model.frame_id("torso"))
        self.soles = FrameTerms(self._frames[0], block, 0), FrameTerms(self._frames[1], block, 1)
        self.torso = FrameTerms(self._frames[2], block, 2)
        # Pinocchio's arrays stay where they are; M is symmetric, and its transpose has contiguous rows.
        self.mass_matrix: Matrix = data.M.T
        self.bias: Vector = data.nle
        placements = [data.oMf[frame] for frame in self._frames]
        self._arguments = (
            data.J,
            data.dJ,
            *(view for placement in placements for view in (placement.rotation, placement.translation)),
            *(_columns(model, frame) for frame in self._frames),
            model.mass,
            GRAVITY,
            block.data,
            block.layout,
        )

    def update(self, state: RobotState) -> None:
        """Evaluate everything at one state; the arrays of this object are overwritten."""
        self.q[:] = state.q
        self.v[:] = state.v
        self.call_pinocchio()
        read_terms(self.mass_matrix, self.bias, *self._arguments)

    def call_pinocchio(self) -> None:
        """Run only the Pinocchio algorithms of ``update`` (the benchmark times them alone)."""
        model, data = self._pin, self._data
        pin.computeJointJacobiansTimeVariation(model, data, self.q, self.v)
        pin.crba(model, data, self.q)
        pin.nonLinearEffects(model, data, self.q, self.v)
        for frame in self._frames:
            pin.updateFramePlacement(model, data, frame)


def _columns(model: RobotModel, frame_id: int) -> NDArray[np.int64]:
    """Velocity indices of the joints that move a frame, ascending."""
    joint = model.pin.frames[frame_id].parentJoint
    columns: list[int] = []
    while joint > 0:
        first, count = model.pin.idx_vs[joint], model.pin.nvs[joint]
        columns.extend(range(first, first + count))
        joint = model.pin.parents[joint]
    return np.array(sorted(columns), dtype=np.int64)
