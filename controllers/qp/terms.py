"""Every model term that one tick needs, updated once and shared by tasks, contacts and assembly."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from controllers.memory import Block
from controllers.qp.kernels_read import TERMS, read_terms
from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.types import Matrix, RobotState, Vector

_WORLD = pin.Convention.WORLD


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
        frames = ((3, 4, 4), (3, 6, nv), (3, 6), (3, 6), (3, 3, 4))
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
        views = []
        for k, frame_id in enumerate(self._frames):
            frame = model.pin.frames[frame_id]
            placement, acceleration = data.oMf[frame_id], data.a_gf[frame.parentJoint]
            views += [placement.rotation, placement.translation, acceleration.linear, acceleration.angular]
            block["offset"][k] = frame.placement.homogeneous[:3]
        self._arguments = (
            data.J,
            *views,
            _columns(model, self._frames),
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
        pin.crba(model, data, self.q, _WORLD)  # also J and the placements of the joints
        pin.nonLinearEffects(model, data, self.q, self.v)  # also the accelerations of the bodies at zero a
        for frame in self._frames:
            pin.updateFramePlacement(model, data, frame)


def _columns(model: RobotModel, frames: tuple[int, ...]) -> NDArray[np.int64]:
    """Velocity indices of the joints that move each frame, filled up with -1 (frames, nv)."""
    columns = np.full((len(frames), model.nv), -1, dtype=np.int64)
    for row, frame_id in zip(columns, frames, strict=True):
        joint, used = model.pin.frames[frame_id].parentJoint, 0
        while joint > 0:
            first, count = model.pin.idx_vs[joint], model.pin.nvs[joint]
            row[used : used + count] = np.arange(first, first + count)
            joint, used = model.pin.parents[joint], used + count
    return columns
