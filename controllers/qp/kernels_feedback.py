"""Compiled feedback terms: small vector laws whose NumPy form would cost more than the QP."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controllers.qp.kernels_terms import rotation_error

Array = NDArray[np.float64]


@njit(cache=True)
def proportional_derivative(
    feedforward: Array,
    kp: Array,
    wanted: Array,
    measured: Array,
    kd: Array,
    wanted_rate: Array,
    measured_rate: Array,
    out: Array,
) -> None:
    """``out = feedforward + kp (wanted - measured) + kd (wanted_rate - measured_rate)``, all (k,)."""
    for i in range(out.shape[0]):
        out[i] = feedforward[i] + kp[i] * (wanted[i] - measured[i]) + kd[i] * (wanted_rate[i] - measured_rate[i])


@njit(cache=True)
def orientation_feedback(
    rotation: Array, wanted: Array, rate: Array, kp: Array, kd: Array, error: Array, out: Array
) -> None:
    """``out = kp log(R' R_ref) - kd w`` in the moving frame; the error is written too.

    Args:
        rotation: R, the upper left (3, 3) of any larger matrix.
        wanted: R_ref (3, 3).
        rate: Angular velocity in the moving frame (3,).
        kp: Gains (3,).
        kd: Gains (3,).
        error: Out, rotation vector (3,).
        out: Out (3,).
    """
    rotation_error(rotation, wanted, error)
    for i in range(3):
        out[i] = kp[i] * error[i] - kd[i] * rate[i]


@njit(cache=True)
def pose_error(pose: Array, rotation: Array, position: Array, out: Array) -> None:
    """Position and rotation from a frame to a wanted pose, in the frame (6,).

    Args:
        pose: Homogeneous transform of the frame in W (4, 4).
        rotation: Wanted rotation in W (3, 3).
        position: Wanted origin in W (3,).
        out: Out (6,).
    """
    for i in range(3):
        total = 0.0
        for k in range(3):
            total += pose[k, i] * (position[k] - pose[k, 3])
        out[i] = total
    rotation_error(pose, rotation, out[3:])


@njit(cache=True)
def foothold_feedback(
    pose: Array, twist: Array, rotation: Array, position: Array, stiffness: float, damping: float, out: Array
) -> None:
    """Acceleration that draws a planted sole to its foothold: ``stiffness * error - damping * twist`` (6,)."""
    pose_error(pose, rotation, position, out)
    for i in range(6):
        out[i] = stiffness * out[i] - damping * twist[i]


@njit(cache=True)
def joint_bounds(
    q: Array,
    v: Array,
    q_low: Array,
    q_high: Array,
    v_max: Array,
    position_gain: float,
    velocity_gain: float,
    largest: float,
    lower: Array,
    upper: Array,
) -> None:
    """Acceleration bounds from position and velocity limits.

    With ``v_hi = clip(g (q_high - q), -v_max, v_max)``: ``a <= clip(k (v_hi - v), -largest, largest)``; below likewise.

    Args:
        q: Joint state (nj,).
        v: Joint state (nj,).
        q_low: Position limits less their margin (nj,).
        q_high: Position limits less their margin (nj,).
        v_max: Usable speed (nj,).
        position_gain: g [1/s].
        velocity_gain: k [1/s].
        largest: Largest bound [rad/s^2].
        lower: Out (nj,).
        upper: Out (nj,).
    """
    for i in range(q.shape[0]):
        fastest = min(max(position_gain * (q_high[i] - q[i]), -v_max[i]), v_max[i])
        slowest = min(max(position_gain * (q_low[i] - q[i]), -v_max[i]), v_max[i])
        upper[i] = min(max(velocity_gain * (fastest - v[i]), -largest), largest)
        lower[i] = min(max(velocity_gain * (slowest - v[i]), -largest), largest)


@njit(cache=True)
def integrate_joints(
    q: Array, v: Array, acceleration: Array, ahead: float, q_low: Array, q_high: Array, q_out: Array, v_out: Array
) -> None:
    """Joint positions, kept inside the limits, and velocities after a look-ahead at constant acceleration (nj,)."""
    for i in range(q.shape[0]):
        step = ahead * acceleration[i]
        q_out[i] = min(max(q[i] + ahead * (v[i] + 0.5 * step), q_low[i]), q_high[i])
        v_out[i] = v[i] + step


@njit(cache=True, fastmath={"reassoc"})
def all_finite(matrix: Array, vector: Array, rows: Array) -> bool:
    """Whether a QP's Hessian, gradient and rows hold neither NaN nor infinity (a sum shows either)."""
    total = 0.0
    for i in range(matrix.shape[0]):
        total += vector[i]
        for j in range(matrix.shape[1]):
            total += matrix[i, j]
    for i in range(rows.shape[0]):
        for j in range(rows.shape[1]):
            total += rows[i, j]
    return bool(np.isfinite(total))
