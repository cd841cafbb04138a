"""Compiled kinematics: sole poses relative to the inertial unit, and the base from the inertial unit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from controllers.estimation.so3 import exponential, multiply, rotate, rotate_transposed, to_quaternion
from models.compiled import njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@njit(cache=True)
def chain_pose(
    q: Array,
    columns: Index,
    rotations: Array,
    translations: Array,
    axes: Array,
    rotation: Array,
    position: Array,
    jacobian: Array,
) -> None:
    """Forward kinematics of one chain and its Jacobian in the end frame.

    Args:
        q: Joint positions (nj,) [rad].
        columns: Index of each joint in ``q``, from the base outwards (n,).
        rotations: Rotation of each joint frame at zero in the previous one, then of the end frame (n + 1, 3, 3).
        translations: Origin of the same in the previous one (n + 1, 3) [m].
        axes: Unit axis of each joint in its own frame (n, 3).
        rotation: Out, rotation of the end frame in the base (3, 3).
        position: Out, its origin in the base (3,) [m].
        jacobian: Out, velocity of the end frame in the end frame per joint rate, linear then angular (6, n).
    """
    count = columns.shape[0]
    origins = np.empty((count, 3))
    directions = np.empty((count, 3))
    turn = np.empty((3, 3))
    work = np.empty((3, 3))
    step = np.empty(3)
    for i in range(3):
        position[i] = translations[0, i]
        for j in range(3):
            rotation[i, j] = rotations[0, i, j]
    for n in range(count):
        rotate(rotation, axes[n], directions[n])
        origins[n] = position
        for i in range(3):
            step[i] = axes[n, i] * q[columns[n]]
        exponential(step, turn)
        multiply(rotation, turn, work)
        rotate(work, translations[n + 1], step)
        for i in range(3):
            position[i] += step[i]
        multiply(work, rotations[n + 1], rotation)
    for n in range(count):
        x, y, z = position[0] - origins[n, 0], position[1] - origins[n, 1], position[2] - origins[n, 2]
        a, b, c = directions[n, 0], directions[n, 1], directions[n, 2]
        step[0], step[1], step[2] = b * z - c * y, c * x - a * z, a * y - b * x
        for i in range(3):
            jacobian[i, n] = rotation[0, i] * step[0] + rotation[1, i] * step[1] + rotation[2, i] * step[2]
            jacobian[i + 3, n] = rotation[0, i] * a + rotation[1, i] * b + rotation[2, i] * c


@njit(cache=True)
def relative_pose(
    imu_rotation: Array,
    imu_position: Array,
    imu_jacobian: Array,
    sole_rotation: Array,
    sole_position: Array,
    sole_jacobian: Array,
    variance: float,
    position_floor: float,
    rotation_floor: float,
    rotation: Array,
    position: Array,
    covariance: Array,
) -> None:
    """Sole relative to the inertial unit, and the covariance that encoder noise gives it.

    With ``T = T_BI^-1 T_BS`` and local Jacobians, ``dT = J_S dq_S - Ad(T^-1) J_I dq_I``, both in the sole frame, so
    ``N = s^2 (J_S J_S' + Ad J_I J_I' Ad') + diag(floors)``.

    Args:
        imu_rotation: R_BI (3, 3).
        imu_position: Origin of the inertial unit in the base (3,) [m].
        imu_jacobian: Local Jacobian of the inertial unit (6, n); n may be 0.
        sole_rotation: R_BS (3, 3).
        sole_position: Origin of the sole in the base (3,) [m].
        sole_jacobian: Local Jacobian of the sole (6, n).
        variance: Of one joint position [rad^2].
        position_floor: Variance of the model error of the position [m^2].
        rotation_floor: Variance of the model error of the orientation [rad^2].
        rotation: Out, C = R_IS (3, 3).
        position: Out, origin of the sole in the inertial unit's frame (3,) [m].
        covariance: Out, of the error in the sole frame, linear then angular (6, 6) [m^2, m.rad, rad^2].
    """
    offset = np.empty(3)
    for i in range(3):
        offset[i] = sole_position[i] - imu_position[i]
    rotate_transposed(imu_rotation, offset, position)
    for i in range(3):
        for j in range(3):
            rotation[i, j] = (
                imu_rotation[0, i] * sole_rotation[0, j]
                + imu_rotation[1, i] * sole_rotation[1, j]
                + imu_rotation[2, i] * sole_rotation[2, j]
            )
    for i in range(6):
        for j in range(i, 6):
            total = 0.0
            for k in range(sole_jacobian.shape[1]):
                total += sole_jacobian[i, k] * sole_jacobian[j, k]
            covariance[i, j] = variance * total
    column = np.empty(6)
    lever = np.empty(3)
    for k in range(imu_jacobian.shape[1]):
        # Twist of the unit seen at the sole: linear v + w x p, then both turned into the sole frame.
        a, b, c = imu_jacobian[3, k], imu_jacobian[4, k], imu_jacobian[5, k]
        lever[0] = imu_jacobian[0, k] + b * position[2] - c * position[1]
        lever[1] = imu_jacobian[1, k] + c * position[0] - a * position[2]
        lever[2] = imu_jacobian[2, k] + a * position[1] - b * position[0]
        for i in range(3):
            column[i] = rotation[0, i] * lever[0] + rotation[1, i] * lever[1] + rotation[2, i] * lever[2]
            column[i + 3] = rotation[0, i] * a + rotation[1, i] * b + rotation[2, i] * c
        for i in range(6):
            for j in range(i, 6):
                covariance[i, j] += variance * column[i] * column[j]
    for i in range(3):
        covariance[i, i] += position_floor
        covariance[i + 3, i + 3] += rotation_floor
    for i in range(6):
        for j in range(i):
            covariance[i, j] = covariance[j, i]


@njit(cache=True)
def base_state(
    rotation: Array,
    vectors: Array,
    biases: Array,
    imu: Array,
    joints: Array,
    imu_rotation: Array,
    imu_position: Array,
    imu_jacobian: Array,
    imu_columns: Index,
    q: Array,
    v: Array,
) -> None:
    """Configuration and velocity in Pinocchio's order, from the filter's state of the inertial unit.

    Args:
        rotation: R_WI (3, 3).
        vectors: Velocity and position of the inertial unit in W first (4, 3).
        biases: Gyro first (2, 3) [rad/s].
        imu: Measured rate and specific force (2, 3).
        joints: Positions, velocities, torques (3, nj).
        imu_rotation: R_BI (3, 3).
        imu_position: Origin of the inertial unit in the base (3,) [m].
        imu_jacobian: Local Jacobian of the inertial unit (6, n); n may be 0.
        imu_columns: Joints between base and inertial unit (n,).
        q: Out (7 + nj,).
        v: Out, base twist in the base frame first (6 + nj,).
    """
    base = np.empty((3, 3))
    turned = np.empty(3)
    twist = np.empty((2, 3))  # of the inertial unit in its own frame, joint motion taken off: linear, angular
    for i in range(3):
        for j in range(3):
            base[i, j] = (
                rotation[i, 0] * imu_rotation[j, 0]
                + rotation[i, 1] * imu_rotation[j, 1]
                + rotation[i, 2] * imu_rotation[j, 2]
            )
    rotate(base, imu_position, turned)
    for i in range(3):
        q[i] = vectors[1, i] - turned[i]
    to_quaternion(base, q[3:7])
    rotate_transposed(rotation, vectors[0], twist[0])
    for i in range(3):
        twist[1, i] = imu[0, i] - biases[0, i]
    for k in range(imu_columns.shape[0]):
        speed = joints[1, imu_columns[k]]
        for i in range(3):
            twist[0, i] -= imu_jacobian[i, k] * speed
            twist[1, i] -= imu_jacobian[i + 3, k] * speed
    rotate(imu_rotation, twist[0], v[0:3])
    rotate(imu_rotation, twist[1], v[3:6])
    v[0] -= v[4] * imu_position[2] - v[5] * imu_position[1]
    v[1] -= v[5] * imu_position[0] - v[3] * imu_position[2]
    v[2] -= v[3] * imu_position[1] - v[4] * imu_position[0]
    for i in range(joints.shape[1]):
        q[7 + i] = joints[0, i]
        v[6 + i] = joints[1, i]
