"""Residuals and Jacobians of the closed chain through both soles, one window at a time."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from models.robot_model import RobotModel
from models.types import Matrix, Vector

PLACEMENT = 3
"""Unknowns of the placement of the right sole in the left one: x, y [m], yaw [rad]; both lie on one level floor."""

MOUNTING = 6
"""Unknowns of the inertial unit: rotation vector of its mounting (3) [rad], accelerometer bias (3) [m/s^2]."""


class ChainTerms:
    """Where the right sole is in the left one, and what the accelerometer reads, as functions of the unknowns.

    Unknowns: x = (offsets of the joints between the soles and the inertial unit (k), placement (3), mounting (6)).

    Args:
        model: The robot.

    Attributes:
        joints: Indices of those joints in a joint vector, ascending.
        size: Number of unknowns.
    """

    def __init__(self, model: RobotModel) -> None:
        self._model, self._data = model, model.data()
        self._feet = [foot.frame_id for foot in model.feet]
        self._imu = model.frame_id("imu")
        used: set[int] = set()
        for frame in (*self._feet, self._imu):
            chain = model.pin.supports[model.pin.frames[frame].parentJoint]
            used |= {int(model.pin.joints[j].idx_v) - 6 for j in chain if j > 1}
        self.joints = np.array(sorted(used))
        self.size = self.joints.size + PLACEMENT + MOUNTING
        self._q = pin.neutral(model.pin)

    def update(self, q: Vector, x: Vector) -> None:
        """Set measured joint positions (nj,) [rad] and the unknowns."""
        self._q[7:] = q
        self._q[7 + self.joints] -= x[: self.joints.size]
        pin.computeJointJacobians(self._model.pin, self._data, self._q)
        pin.updateFramePlacements(self._model.pin, self._data)

    def _frame(self, frame: int) -> tuple[pin.SE3, Matrix]:
        """Pose in the base, and minus its local Jacobian with respect to the offsets (6, k)."""
        jacobian = pin.getFrameJacobian(self._model.pin, self._data, frame, pin.LOCAL)
        return self._data.oMf[frame], -jacobian[:, 6 + self.joints]

    def placement(self) -> pin.SE3:
        """Right sole in the left one."""
        left, right = (self._data.oMf[frame] for frame in self._feet)
        return left.actInv(right)

    def closure(self, x: Vector) -> tuple[Vector, Matrix]:
        """Error of the right sole against its placement, e = log(T(x)^-1 L^-1 R) (6,), and de/dx (6, n) [m, rad]."""
        k = self.joints.size
        (left, left_jacobian), (right, right_jacobian) = (self._frame(frame) for frame in self._feet)
        relative = left.actInv(right)
        placed = pin.SE3(pin.utils.rotate("z", x[k + 2]), np.array([x[k], x[k + 1], 0.0]))
        error = placed.actInv(relative)
        jacobian = np.zeros((6, self.size))
        jacobian[:, :k] = right_jacobian - relative.toActionMatrixInverse() @ left_jacobian
        moved = np.zeros((6, PLACEMENT))
        moved[:2, :2] = placed.rotation[:2, :2].T
        moved[5, 2] = 1.0
        jacobian[:, k : k + PLACEMENT] = -error.toActionMatrixInverse() @ moved
        return pin.log6(error).vector, pin.Jlog6(error) @ jacobian

    def imu_position(self) -> Vector:
        """Origin of the inertial unit in the left sole's frame (3,) [m]."""
        left, imu = self._data.oMf[self._feet[0]], self._data.oMf[self._imu]
        return np.asarray(left.actInv(imu).translation)

    def force(self, x: Vector, measured: Vector, expected: Vector) -> tuple[Vector, Matrix]:
        """Predicted minus measured specific force (3,) [m/s^2], and its Jacobian (3, n).

        Args:
            x: Unknowns (n,).
            measured: In the frame of the unit (3,) [m/s^2].
            expected: In the left sole's frame, which is level: acceleration and gravity (3,) [m/s^2].
        """
        k = self.joints.size
        left, left_jacobian = self._frame(self._feet[0])
        imu, imu_jacobian = self._frame(self._imu)
        relative = left.rotation.T @ imu.rotation
        turn = pin.exp3(x[k + PLACEMENT : k + PLACEMENT + 3])
        up = relative.T @ expected  # in the nominal frame of the unit
        force = turn.T @ up
        jacobian = np.zeros((3, self.size))
        spin = imu_jacobian[3:] - relative.T @ left_jacobian[3:]
        jacobian[:, :k] = turn.T @ pin.skew(up) @ spin
        jacobian[:, k + PLACEMENT : k + PLACEMENT + 3] = pin.skew(force) @ pin.Jexp3(x[k + PLACEMENT : -3])
        jacobian[:, -3:] = np.eye(3)
        return force + x[-3:] - measured, jacobian
