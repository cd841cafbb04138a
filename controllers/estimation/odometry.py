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
def base_covariance(
    rotation: Array,
    position: Array,
    covariance: Array,
    imu_rotation: Array,
    imu_position: Array,
    imu_jacobian: Array,
    variances: Array,
    out: Array,
) -> None:
    """Joint covariance of the base's pose in W and its twist in B.

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
        out: Out, of x, y, z, the rotation about X, Y, Z of W, and the twist in B, linear then angular (12, 12)
            [m, rad, m/s, rad/s].

    Assumptions:
        The errors of joints and rate sample are independent of xi, and an error of a joint position, times the speed
        of the robot, is too small to count in the twist (0.3 mrad at 1 m/s: 0.3 mm/s).
    """
    base = rotation @ imu_rotation.T  # R_WB
    skew = np.empty((3, 3))
    columns = np.empty(12, dtype=np.int64)  # of xi_R, xi_v, xi_p, xi_bg
    jacobian = np.zeros((12, 12))
    for i in range(3):
        columns[i], columns[3 + i] = ROTATION + i, VELOCITY + i
        columns[6 + i], columns[9 + i] = POSITION + i, GYRO_BIAS + i
        jacobian[i, 6 + i] = 1.0
        jacobian[3 + i, i] = 1.0
    _skew(position - base @ imu_position, skew)  # of the base in W
    jacobian[:3, :3] = -skew
    _skew(imu_position, skew)
    turned = skew @ imu_rotation
    jacobian[6:9, 3:6] = imu_rotation @ rotation.T
    jacobian[6:9, 9:] = -turned
    jacobian[9:, 9:] = -imu_rotation
    block = np.empty((12, 12))
    for i in range(12):
        for j in range(12):
            block[i, j] = covariance[columns[i], columns[j]]
    for i in range(9, 12):
        block[i, i] += variances[2]  # n_g enters the twist as -xi_bg does, and nothing else
    out[:] = 0.0
    _add_product(jacobian, block, out)

    count = imu_jacobian.shape[1]
    if count > 0:
        moved = np.zeros((12, 2 * count))  # by the positions of the joints, then by their velocities
        linear, angular = imu_jacobian[:3].copy(), imu_jacobian[3:].copy()
        moved[6:9, count:] = imu_rotation @ linear + turned @ angular
        moved[9:, count:] = imu_rotation @ angular
        _skew(-(imu_rotation.T @ imu_position), skew)  # r_IB
        moved[:3, :count] = rotation @ (linear - skew @ angular)
        moved[3:6, :count] = rotation @ angular
        noise = np.zeros((2 * count, 2 * count))
        for i in range(count):
            noise[i, i], noise[count + i, count + i] = variances[0], variances[1]
        _add_product(moved, noise, out)
