"""Yaw of a rotation."""

from __future__ import annotations

import math

from models.compiled import njit


@njit("float64(float64, float64, float64, float64)", cache=True)
def heading(x: float, y: float, z: float, w: float) -> float:
    """Yaw of a unit quaternion as R = Rz(yaw) Ry(pitch) Rx(roll) has it [rad], in [-pi, pi]."""
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
