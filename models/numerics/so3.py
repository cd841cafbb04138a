"""Compiled rotation kernels: exponential, logarithm, left Jacobian, quaternions and small products."""

import math

import numpy as np
from numpy.typing import NDArray

from models.numerics.compiled import njit

Array = NDArray[np.float64]

SMALL_ANGLE = 1e-6  #: Angle below which series are used [rad]; the omitted terms are below 1e-13


@njit(cache=True)
def multiply(a: Array, b: Array, out: Array) -> None:
    """Product of two matrices (3, 3); ``out`` must not alias an input."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@njit(cache=True)
def rotate(rotation: Array, x: Array, out: Array) -> None:
    """Product of a matrix (3, 3) and a vector (3,); ``out`` must not alias ``x``."""
    for i in range(3):
        out[i] = rotation[i, 0] * x[0] + rotation[i, 1] * x[1] + rotation[i, 2] * x[2]


@njit(cache=True)
def rotate_transposed(rotation: Array, x: Array, out: Array) -> None:
    """Product of a transposed matrix (3, 3) and a vector (3,); ``out`` must not alias ``x``."""
    for i in range(3):
        out[i] = rotation[0, i] * x[0] + rotation[1, i] * x[1] + rotation[2, i] * x[2]


@njit(cache=True)
def turn_noise(rotation: Array, noise: Array, out: Array) -> None:
    """Covariance (6, 6) ``D noise D'``, D = diag(R, R), of two vectors (linear, angular) rotated by R (3, 3)."""
    half = np.empty((3, 6))
    for a in range(0, 6, 3):
        for i in range(3):
            for j in range(6):
                half[i, j] = (
                    rotation[i, 0] * noise[a, j] + rotation[i, 1] * noise[a + 1, j] + rotation[i, 2] * noise[a + 2, j]
                )
        for b in range(0, 6, 3):
            for i in range(3):
                for j in range(3):
                    out[a + i, b + j] = (
                        half[i, b] * rotation[j, 0] + half[i, b + 1] * rotation[j, 1] + half[i, b + 2] * rotation[j, 2]
                    )


@njit(cache=True)
def _polynomial(phi: Array, a: float, b: float, out: Array) -> None:
    """``I + a [phi]x + b [phi]x^2`` (3, 3)."""
    x, y, z = phi[0], phi[1], phi[2]
    out[0, 0] = 1.0 - b * (y * y + z * z)
    out[1, 1] = 1.0 - b * (x * x + z * z)
    out[2, 2] = 1.0 - b * (x * x + y * y)
    out[0, 1] = b * x * y - a * z
    out[1, 0] = b * x * y + a * z
    out[0, 2] = b * x * z + a * y
    out[2, 0] = b * x * z - a * y
    out[1, 2] = b * y * z - a * x
    out[2, 1] = b * y * z + a * x


@njit(cache=True)
def exponential(phi: Array, out: Array) -> None:
    """Rotation matrix (3, 3) of a rotation vector (3,) [rad], by Rodrigues' formula."""
    angle = math.sqrt(phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2])
    if angle < SMALL_ANGLE:
        _polynomial(phi, 1.0, 0.5, out)
    else:
        half = math.sin(0.5 * angle) / (0.5 * angle)
        _polynomial(phi, math.sin(angle) / angle, 0.5 * half * half, out)


@njit(cache=True)
def left_jacobian(phi: Array, out: Array) -> None:
    """Left Jacobian ``int_0^1 Exp(s phi) ds`` (3, 3) of a rotation vector (3,) [rad]."""
    angle = math.sqrt(phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2])
    if angle < 1e-4:  # the closed form loses digits at larger angles than the exponential
        _polynomial(phi, 0.5, 1.0 / 6.0, out)
    else:
        half = math.sin(0.5 * angle) / (0.5 * angle)
        _polynomial(phi, 0.5 * half * half, (angle - math.sin(angle)) / angle**3, out)


