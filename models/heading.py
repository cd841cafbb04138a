"""Yaw of a rotation, rotation by a yaw, and frame ``base_footprint`` of REP-120."""

import math

import numpy as np
from numpy.typing import ArrayLike

from models.numerics.compiled import njit, register_jitable
from models.types import Matrix, Vector


@register_jitable
def heading(x: float, y: float, z: float, w: float) -> float:
    """Yaw of a unit quaternion with R = Rz(yaw) Ry(pitch) Rx(roll), in [-pi, pi] [rad]."""
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def turned(points: ArrayLike, yaw: float) -> Matrix:
    """Rotate horizontal vectors (..., 2) by a yaw [rad], positive to the left; -heading gives them in that heading."""
    c, s = math.cos(yaw), math.sin(yaw)
    found: Matrix = np.asarray(points, dtype=float) @ np.array([[c, s], [-s, c]])
    return found


@njit(cache=True)
def base_footprint(base: Vector, soles: Matrix) -> Vector:
    """Footprint in B (7,): midway between ``soles`` (2, 3), at the height of the lower one, yaw of ``base`` (7,)."""
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
