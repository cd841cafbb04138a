"""Compiled kernels of the right-invariant filter: prediction, correction, retraction; see ``docs/estimation.md``."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.numerics.cholesky import factorise, solve_factored
from models.numerics.compiled import njit
from models.numerics.so3 import exponential, left_jacobian, logarithm, multiply, orthonormalise, rotate, turn_noise

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SIZE = 27
#: First index of each block of the error; feet and soles have six entries, left then right
ROTATION, VELOCITY, POSITION, FOOT, SOLE, GYRO_BIAS, ACCEL_BIAS = 0, 3, 6, 9, 15, 21, 24
_FOOT_PLUS = np.array([POSITION, POSITION + 1, POSITION + 2, ROTATION, ROTATION + 1, ROTATION + 2])
_FOOT_MINUS = np.array(
    [[FOOT, FOOT + 1, FOOT + 2, SOLE, SOLE + 1, SOLE + 2], [FOOT + 3, FOOT + 4, FOOT + 5, SOLE + 3, SOLE + 4, SOLE + 5]]
)


class FilterState(NamedTuple):
    """State of IMU and soles in W, and biases; the error (27,) is right-invariant, for the biases ``b_hat - b``."""

    rotation: Array  # R (3, 3)
    vectors: Array  # velocity v and position p of the IMU, origins of both soles d_L, d_R (4, 3) [m/s, m]
    soles: Array  # rotations of both soles, Z_L, Z_R (2, 3, 3)
    biases: Array  # gyro b_g, accelerometer b_a (2, 3) [rad/s, m/s^2]
    covariance: Array  # of the error [R, v, p, d_L, d_R, Z_L, Z_R, b_g, b_a] (27, 27)
    innovation: Array  # normalised innovation squared of each foot's last update, -1 if unusable (2,) [-]
    standing: Array  # time for which each foot has been flat on the ground (2,) [s]
    bore: Array  # 1 for a foot that has been fully loaded since the start, else 0 (2,)
    bearing: Array  # time for which each foot has been in stance (2,) [s]

    @classmethod
    def zero(cls) -> FilterState:
        """State at the origin, with an identity covariance."""
        soles = np.tile(np.eye(3), (2, 1, 1))
        return cls(
            np.eye(3), np.zeros((4, 3)), soles, np.zeros((2, 3)), np.eye(SIZE), np.zeros(2), np.full(2, math.inf),
            np.zeros(2), np.zeros(2),
        )  # fmt: skip

    def copy(self) -> FilterState:
        """A deep copy."""
        return FilterState(*(array.copy() for array in self))


class ProcessNoise(NamedTuple):
    """Noise of one step."""

    pivots: Array  # point about which each sole turns, in its frame (2, 2) [m]
    feet: Array  # variances of horizontal position, height, tilt and heading of each foot (2, 4) [m^2, rad^2]
    imu: Array  # variances of angle, velocity, gyro bias and accelerometer bias (4,)
    wander: Array  # covariance of the drift of the sole pose errors, in each sole frame (2, 6, 6)


class SolePoses(NamedTuple):
    """Measurement of the filter: sole poses in the IMU frame."""

    rotations: Array  # (2, 3, 3)
    positions: Array  # (2, 3) [m]
    covariances: Array  # of the error, in each sole frame, linear then angular (2, 6, 6) [m^2, m.rad, rad^2]


@njit(cache=True)
def _skew_times(x: Array, matrix: Array, scale: float, out: Array) -> None:
    """``out += scale [x]x matrix`` (3, 3)."""
    for j in range(3):
        a, b, c = matrix[0, j], matrix[1, j], matrix[2, j]
        out[0, j] += scale * (x[1] * c - x[2] * b)
        out[1, j] += scale * (x[2] * a - x[0] * c)
        out[2, j] += scale * (x[0] * b - x[1] * a)


@njit(cache=True)
def _add_rows(matrix: Array, row: int, source: int, block: Array) -> None:
    """``matrix[row:row+3] += block matrix[source:source+3]``."""
    for i in range(3):
        a, b, c = block[i, 0], block[i, 1], block[i, 2]
        for j in range(matrix.shape[1]):
            matrix[row + i, j] += a * matrix[source, j] + b * matrix[source + 1, j] + c * matrix[source + 2, j]


@njit(cache=True)
def apply_transition(rotation: Array, vectors: Array, dt: float, gravity: float, matrix: Array) -> None:
    """``matrix <- Phi matrix`` (27, k), with Phi the transition of the error over ``dt``.

    ``rotation`` is R (3, 3); ``vectors`` are v, p, d_L, d_R (4, 3); R, v and p are in the middle of the step. The
    blocks are multiplied in place, starting with the block that depends on most others.
    """
    pull = np.zeros((3, 3))  # [g]x, g = (0, 0, -gravity)
    pull[0, 1], pull[1, 0] = gravity, -gravity
    pull_rotation = np.zeros((3, 3))  # [g]x R
    for j in range(3):
        pull_rotation[0, j], pull_rotation[1, j] = gravity * rotation[1, j], -gravity * rotation[0, j]
    half, sixth = 0.5 * dt * dt, dt * dt * dt / 6.0
    block = np.empty((3, 3))

    for j in range(matrix.shape[1]):
        for i in range(3):
            matrix[POSITION + i, j] += dt * matrix[VELOCITY + i, j]
    block[:] = half * pull
    _add_rows(matrix, POSITION, ROTATION, block)
    block[:] = -sixth * pull_rotation
    _skew_times(vectors[1], rotation, -dt, block)
    _skew_times(vectors[0], rotation, -half, block)
    _add_rows(matrix, POSITION, GYRO_BIAS, block)
    block[:] = -half * rotation
    _add_rows(matrix, POSITION, ACCEL_BIAS, block)

    block[:] = dt * pull
    _add_rows(matrix, VELOCITY, ROTATION, block)
    block[:] = -half * pull_rotation
    _skew_times(vectors[0], rotation, -dt, block)
    _add_rows(matrix, VELOCITY, GYRO_BIAS, block)
    block[:] = -dt * rotation
    _add_rows(matrix, VELOCITY, ACCEL_BIAS, block)

    for foot in range(2):
        block[:] = 0.0
        _skew_times(vectors[2 + foot], rotation, -dt, block)
        _add_rows(matrix, FOOT + 3 * foot, GYRO_BIAS, block)

    block[:] = -dt * rotation
    _add_rows(matrix, ROTATION, GYRO_BIAS, block)


@njit(cache=True)
def add_process_noise(vectors: Array, soles: Array, covariance: Array, noise: ProcessNoise) -> None:
    """Add the noise of a step to the covariance (27, 27); ``vectors`` v, p, d (4, 3), ``soles`` Z (2, 3, 3)."""
    gain = np.zeros((15, 3))  # [I; [v]x; [p]x; [d_L]x; [d_R]x]: gyro noise in the right-invariant error
    for i in range(3):
        gain[i, i] = 1.0
    for k in range(4):
        x, y, z = vectors[k, 0], vectors[k, 1], vectors[k, 2]
        row = 3 + 3 * k
        gain[row, 1], gain[row, 2] = -z, y
        gain[row + 1, 0], gain[row + 1, 2] = z, -x
        gain[row + 2, 0], gain[row + 2, 1] = -y, x
    for i in range(15):
        for j in range(15):
            product = gain[i, 0] * gain[j, 0] + gain[i, 1] * gain[j, 1] + gain[i, 2] * gain[j, 2]
            covariance[i, j] += noise.imu[0] * product
    for i in range(3):
        covariance[VELOCITY + i, VELOCITY + i] += noise.imu[1]
        covariance[GYRO_BIAS + i, GYRO_BIAS + i] += noise.imu[2]
        covariance[ACCEL_BIAS + i, ACCEL_BIAS + i] += noise.imu[3]
    lever = np.zeros((3, 3))  # [r]x, r = sole origin minus pivot in W
    r = np.empty(3)
    turn, slow = np.empty(3), np.empty((6, 6))
    for foot in range(2):
        d, z = FOOT + 3 * foot, SOLE + 3 * foot
        for i in range(3):
            turn[i] = noise.feet[foot, 3 if i == 2 else 2]
            r[i] = -soles[foot, i, 0] * noise.pivots[foot, 0] - soles[foot, i, 1] * noise.pivots[foot, 1]
        lever[0, 1], lever[0, 2] = -r[2], r[1]
        lever[1, 0], lever[1, 2] = r[2], -r[0]
        lever[2, 0], lever[2, 1] = -r[1], r[0]
        for i in range(3):
            covariance[d + i, d + i] += noise.feet[foot, 1 if i == 2 else 0]
            covariance[z + i, z + i] += turn[i]
            for j in range(3):
                # xi_Z = -w and xi_d = [r]x w for a rotation w of the foot about its pivot.
                covariance[d + i, z + j] -= turn[j] * lever[i, j]
                covariance[z + j, d + i] -= turn[j] * lever[i, j]
                for k in range(3):
                    covariance[d + i, d + j] += turn[k] * lever[i, k] * lever[j, k]
        # The encoders define the soles of the filter, so the soles drift with the encoder error.
        turn_noise(soles[foot], noise.wander[foot], slow)
        for i in range(3):
            for j in range(3):
                covariance[d + i, d + j] += slow[i, j]
                covariance[d + i, z + j] += slow[i, 3 + j]
                covariance[z + i, d + j] += slow[3 + i, j]
                covariance[z + i, z + j] += slow[3 + i, 3 + j]


@njit(cache=True)
def predict(state: FilterState, rate: Array, force: Array, dt: float, gravity: float, noise: ProcessNoise) -> None:
    """Propagate state and covariance in place by ``dt`` [s]; rate (3,) [rad/s] and force (3,) [m/s^2] are measured."""
    rotation, vectors, covariance, biases = state.rotation, state.vectors, state.covariance, state.biases
    angle = np.empty(3)
    turn = np.empty((3, 3))
    middle = np.empty((3, 3))
    acceleration, unbiased = np.empty(3), np.empty(3)
    centre = vectors.copy()
    for i in range(3):
        angle[i] = 0.5 * dt * (rate[i] - biases[0, i])
        unbiased[i] = force[i] - biases[1, i]
    exponential(angle, turn)
    multiply(rotation, turn, middle)
    multiply(middle, turn, rotation)
    rotate(middle, unbiased, acceleration)
    acceleration[2] -= gravity
    for i in range(3):
        vectors[1, i] += dt * vectors[0, i] + 0.5 * dt * dt * acceleration[i]
        vectors[0, i] += dt * acceleration[i]
        centre[0, i] = 0.5 * (centre[0, i] + vectors[0, i])
        centre[1, i] = 0.5 * (centre[1, i] + vectors[1, i])
    apply_transition(middle, centre, dt, gravity, covariance)
    transposed = covariance.T.copy()
    apply_transition(middle, centre, dt, gravity, transposed)
    for i in range(SIZE):
        for j in range(i, SIZE):
            mean = 0.5 * (transposed[i, j] + transposed[j, i])
            covariance[i, j] = mean
            covariance[j, i] = mean
    add_process_noise(centre, state.soles, covariance, noise)


@njit(cache=True)
def retract(state: FilterState, error: Array) -> None:
    """Subtract the estimated error (27,) from the state, in place: ``X <- Exp(-error) X``."""
    rotation, vectors, soles, biases = state.rotation, state.vectors, state.soles, state.biases
    angle = np.empty(3)
    shift = np.empty(3)
    turned = np.empty(3)
    turn = np.empty((3, 3))
    jacobian = np.empty((3, 3))
    work = np.empty((3, 3))
    for i in range(3):
        angle[i] = -error[ROTATION + i]
    exponential(angle, turn)
    left_jacobian(angle, jacobian)
    multiply(turn, rotation, work)
    rotation[:] = work
    for k in range(4):
        rotate(turn, vectors[k], turned)
        rotate(jacobian, error[VELOCITY + 3 * k : VELOCITY + 3 * k + 3], shift)
        for i in range(3):
            vectors[k, i] = turned[i] - shift[i]
    for k in range(2):
        for i in range(3):
            angle[i] = -error[SOLE + 3 * k + i]
            biases[k, i] -= error[GYRO_BIAS + 3 * k + i]
        exponential(angle, turn)
        multiply(turn, soles[k], work)
        soles[k] = work
        orthonormalise(soles[k])
    orthonormalise(rotation)


@njit(cache=True)
def _add_product(left: Array, right: Array, out: Array) -> None:
    """``out += left right``, three rows of ``right`` at a time, to write ``out`` a third as often."""
    count = right.shape[0]
    whole = count - count % 3
    for i in range(out.shape[0]):
        for r in range(0, whole, 3):
            a, b, c = left[i, r], left[i, r + 1], left[i, r + 2]
            for j in range(out.shape[1]):
                out[i, j] = out[i, j] + a * right[r, j] + b * right[r + 1, j] + c * right[r + 2, j]
        for r in range(whole, count):
            for j in range(out.shape[1]):
                out[i, j] += left[i, r] * right[r, j]


@njit(cache=True)
def correct(
    covariance: Array, plus: Index, minus: Index, residual: Array, noise: Array, gate: float, error: Array
) -> float:
    """Kalman gain and Joseph update for measurements of one error component or of the difference of two.

    ``residual = H xi + n`` with ``H xi = xi[plus] - xi[minus]``, or ``xi[plus]`` where ``minus`` is -1, and
    ``n ~ N(0, noise)``. If the normalised square e of the residual exceeds the gate, the noise is multiplied by
    sqrt(e / gate) (Huber weight): an outlier pulls no harder than a residual at the gate, and a filter with a wrong
    state still recovers.

    ``covariance`` (27, 27) is updated in place and ``error`` (27,) receives the estimated error of the state. Returns
    the normalised innovation squared [-], or -1 without a change if it is not finite.
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
        # With a residual that is not finite, the weight is not finite and the second factorisation fails.
        weight = math.sqrt(squared / gate)
    gain = cross.copy()  # K' (m, 27): solve S K' = H P
    solve_factored(factor, gain)
    # Joseph: M = (I - K H) P, then P <- M (I - K H)' + K N K' = M + (K N - M H') K'.
    side = -gain.T
    _add_product(side, cross, covariance)
    for i in range(SIZE):
        for r in range(m):
            total = -covariance[i, plus[r]]
            if minus[r] >= 0:
                total += covariance[i, minus[r]]
            for k in range(m):
                total += weight * gain[k, i] * noise[k, r]
            side[i, r] = total
    _add_product(side, gain, covariance)
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
def foot_residual(state: FilterState, foot: int, seen: SolePoses, residual: Array, noise: Array) -> None:
    """Innovation (6,) of one sole pose, ``R y - (d - p)`` and ``Log(R C Z')`` in W, and its noise (6, 6)."""
    rotation, vectors, sole = state.rotation, state.vectors, state.soles[foot]
    measured = np.empty((3, 3))
    turn = np.empty((3, 3))
    turned = np.empty(3)
    rotate(rotation, seen.positions[foot], turned)
    for i in range(3):
        residual[i] = turned[i] - vectors[2 + foot, i] + vectors[1, i]
    multiply(rotation, seen.rotations[foot], measured)
    for i in range(3):
        for j in range(3):
            turn[i, j] = measured[i, 0] * sole[j, 0] + measured[i, 1] * sole[j, 1] + measured[i, 2] * sole[j, 2]
    logarithm(turn, turned)
    for i in range(3):
        residual[3 + i] = turned[i]
    turn_noise(measured, seen.covariances[foot], noise)


@njit(cache=True)
def correct_soles(state: FilterState, seen: SolePoses, gate: float, error: Array) -> int:
    """Correct the state with the pose of each sole in turn; returns the number of unusable ones."""
    residual, noise = np.empty(6), np.empty((6, 6))
    rejected = 0
    for foot in range(2):
        foot_residual(state, foot, seen, residual, noise)
        innovation = correct(state.covariance, _FOOT_PLUS, _FOOT_MINUS[foot], residual, noise, gate, error)
        state.innovation[foot] = innovation
        if innovation < 0.0:
            rejected += 1
        else:
            retract(state, error)
    return rejected
