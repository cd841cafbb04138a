"""Covariance of the base's pose and twist, from that of the filter's error: the two matrices of nav_msgs/Odometry."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from controllers.estimation.kernels_predict import GYRO_BIAS, POSITION, ROTATION, VELOCITY
from models.compiled import njit

Array = NDArray[np.float64]


@njit(cache=True)
def _skew(x: Array, out: Array) -> None:
    """``out <- [x]x`` (3, 3)."""
    out[0, 0], out[0, 1], out[0, 2] = 0.0, -x[2], x[1]
    out[1, 0], out[1, 1], out[1, 2] = x[2], 0.0, -x[0]
    out[2, 0], out[2, 1], out[2, 2] = -x[1], x[0], 0.0


@njit(cache=True)
def _add_product(jacobian: Array, covariance: Array, out: Array) -> None:
    """``out += J P J'``, exactly symmetric."""
    half = jacobian @ covariance
    for i in range(out.shape[0]):
        for j in range(i, out.shape[1]):
            total = 0.0
            for k in range(half.shape[1]):
                total += half[i, k] * jacobian[j, k]
            out[i, j] += total
            if j != i:
                out[j, i] += total


@njit(cache=True)
def odometry_covariance(
    rotation: Array,
    position: Array,
    covariance: Array,
    imu_rotation: Array,
    imu_position: Array,
    imu_jacobian: Array,
    variances: Array,
    pose: Array,
    twist: Array,
) -> None:
    """Covariances of the base's pose in W and of its twist in B.

    With the right-invariant error xi, the error n_g of the present rate sample, and the errors dq, dv of position and
    velocity of the joints between base and inertial unit (Jacobian J of the unit in its own frame), to first order::

        dtheta_W = xi_R - R_WI J_w dq
        dp_B     = xi_p - [p_B]x xi_R - R_WI (J_v dq + J_w dq x r_IB)
        dw_B     = R_BI (n_g - xi_bg - J_w dv)
        dv_B     = R_BI (R_WI' xi_v - J_v dv) + [r_BI]x dw_B

    dtheta is a rotation about the fixed axes of W (``R_hat = Exp(dtheta) R``). The linear part of the twist knows
    neither attitude nor position: what the filter cannot observe does not enter it.

    Args:
        rotation: R_WI (3, 3).
        position: Origin of the inertial unit in W (3,) [m].
        covariance: Of the error of the filter (27, 27).
        imu_rotation: R_BI (3, 3).
        imu_position: Origin of the inertial unit in B, r_BI (3,) [m].
        imu_jacobian: J (6, k); k may be 0.
        variances: Of a joint position, a joint velocity and one sample of the rate (3,) [rad^2, (rad/s)^2, (rad/s)^2].
        pose: Out, of x, y, z and the rotation about X, Y, Z of W (6, 6) [m, rad].
        twist: Out, linear then angular, in B (6, 6) [m/s, rad/s].

    Assumptions:
        The errors of joints and rate sample are independent of xi, and an error of a joint position, times the speed
        of the robot, is too small to count in the twist (0.3 mrad at 1 m/s: 0.3 mm/s).
    """
    base = rotation @ imu_rotation.T  # R_WB
    lever = base @ imu_position  # of the unit, seen from the base, in W
    skew = np.empty((3, 3))
    jacobian = np.zeros((6, 9))  # of the pose, by xi_R, xi_v, xi_p
    _skew(position - lever, skew)
    for i in range(3):
        jacobian[i, POSITION + i] = 1.0
        jacobian[3 + i, ROTATION + i] = 1.0
        for j in range(3):
            jacobian[i, ROTATION + j] = -skew[i, j]
    pose[:] = 0.0
    _add_product(jacobian, covariance[:9, :9].copy(), pose)

    columns = np.empty(6, dtype=np.int64)  # of xi_v and xi_bg
    for i in range(3):
        columns[i], columns[3 + i] = VELOCITY + i, GYRO_BIAS + i
    block = np.empty((6, 6))
    for i in range(6):
        for j in range(6):
            block[i, j] = covariance[columns[i], columns[j]]
    for i in range(3):
        block[3 + i, 3 + i] += variances[2]  # n_g enters as -xi_bg does
    _skew(imu_position, skew)
    turned = skew @ imu_rotation
    from_unit = np.zeros((6, 6))  # twist of B by an error of the unit's twist in its own frame
    from_unit[:3, :3] = imu_rotation
    from_unit[:3, 3:] = turned
    from_unit[3:, 3:] = imu_rotation
    jacobian = np.zeros((6, 6))
    jacobian[:3, :3] = imu_rotation @ rotation.T
    jacobian[:3, 3:] = -turned
    jacobian[3:, 3:] = -imu_rotation
    twist[:] = 0.0
    _add_product(jacobian, block, twist)

    count = imu_jacobian.shape[1]
    if count > 0:
        noise = np.eye(count)
        moved = from_unit @ imu_jacobian
        _add_product(moved, variances[1] * noise, twist)
        _skew(-(imu_rotation.T @ imu_position), skew)  # r_IB
        moved[:3] = rotation @ (imu_jacobian[:3] - skew @ imu_jacobian[3:])
        moved[3:] = rotation @ imu_jacobian[3:]
        _add_product(moved, variances[0] * noise, pose)
