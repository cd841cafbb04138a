"""Frame ``base_footprint`` of REP-120: where the robot stands."""

from __future__ import annotations

import math

import numpy as np

from models.types import Matrix, Vector


def base_footprint(base: Vector, soles: Matrix) -> Vector:
    """Pose of the footprint in B: between the soles, level with the lower one, with the base's yaw.

    Args:
        base: Position of B in W and its quaternion xyzw (7,) [m].
        soles: Origins of both soles in W (2, 3) [m].

    Returns:
        Position in B and quaternion xyzw (7,) [m].
    """
    x, y, z, w = base[3:]
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    s, c = math.sin(0.5 * yaw), math.cos(0.5 * yaw)
    middle = 0.5 * (soles[0] + soles[1])
    middle[2] = min(soles[0, 2], soles[1, 2])
    pose = np.empty(7)
    pose[:3] = _turn_back(base[3:], middle - base[:3])
    # conjugate(base) * (0, 0, s, c)
    pose[3:] = -x * c - y * s, -y * c + x * s, w * s - z * c, w * c + z * s
    return pose


def _turn_back(quaternion: Vector, vector: Vector) -> Vector:
    """``R' v`` for a quaternion xyzw (3,)."""
    axis, w = -quaternion[:3], quaternion[3]
    turn = 2.0 * np.cross(axis, vector)
    rotated: Vector = vector + w * turn + np.cross(axis, turn)
    return rotated
