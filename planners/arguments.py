"""Arguments of a caller, checked; every refusal names the argument."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from models.errors import CommandError
from models.types import Matrix, Vector


def vector(values: ArrayLike, size: int, name: str) -> Vector:
    """Check a caller's vector; raises ``CommandError`` naming it."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise CommandError(f"{name}: not numbers: {error}") from error
    if array.shape != (size,):
        raise CommandError(f"{name}: expected {size} numbers, found shape {array.shape}")
    if not np.isfinite(array).all():
        raise CommandError(f"{name}: {array[~np.isfinite(array)][0]} is not a finite number")
    return array.copy()


def rotation(values: ArrayLike, name: str) -> Matrix:
    """Rotation of a quaternion xyzw; raises ``CommandError`` unless it has length 1 (to 1 %)."""
    quaternion = vector(values, 4, name)
    length = float(np.linalg.norm(quaternion))
    if abs(length - 1.0) > 0.01:
        raise CommandError(f"{name}: the quaternion has length {length:.3g}, expected 1")
    return np.array(pin.Quaternion(quaternion / length).toRotationMatrix())
