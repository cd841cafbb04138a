"""Compiled measurement update of the right-invariant filter; state and error as in ``kernels_predict``."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from controllers.estimation.kernels_predict import SIZE, retract
from controllers.estimation.so3 import logarithm, multiply, rotate, turn_noise
from models.compiled import njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@njit(cache=True)
def factorise(matrix: Array) -> bool:
    """Cholesky factor in the lower triangle, in place; False when the matrix is not positive definite or not finite."""
    for i in range(matrix.shape[0]):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i == j:
                if not 0.0 < total < np.inf:
                    return False
                matrix[i, i] = math.sqrt(total)
            else:
                matrix[i, j] = total / matrix[j, j]
    return True


@njit(cache=True)
def correct(
    covariance: Array, plus: Index, minus: Index, residual: Array, noise: Array, gate: float, error: Array
) -> float:
    """Kalman gain and Joseph update for measurements that are one error component, or the difference of two.

    ``residual = H xi + n`` with ``H xi = xi[plus] - xi[minus]`` and ``n ~ N(0, noise)``. A residual whose normalised
    square e exceeds the gate has its noise multiplied by sqrt(e / gate): Huber's weight, so that an outlier pulls no
    harder than one at the gate, and a filter that is wrong for another reason still comes back.

    Args:
        covariance: (27, 27), in place.
        plus: Component of each row (m,).
        minus: Component of each row that is subtracted, or -1 (m,).
        residual: (m,).
        noise: Covariance of the measurement (m, m).
        gate: Bound on the normalised innovation squared [-].
        error: Out, estimated error of the state (27,).

    Returns:
        Normalised innovation squared [-], or -1 and nothing changed when the innovation is not finite.
    """
    m = plus.shape[0]
    cross = np.empty((m, SIZE))  # H P
    for r in range(m):
        for j in range(SIZE):
            cross[r, j] = covariance[plus[r], j]
        if minus[r] >= 0:
            for j in range(SIZE):
                cross[r, j] -= covariance[minus[r], j]
    weight = 1.0
    squared = 0.0
    factor = np.empty((m, m))
    white = np.empty(m)
    for _ in range(2):
        for r in range(m):
            for c in range(m):
                prior = cross[r, plus[c]]
                if minus[c] >= 0:
                    prior -= cross[r, minus[c]]
                factor[r, c] = prior + weight * noise[r, c]
        if not factorise(factor):
            return -1.0
        if weight > 1.0:
            break
        for r in range(m):
            total = residual[r]
            for k in range(r):
                total -= factor[r, k] * white[k]
            white[r] = total / factor[r, r]
            squared += white[r] * white[r]
        if squared <= gate:
            break
        # A residual that is not finite makes the weight so too, and the second factorisation refuses it.
        weight = math.sqrt(squared / gate)
    gain = cross.copy()  # K' (m, 27): solve S K' = H P
    for r in range(m):
        for k in range(r):
            for j in range(SIZE):
                gain[r, j] -= factor[r, k] * gain[k, j]
        for j in range(SIZE):
            gain[r, j] /= factor[r, r]
    for r in range(m - 1, -1, -1):
        for k in range(r + 1, m):
            for j in range(SIZE):
                gain[r, j] -= factor[k, r] * gain[k, j]
        for j in range(SIZE):
            gain[r, j] /= factor[r, r]
    # Joseph: M = (I - K H) P, then P <- M (I - K H)' + K N K' = M + (K N - M H') K'.
    for i in range(SIZE):
        for r in range(m):
            pull = gain[r, i]
            for j in range(SIZE):
                covariance[i, j] -= pull * cross[r, j]
    side = np.empty((SIZE, m))
    for i in range(SIZE):
        for r in range(m):
            total = -covariance[i, plus[r]]
            if minus[r] >= 0:
                total += covariance[i, minus[r]]
            for k in range(m):
                total += weight * gain[k, i] * noise[k, r]
            side[i, r] = total
    for i in range(SIZE):
        for r in range(m):
            pull = side[i, r]
            for j in range(SIZE):
                covariance[i, j] += pull * gain[r, j]
    for i in range(SIZE):
        for j in range(i):
            mean = 0.5 * (covariance[i, j] + covariance[j, i])
            covariance[i, j] = mean
            covariance[j, i] = mean
        total = 0.0
        for r in range(m):
            total += gain[r, i] * residual[r]
        error[i] = total
    return squared


@njit(cache=True)
def foot_residual(
    rotation: Array, vectors: Array, sole: Array, foot: int, position: Array, orientation: Array, noise: Array,
    residual: Array, world_noise: Array,
) -> None:  # fmt: skip
    """Innovation of one sole pose: ``R y - (d - p)`` and ``Log(R C Z')``, both in W, and its noise.

    Args:
        rotation: R (3, 3).
        vectors: v, p, d_L, d_R (4, 3).
        sole: Z of the foot (3, 3).
        foot: 0 left, 1 right.
        position: Measured sole origin in the inertial unit's frame, y (3,) [m].
        orientation: Measured rotation of the sole in the same frame, C (3, 3).
        noise: Covariance of the measurement in the sole frame (6, 6).
        residual: Out (6,) [m, rad].
        world_noise: Out, ``noise`` turned into W (6, 6).
    """
    measured = np.empty((3, 3))
    turn = np.empty((3, 3))
    turned = np.empty(3)
    rotate(rotation, position, turned)
    for i in range(3):
        residual[i] = turned[i] - vectors[2 + foot, i] + vectors[1, i]
    multiply(rotation, orientation, measured)
    for i in range(3):
        for j in range(3):
            turn[i, j] = measured[i, 0] * sole[j, 0] + measured[i, 1] * sole[j, 1] + measured[i, 2] * sole[j, 2]
    logarithm(turn, turned)
    for i in range(3):
        residual[3 + i] = turned[i]
    turn_noise(measured, noise, world_noise)


@njit(cache=True)
def correct_soles(
    rotation: Array, vectors: Array, soles: Array, biases: Array, covariance: Array, positions: Array,
    orientations: Array, noises: Array, plus: Index, minus: Index, gate: float, error: Array, innovation: Array,
) -> int:  # fmt: skip
    """Correct the state with the pose of each sole, one after the other.

    Args:
        rotation: R (3, 3), in place.
        vectors: v, p, d_L, d_R (4, 3), in place.
        soles: Z of both feet (2, 3, 3), in place.
        biases: Of gyro and accelerometer (2, 3), in place.
        covariance: See ``correct``, as ``gate`` and ``error``.
        positions: Measured sole origins in the inertial unit's frame (2, 3) [m].
        orientations: Measured rotations of the soles in the same frame (2, 3, 3).
        noises: Covariance of each measurement in the sole frame (2, 6, 6).
        plus: Component of each row of a sole's innovation (6,).
        minus: Component that is subtracted, for each foot (2, 6).
        gate: Bound on the normalised innovation squared [-].
        error: Memory (27,).
        innovation: Out, normalised innovation squared of each foot, -1 where it was unusable (2,) [-].

    Returns:
        How many were unusable.
    """
    residual, noise = np.empty(6), np.empty((6, 6))
    rejected = 0
    for foot in range(2):
        foot_residual(
            rotation, vectors, soles[foot], foot, positions[foot], orientations[foot], noises[foot], residual, noise
        )
        innovation[foot] = correct(covariance, plus, minus[foot], residual, noise, gate, error)
        if innovation[foot] < 0.0:
            rejected += 1
        else:
            retract(rotation, vectors, soles, biases, error)
    return rejected
