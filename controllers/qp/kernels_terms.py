"""Compiled kernels that read task-space terms off Pinocchio's arrays.

Pinocchio leaves the joint Jacobian ``J`` in the world frame (linear part taken at the world origin), the accelerations
of all bodies at zero generalised acceleration, and in the free-flyer rows of the mass matrix the centroidal map.
Reading the terms from there costs a tenth of one Python call per frame.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.compiled import njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@njit(cache=True)
def quaternion_matrix(quaternion: Array, out: Array) -> None:
    """Rotation matrix (3, 3) of a unit quaternion xyzw (4,), written to ``out``."""
    x, y, z, w = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    out[0, 0] = 1.0 - 2.0 * (y * y + z * z)
    out[0, 1] = 2.0 * (x * y - z * w)
    out[0, 2] = 2.0 * (x * z + y * w)
    out[1, 0] = 2.0 * (x * y + z * w)
    out[1, 1] = 1.0 - 2.0 * (x * x + z * z)
    out[1, 2] = 2.0 * (y * z - x * w)
    out[2, 0] = 2.0 * (x * z - y * w)
    out[2, 1] = 2.0 * (y * z + x * w)
    out[2, 2] = 1.0 - 2.0 * (x * x + y * y)


@njit(cache=True)
def frame_terms(
    jacobian_world: Array,
    columns: Index,
    rotation: Array,
    position: Array,
    offset: Array,
    linear: Array,
    angular: Array,
    gravity: float,
    velocity: Array,
    pose: Array,
    jacobian: Array,
    twist: Array,
    drift: Array,
) -> None:
    """Pose, local Jacobian, twist and classical acceleration drift of one frame.

    With ``A`` the spatial acceleration of the joint that carries the frame, at zero generalised acceleration and with
    gravity as an upward acceleration of the base (what ``nonLinearEffects`` leaves behind), all in the frame::

        drift = X^-1 A + (w x v, 0) - (R' g, 0)

    Args:
        jacobian_world: ``data.J`` (6, nv), linear part at the world origin.
        columns: Columns of the joints that move the frame; -1 after the last.
        rotation: Rotation of the frame in W (3, 3).
        position: Origin of the frame in W (3,).
        offset: Pose of the frame in its joint, rotation and origin side by side (3, 4).
        linear: Linear part of A in the joint's frame (3,).
        angular: Angular part of A in the joint's frame (3,).
        gravity: Magnitude of gravity along -z of W [m/s^2].
        velocity: Generalised velocity (nv,).
        pose: Out, homogeneous transform of the frame in W; the last row is left as it is (4, 4).
        jacobian: Out, expressed in the frame, linear then angular (6, nv); other columns are left as they are.
        twist: Out, velocity of the frame expressed in the frame (6,).
        drift: Out, classical acceleration of the frame at zero generalised acceleration, in the frame (6,).
    """
    px, py, pz = position[0], position[1], position[2]
    for i in range(3):
        pose[i, 3] = position[i]
        for j in range(3):
            pose[i, j] = rotation[i, j]
    twist[:] = 0.0
    for column in columns:
        if column < 0:
            break
        ax = jacobian_world[3, column]
        ay = jacobian_world[4, column]
        az = jacobian_world[5, column]
        lx = jacobian_world[0, column] + ay * pz - az * py
        ly = jacobian_world[1, column] + az * px - ax * pz
        lz = jacobian_world[2, column] + ax * py - ay * px
        rate = velocity[column]
        for row in range(3):
            r0, r1, r2 = rotation[0, row], rotation[1, row], rotation[2, row]
            up = r0 * lx + r1 * ly + r2 * lz
            turn = r0 * ax + r1 * ay + r2 * az
            jacobian[row, column] = up
            jacobian[3 + row, column] = turn
            twist[row] += up * rate
            twist[3 + row] += turn * rate
    # Acceleration at the frame's origin, still in the joint's axes: a + alpha x p.
    cx = linear[0] + angular[1] * offset[2, 3] - angular[2] * offset[1, 3]
    cy = linear[1] + angular[2] * offset[0, 3] - angular[0] * offset[2, 3]
    cz = linear[2] + angular[0] * offset[1, 3] - angular[1] * offset[0, 3]
    for row in range(3):
        drift[row] = offset[0, row] * cx + offset[1, row] * cy + offset[2, row] * cz - rotation[2, row] * gravity
        drift[3 + row] = offset[0, row] * angular[0] + offset[1, row] * angular[1] + offset[2, row] * angular[2]
    drift[0] += twist[4] * twist[2] - twist[5] * twist[1]
    drift[1] += twist[5] * twist[0] - twist[3] * twist[2]
    drift[2] += twist[3] * twist[1] - twist[4] * twist[0]


@njit(cache=True)
def centroidal_terms(
    mass_matrix: Array,
    bias: Array,
    rotation: Array,
    position: Array,
    velocity: Array,
    mass: float,
    gravity: float,
    com: Array,
    com_velocity: Array,
    com_jacobian: Array,
    com_drift: Array,
    momentum: Array,
    momentum_matrix: Array,
    momentum_drift: Array,
) -> None:
    """CoM and centroidal angular momentum from the free-flyer rows of the dynamics.

    With ``f = M[:3] a + h[:3]`` and ``n = M[3:6] a + h[3:6]`` the contact force and moment at the base origin in B::

        c'' = R f / m + g,    L' = R (n - c_B x f)

    Args:
        mass_matrix: M (nv, nv).
        bias: h, Coriolis and gravity (nv,).
        rotation: R of B in W (3, 3).
        position: Origin of B in W (3,).
        velocity: Generalised velocity (nv,).
        mass: Total mass [kg].
        gravity: Magnitude of gravity along -z of W [m/s^2].
        com: Out, CoM in W (3,).
        com_velocity: Out, its velocity in W (3,).
        com_jacobian: Out, in W (3, nv).
        com_drift: Out, CoM acceleration at zero generalised acceleration, in W (3,).
        momentum: Out, angular momentum about the CoM in W (3,).
        momentum_matrix: Out, in W (3, nv).
        momentum_drift: Out, in W (3,).
    """
    nv = velocity.shape[0]
    cx = mass_matrix[1, 5] / mass
    cy = -mass_matrix[0, 5] / mass
    cz = mass_matrix[0, 4] / mass
    for i in range(3):
        com[i] = position[i] + rotation[i, 0] * cx + rotation[i, 1] * cy + rotation[i, 2] * cz
        com_velocity[i] = 0.0
        momentum[i] = 0.0
    for j in range(nv + 1):
        if j < nv:
            fx, fy, fz = mass_matrix[0, j], mass_matrix[1, j], mass_matrix[2, j]
            nx, ny, nz = mass_matrix[3, j], mass_matrix[4, j], mass_matrix[5, j]
        else:
            fx, fy, fz = bias[0], bias[1], bias[2]
            nx, ny, nz = bias[3], bias[4], bias[5]
        nx -= cy * fz - cz * fy
        ny -= cz * fx - cx * fz
        nz -= cx * fy - cy * fx
        for i in range(3):
            linear = (rotation[i, 0] * fx + rotation[i, 1] * fy + rotation[i, 2] * fz) / mass
            angular = rotation[i, 0] * nx + rotation[i, 1] * ny + rotation[i, 2] * nz
            if j < nv:
                com_jacobian[i, j] = linear
                momentum_matrix[i, j] = angular
                com_velocity[i] += linear * velocity[j]
                momentum[i] += angular * velocity[j]
            else:
                com_drift[i] = linear
                momentum_drift[i] = angular
    com_drift[2] -= gravity


@njit(cache=True)
def rotation_error(current: Array, wanted: Array, out: Array) -> None:
    """Rotation vector that turns ``current`` into ``wanted``, expressed in the current frame (3,).

    ``out = log(current^T wanted)``. Near a half turn the direction comes from the symmetric part.
    """
    r = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            r[i, j] = current[0, i] * wanted[0, j] + current[1, i] * wanted[1, j] + current[2, i] * wanted[2, j]
    x = 0.5 * (r[2, 1] - r[1, 2])
    y = 0.5 * (r[0, 2] - r[2, 0])
    z = 0.5 * (r[1, 0] - r[0, 1])
    sine = np.sqrt(x * x + y * y + z * z)
    cosine = 0.5 * (r[0, 0] + r[1, 1] + r[2, 2] - 1.0)
    angle = np.arctan2(sine, cosine)
    if sine > 1e-9:
        scale = angle / sine
        out[0], out[1], out[2] = scale * x, scale * y, scale * z
    elif cosine > 0.0:
        out[0], out[1], out[2] = x, y, z
    else:
        best = 0
        for i in range(1, 3):
            if r[i, i] > r[best, best]:
                best = i
        length = 0.0
        for i in range(3):
            out[i] = r[i, best] + (1.0 if i == best else 0.0)
            length += out[i] * out[i]
        length = np.sqrt(length)
        for i in range(3):
            out[i] *= angle / length


@njit(cache=True)
def follow_pose(rotation: Array, position: Array, pose: Array, share: float) -> None:
    """Move a stored pose a share of the way to a measured one, in place.

    Args:
        rotation: Stored rotation (3, 3).
        position: Stored position (3,).
        pose: Measured homogeneous transform (4, 4).
        share: 0 leaves the stored pose, 1 replaces it.
    """
    turn = np.zeros(3)
    rotation_error(rotation, pose[:3, :3], turn)
    turn *= share
    angle = np.sqrt(turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2)
    first = 1.0 if angle < 1e-8 else np.sin(angle) / angle
    second = 0.5 if angle < 1e-4 else (1.0 - np.cos(angle)) / (angle * angle)
    skew = np.zeros((3, 3))
    skew[0, 1], skew[0, 2], skew[1, 2] = -turn[2], turn[1], -turn[0]
    skew[1, 0], skew[2, 0], skew[2, 1] = turn[2], -turn[1], turn[0]
    step = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            square = 0.0
            for k in range(3):
                square += skew[i, k] * skew[k, j]
            step[i, j] = first * skew[i, j] + second * square
        step[i, i] += 1.0
    old = rotation.copy()
    for i in range(3):
        position[i] += share * (pose[i, 3] - position[i])
        for j in range(3):
            rotation[i, j] = old[i, 0] * step[0, j] + old[i, 1] * step[1, j] + old[i, 2] * step[2, j]
