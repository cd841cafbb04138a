"""Wrench cone of a rectangular sole."""

from __future__ import annotations

import numpy as np

from models.types import Matrix, Vector

UNBOUNDED = 1e30
"""Bound that the solvers take as none."""


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
    x_min, x_max, y_min, y_max = rectangle
    centre_x, centre_y = 0.5 * (x_min + x_max), 0.5 * (y_min + y_max)
    half_x, half_y = 0.5 * (x_max - x_min), 0.5 * (y_max - y_min)
    mu = friction / np.sqrt(2.0)
    centred = [
        [1.0, 0.0, -mu, 0.0, 0.0, 0.0],
        [-1.0, 0.0, -mu, 0.0, 0.0, 0.0],
        [0.0, 1.0, -mu, 0.0, 0.0, 0.0],
        [0.0, -1.0, -mu, 0.0, 0.0, 0.0],
        [0.0, 0.0, -half_y, 1.0, 0.0, 0.0],
        [0.0, 0.0, -half_y, -1.0, 0.0, 0.0],
        [0.0, 0.0, -half_x, 0.0, 1.0, 0.0],
        [0.0, 0.0, -half_x, 0.0, -1.0, 0.0],
    ]
    for sign_x in (1.0, -1.0):
        for sign_y in (1.0, -1.0):
            for sign in (1.0, -1.0):
                # sign tau_z + |Y f_x + sign mu tau_x| + |X f_y + sign mu tau_y| <= mu (X + Y) f_z
                centred.append(
                    [
                        sign_x * half_y,
                        sign_y * half_x,
                        -mu * (half_x + half_y),
                        sign * sign_x * mu,
                        sign * sign_y * mu,
                        sign,
                    ]
                )
    shift = np.eye(6)  # wrench at the rectangle's centre from the wrench at the sole origin
    shift[3, 2] = -centre_y
    shift[4, 2] = centre_x
    shift[5, 0] = centre_y
    shift[5, 1] = -centre_x
    rows = np.array(centred) @ shift  # (16, 6)
    normal = np.array([[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])
    matrix = np.vstack([rows, normal])  # (17, 6)
    lower = np.append(np.full(16, -UNBOUNDED), force_min)
    upper = np.append(np.zeros(16), force_max)
    return matrix, lower, upper
