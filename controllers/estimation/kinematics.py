"""Pose of both soles relative to the inertial unit, with Jacobians: the kinematic measurement of the filter.

Pinocchio's model is read once, when the law is built; the two or three short chains that matter are then walked by
one compiled kernel, which costs a tenth of the calls into Pinocchio (a test holds it to Pinocchio's answers).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from controllers.estimation.kernels_kinematics import chain_pose, relative_pose
from models.errors import RobotModelError
from models.robot_model import RobotModel
from models.types import Vector

Index = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Chain:
    """Revolute joints from the base to one frame.

    Attributes:
        columns: Index of each joint in the joint vector, from the base outwards (k,).
        rotations: Rotation of each joint frame at zero in the previous one, then of the frame itself (k + 1, 3, 3).
        translations: Origin of the same in the previous one (k + 1, 3) [m].
        axes: Unit axis of each joint in its own frame (k, 3).
    """

    columns: Index
    rotations: NDArray[np.float64]
    translations: NDArray[np.float64]
    axes: NDArray[np.float64]

    @classmethod
    def to_frame(cls, model: pin.Model, frame_id: int) -> Chain:
        """Read the chain to an operational frame off Pinocchio's model.

        Args:
            model: Free flyer first, then revolute joints.
            frame_id: The frame.

        Raises:
            RobotModelError: A joint on the way is not revolute; names it.
        """
        frame = model.frames[frame_id]
        joint = frame.parentJoint
        path: list[int] = []
        while joint > 1:
            path.insert(0, joint)
            joint = model.parents[joint]
        data = model.createData()
        neutral = pin.neutral(model)
        placements = [model.jointPlacements[j] for j in path] + [frame.placement]
        axes = []
        for j in path:
            subspace = pin.computeJointJacobian(model, data, neutral, j)[:, model.idx_vs[j]]
            if model.nvs[j] != 1 or np.abs(subspace[:3]).max() > 1e-12:
                raise RobotModelError(f"joint '{model.names[j]}' on the way to '{frame.name}' is not revolute")
            axes.append(subspace[3:])
        return cls(
            columns=np.array([model.idx_vs[j] - 6 for j in path], dtype=np.int64),
            rotations=np.ascontiguousarray([np.array(placement.rotation) for placement in placements]),
            translations=np.ascontiguousarray([np.array(placement.translation) for placement in placements]),
            axes=np.ascontiguousarray(np.array(axes, dtype=np.float64).reshape(-1, 3)),
        )


class SoleKinematics:
    """Kinematic measurement of the filter: where each sole is, seen from the inertial unit.

    Attributes:
        rotations: Rotation of each sole in the inertial unit's frame (2, 3, 3).
        positions: Its origin in the same (2, 3) [m].
        covariances: Of the error, in each sole frame, linear then angular (2, 6, 6).
        imu_rotation: R_BI (3, 3).
        imu_position: Origin of the inertial unit in the base frame (3,) [m].
        imu_jacobian: Local Jacobian of the inertial unit (6, k); k = 0 when it sits on the base.
        imu_columns: Joints between base and inertial unit (k,).

    Args:
        model: The robot.
        encoder: Standard deviation of one joint position [rad].
        position: Standard deviation of the model error of a sole position [m].
        orientation: Standard deviation of the model error of a sole orientation [rad].

    Raises:
        RobotModelError: A joint on the way to a sole or the inertial unit is not revolute, or moves both.
    """

    def __init__(self, model: RobotModel, *, encoder: float, position: float, orientation: float) -> None:
        self._variances = (encoder**2, position**2, orientation**2)
        self._imu = Chain.to_frame(model.pin, model.frame_id("imu"))
        self._soles = tuple(Chain.to_frame(model.pin, foot.frame_id) for foot in model.feet)
        for foot, chain in zip(model.feet, self._soles, strict=True):
            shared = sorted(set(chain.columns.tolist()) & set(self._imu.columns.tolist()))
            if shared:
                raise RobotModelError(
                    f"joint '{model.joint_names[shared[0]]}' moves both the {foot.name} sole and the inertial unit"
                )
        self.imu_rotation = np.eye(3)
        self.imu_position = np.zeros(3)
        self.imu_jacobian = np.zeros((6, self._imu.columns.size))
        self.imu_columns = self._imu.columns
        self._rotations = np.zeros((2, 3, 3))
        self._positions = np.zeros((2, 3))
        self._jacobians = tuple(np.zeros((6, chain.columns.size)) for chain in self._soles)
        self.rotations = np.zeros((2, 3, 3))
        self.positions = np.zeros((2, 3))
        self.covariances = np.zeros((2, 6, 6))
        self.update(np.zeros(model.nj))

    def update(self, q: Vector) -> None:
        """Compute everything at joint positions (nj,) [rad]."""
        imu = self._imu
        chain_pose(
            q, imu.columns, imu.rotations, imu.translations, imu.axes,
            self.imu_rotation, self.imu_position, self.imu_jacobian,
        )  # fmt: skip
        for i in range(2):
            sole = self._soles[i]
            chain_pose(
                q, sole.columns, sole.rotations, sole.translations, sole.axes,
                self._rotations[i], self._positions[i], self._jacobians[i],
            )  # fmt: skip
            relative_pose(
                self.imu_rotation, self.imu_position, self.imu_jacobian,
                self._rotations[i], self._positions[i], self._jacobians[i],
                *self._variances, self.rotations[i], self.positions[i], self.covariances[i],
            )  # fmt: skip
