"""Compiled prediction and retraction of the right-invariant filter; the equations are in ``docs/estimation.md``.

State, passed as separate arrays: ``rotation`` R (3, 3); ``vectors`` v, p, d_L, d_R (4, 3); ``soles`` Z_L, Z_R
(2, 3, 3); ``biases`` b_g, b_a (2, 3); all of the inertial unit in W except the biases. Error, in this order (27,):
``[R, v, p, d_L, d_R, Z_L, Z_R, b_g, b_a]``, right-invariant (``X_hat = Exp(xi) X``) except the biases
(``b_hat - b``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from controllers.estimation.so3 import exponential, left_jacobian, multiply, orthonormalise, rotate, turn_noise
from models.compiled import njit

Array = NDArray[np.float64]

SIZE = 27
ROTATION, VELOCITY, POSITION, FOOT, SOLE, GYRO_BIAS, ACCEL_BIAS = 0, 3, 6, 9, 15, 21, 24
"""First index of each block of the error; feet and soles take six, left then right."""


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

    Args:
        rotation: R in the middle of the step (3, 3).
        vectors: v and p in the middle of the step, d_L, d_R (4, 3).
        dt: Step [s].
        gravity: [m/s^2].
        matrix: Multiplied in place, from the block that depends on most to the one that depends on least.
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
def add_process_noise(
    vectors: Array, soles: Array, covariance: Array, pivots: Array, foot_variances: Array, imu_variances: Array,
    wander: Array,
) -> None:  # fmt: skip
    """Add the noise that one step brings.

    Args:
        vectors: v, p, d_L, d_R (4, 3).
        soles: Z_L, Z_R (2, 3, 3).
        covariance: (27, 27), in place.
        pivots: Point of each sole about which it turns, in its frame (2, 2) [m].
        foot_variances: Of horizontal position, height and orientation of each foot over the step (2, 3) [m^2, rad^2].
        imu_variances: Of angle, velocity, gyro bias and accelerometer bias over the step (4,).
        wander: Of the measured sole poses' error over the step, in each sole frame (2, 6, 6) [m^2, m.rad, rad^2].
    """
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
            covariance[i, j] += imu_variances[0] * product
    for i in range(3):
        covariance[VELOCITY + i, VELOCITY + i] += imu_variances[1]
        covariance[GYRO_BIAS + i, GYRO_BIAS + i] += imu_variances[2]
        covariance[ACCEL_BIAS + i, ACCEL_BIAS + i] += imu_variances[3]
    lever = np.zeros((3, 3))  # [r]x, r = sole origin minus pivot in W
    r = np.empty(3)
    slow = np.empty((6, 6))
    for foot in range(2):
        d, z = FOOT + 3 * foot, SOLE + 3 * foot
        tip = foot_variances[foot, 2]
        for i in range(3):
            r[i] = -soles[foot, i, 0] * pivots[foot, 0] - soles[foot, i, 1] * pivots[foot, 1]
        lever[0, 1], lever[0, 2] = -r[2], r[1]
        lever[1, 0], lever[1, 2] = r[2], -r[0]
        lever[2, 0], lever[2, 1] = -r[1], r[0]
        for i in range(3):
            covariance[d + i, d + i] += foot_variances[foot, 1 if i == 2 else 0]
            covariance[z + i, z + i] += tip
            for j in range(3):
                # xi_Z = -w and xi_d = [r]x w for a rotation w of the foot about its pivot.
                covariance[d + i, z + j] -= tip * lever[i, j]
                covariance[z + j, d + i] -= tip * lever[i, j]
                for k in range(3):
                    covariance[d + i, d + j] += tip * lever[i, k] * lever[j, k]
        # The filter's sole is where the encoders see it, so it moves as their error does.
        turn_noise(soles[foot], wander[foot], slow)
        for i in range(3):
            for j in range(3):
                covariance[d + i, d + j] += slow[i, j]
                covariance[d + i, z + j] += slow[i, 3 + j]
                covariance[z + i, d + j] += slow[3 + i, j]
                covariance[z + i, z + j] += slow[3 + i, 3 + j]


@njit(cache=True)
def predict(
    rotation: Array,
    vectors: Array,
    soles: Array,
    covariance: Array,
    rate: Array,
    force: Array,
    dt: float,
    gravity: float,
    pivots: Array,
    foot_variances: Array,
    imu_variances: Array,
    wander: Array,
) -> None:
    """Propagate state and covariance by ``dt``, in place.

    Args:
        rotation: R (3, 3).
        vectors: v, p, d_L, d_R (4, 3).
        soles: Z_L, Z_R (2, 3, 3); not changed.
        covariance: (27, 27).
        rate: Angular velocity without bias, in the inertial unit's frame (3,) [rad/s].
        force: Specific force without bias (3,) [m/s^2].
        dt: Step [s].
        gravity: [m/s^2].
        pivots: See ``add_process_noise``.
        foot_variances: See ``add_process_noise``.
        imu_variances: See ``add_process_noise``.
        wander: See ``add_process_noise``.
    """
    angle = np.empty(3)
    turn = np.empty((3, 3))
    middle = np.empty((3, 3))
    acceleration = np.empty(3)
    centre = vectors.copy()
    for i in range(3):
        angle[i] = 0.5 * dt * rate[i]
    exponential(angle, turn)
    multiply(rotation, turn, middle)
    multiply(middle, turn, rotation)
    rotate(middle, force, acceleration)
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
    add_process_noise(centre, soles, covariance, pivots, foot_variances, imu_variances, wander)


@njit(cache=True)
def retract(rotation: Array, vectors: Array, soles: Array, biases: Array, error: Array) -> None:
    """Take the estimated error (27,) off the state, in place: ``X <- Exp(-error) X``."""
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
