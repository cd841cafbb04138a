"""Frame ``base_footprint`` of REP-120: where the robot stands."""

from __future__ import annotations

import math

import numpy as np

from models.compiled import njit
from models.heading import heading
from models.types import Matrix, Vector


@njit(cache=True)
def base_footprint(base: Vector, soles: Matrix) -> Vector:
    """Pose of the footprint in B: between the soles, level with the lower one, with the base's yaw.

    Args:
        base: Position of B in W and its quaternion xyzw (7,) [m].
        soles: Origins of both soles in W (2, 3) [m].

    Returns:
        Position in B and quaternion xyzw (7,) [m].
    """
    x, y, z, w = base[3], base[4], base[5], base[6]
    px = 0.5 * (soles[0, 0] + soles[1, 0]) - base[0]
    py = 0.5 * (soles[0, 1] + soles[1, 1]) - base[1]
    pz = min(soles[0, 2], soles[1, 2]) - base[2]
    yaw = heading(x, y, z, w)
    s, c = math.sin(0.5 * yaw), math.cos(0.5 * yaw)
    pose = np.empty(7)
    # R' p = p + w t + t x n with t = 2 p x n, n = (x, y, z)
    tx, ty, tz = 2.0 * (py * z - pz * y), 2.0 * (pz * x - px * z), 2.0 * (px * y - py * x)
    pose[0] = px + w * tx + ty * z - tz * y
    pose[1] = py + w * ty + tz * x - tx * z
    pose[2] = pz + w * tz + tx * y - ty * x
    # conjugate of the base's quaternion, times (0, 0, s, c)
    pose[3] = -x * c - y * s
    pose[4] = x * s - y * c
    pose[5] = w * s - z * c
    pose[6] = w * c + z * s
    return pose
