"""Wrench cone of a rectangular sole."""

from __future__ import annotations

import numpy as np

from controllers.qp.kernels_cone import fill_cone
from models.types import Matrix, Vector

ROWS = 17
"""Rows of a cone."""


def wrench_cone(
    rectangle: tuple[float, float, float, float], friction: float, force_min: float, force_max: float
) -> tuple[Matrix, Vector, Vector]:
    """Rows ``lower <= G w <= upper`` for a sole wrench that a flat rectangular contact can bear without moving.

    For a rectangle centred on the sole origin this is Caron's closed form: friction (4 rows), CoP (4 rows), yaw moment
    (8 rows) and unilaterality (1 row). A rectangle off the origin is reduced to it by moving the moment to its centre.

    Args:
        rectangle: x_min, x_max, y_min, y_max in the sole frame [m].
        friction: Coulomb coefficient; the pyramid is inscribed, mu / sqrt(2) along each axis.
        force_min: Least normal force [N].
        force_max: Largest normal force [N].

    Returns:
        G (17, 6), lower (17,), upper (17,).

    References:
        Caron, Pham, Nakamura: Stability of surface contacts for humanoid robots (ICRA 2015), eq. 19-28.
    """
    matrix, lower, upper = np.empty((ROWS, 6)), np.empty(ROWS), np.empty(ROWS)
    fill_cone(np.array(rectangle, dtype=float), friction, force_min, force_max, 1.0, matrix, lower, upper)
    return matrix, lower, upper