@njit(cache=True)
def logarithm(rotation: Array, out: Array) -> None:
    """Rotation vector (3,) [rad] of a rotation matrix (3, 3), via the quaternion; valid up to pi."""
    quaternion = np.empty(4)
    to_quaternion(rotation, quaternion)
    sine = math.sqrt(quaternion[0] ** 2 + quaternion[1] ** 2 + quaternion[2] ** 2)
    scale = 2.0 / quaternion[3] if sine < SMALL_ANGLE else 2.0 * math.atan2(sine, quaternion[3]) / sine
    for i in range(3):
        out[i] = scale * quaternion[i]


@njit(cache=True)
def to_quaternion(rotation: Array, out: Array) -> None:
    """Unit quaternion xyzw with w >= 0 (4,) of a rotation matrix (3, 3); divides by the largest component."""
    r00, r11, r22 = rotation[0, 0], rotation[1, 1], rotation[2, 2]
    trace = r00 + r11 + r22
    if trace > 0.0:
        w = 0.5 * math.sqrt(1.0 + trace)
        x = 0.25 * (rotation[2, 1] - rotation[1, 2]) / w
        y = 0.25 * (rotation[0, 2] - rotation[2, 0]) / w
        z = 0.25 * (rotation[1, 0] - rotation[0, 1]) / w
    elif r00 >= r11 and r00 >= r22:
        x = 0.5 * math.sqrt(1.0 + r00 - r11 - r22)
        w = 0.25 * (rotation[2, 1] - rotation[1, 2]) / x
        y = 0.25 * (rotation[0, 1] + rotation[1, 0]) / x
        z = 0.25 * (rotation[0, 2] + rotation[2, 0]) / x
    elif r11 >= r22:
        y = 0.5 * math.sqrt(1.0 - r00 + r11 - r22)
        w = 0.25 * (rotation[0, 2] - rotation[2, 0]) / y
        x = 0.25 * (rotation[0, 1] + rotation[1, 0]) / y
        z = 0.25 * (rotation[1, 2] + rotation[2, 1]) / y
    else:
        z = 0.5 * math.sqrt(1.0 - r00 - r11 + r22)
        w = 0.25 * (rotation[1, 0] - rotation[0, 1]) / z
        x = 0.25 * (rotation[0, 2] + rotation[2, 0]) / z
        y = 0.25 * (rotation[1, 2] + rotation[2, 1]) / z
    scale = math.copysign(1.0 / math.sqrt(x * x + y * y + z * z + w * w), w)
    out[0], out[1], out[2], out[3] = scale * x, scale * y, scale * z, scale * w


@njit(cache=True)
def orthonormalise(rotation: Array) -> None:
    """One Newton step to the nearest rotation, in place: ``R <- R (3 I - R' R) / 2`` (3, 3).

    Products of rotations drift off the group by rounding (1e-16 per step); one quadratic step per tick suffices.
    """
    copy = rotation.copy()
    for i in range(3):
        for j in range(3):
            total = 1.5 * copy[i, j]
            for k in range(3):
                inner = copy[0, k] * copy[0, j] + copy[1, k] * copy[1, j] + copy[2, k] * copy[2, j]
                total -= 0.5 * copy[i, k] * inner
            rotation[i, j] = total


@njit(cache=True)
def quaternion_matrix(quaternion: Array, out: Array) -> None:
    """Rotation matrix (3, 3) of a unit quaternion xyzw (4,)."""
    x, y, z, w = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    out[0, 0], out[0, 1], out[0, 2] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)
    out[1, 0], out[1, 1], out[1, 2] = 2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)
    out[2, 0], out[2, 1], out[2, 2] = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)


@njit(cache=True)
def rotation_error(current: Array, desired: Array, out: Array) -> None:
    """Write ``log(current' desired)`` in the current frame (3,) [rad]; reads only the upper left (3, 3)."""
    turn = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            turn[i, j] = current[0, i] * desired[0, j] + current[1, i] * desired[1, j] + current[2, i] * desired[2, j]
    logarithm(turn, out)
