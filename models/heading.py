"""Yaw of a rotation, and turning by it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from models.compiled import njit
from models.types import Matrix


@njit("float64(float64, float64, float64, float64)", cache=True)
def heading(x: float, y: float, z: float, w: float) -> float:
    """Yaw of a unit quaternion as R = Rz(yaw) Ry(pitch) Rx(roll) has it [rad], in [-pi, pi]."""
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def turned(points: ArrayLike, yaw: float) -> Matrix:
    """Horizontal vectors (..., 2) turned to the left by a yaw [rad]; by minus a heading, they are seen along it."""
    c, s = math.cos(yaw), math.sin(yaw)
    found: Matrix = np.asarray(points, dtype=float) @ np.array([[c, s], [-s, c]])
    return found
