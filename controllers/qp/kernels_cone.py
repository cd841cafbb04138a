"""Compiled parts of the wrench cone: its rows, and how planted soles share the weight."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.compiled import njit

Array = NDArray[np.float64]

ROWS = 17
"""Rows of a cone."""

UNBOUNDED = 1e30
"""Bound that the solvers take as none."""


@njit(cache=True, fastmath={"contract"})
def fill_cone(
    rectangle: Array,
    friction: float,
    force_min: float,
    force_max: float,
    scale: float,
    matrix: Array,
    lower: Array,
    upper: Array,
) -> None:
    """Rows ``lower <= G w <= upper`` for a sole wrench that a flat rectangular contact can bear without moving.

    For a rectangle centred on the sole origin this is Caron's closed form: friction (4 rows), CoP (4 rows), yaw moment
    (8 rows) and unilaterality (1 row). A rectangle off the origin is reduced to it by moving the moment to its centre.

    Args:
        rectangle: x_min, x_max, y_min, y_max in the sole frame (4,) [m].
        friction: Coulomb coefficient; the pyramid is inscribed, mu / sqrt(2) along each axis.
        force_min: Least normal force [N].
        force_max: Largest normal force [N].
        scale: Force that the rows and their bounds are divided by [N].
        matrix: Out: G (ROWS, 6).
        lower: Out: (ROWS,).
        upper: Out: (ROWS,).

    References:
        Caron, Pham, Nakamura: Stability of surface contacts for humanoid robots (ICRA 2015), eq. 19-28.
    """
    centre_x, centre_y = 0.5 * (rectangle[0] + rectangle[1]), 0.5 * (rectangle[2] + rectangle[3])
    half_x, half_y = 0.5 * (rectangle[1] - rectangle[0]), 0.5 * (rectangle[3] - rectangle[2])
    mu = friction / np.sqrt(2.0)
    matrix[:] = 0.0
    row = 8
    for i in range(2):
        sign = 1.0 - 2.0 * i
        matrix[i, 0] = matrix[2 + i, 1] = matrix[4 + i, 3] = matrix[6 + i, 4] = sign
        matrix[i, 2] = matrix[2 + i, 2] = -mu
        matrix[4 + i, 2], matrix[6 + i, 2] = -half_y, -half_x
        for sign_y in (1.0, -1.0):
            for sign_z in (1.0, -1.0):
                # sign tau_z + |Y f_x + sign mu tau_x| + |X f_y + sign mu tau_y| <= mu (X + Y) f_z
                matrix[row, 0], matrix[row, 1], matrix[row, 2] = sign * half_y, sign_y * half_x, -mu * (half_x + half_y)
                matrix[row, 3], matrix[row, 4], matrix[row, 5] = sign_z * sign * mu, sign_z * sign_y * mu, sign_z
                row += 1
    for row in range(16):  # of the wrench at the rectangle's centre, made rows of the wrench at the sole's origin
        moment_x, moment_y, moment_z = matrix[row, 3], matrix[row, 4], matrix[row, 5]
        matrix[row, 0] += moment_z * centre_y
        matrix[row, 1] -= moment_z * centre_x
        matrix[row, 2] = (matrix[row, 2] - moment_x * centre_y) + moment_y * centre_x
    matrix[16, 2] = 1.0
    matrix /= scale
    lower[:16], lower[16] = -UNBOUNDED / scale, force_min / scale
    upper[:16], upper[16] = 0.0, force_max / scale


@njit(cache=True)
def share_weight(weight: float, share_left: float, share_right: float, areas: Array, wrenches: Array) -> None:
    """Wrenches that the soles are drawn to: their shares of the weight, in the middle of what bears.

    Args:
        weight: Of the robot [N].
        share_left: Of what the left sole bears, 0 in the air [-].
        share_right: Likewise.
        areas: x_min, x_max, y_min, y_max of what bears of each sole (2, 4) [m].
        wrenches: Out: in the sole frames (2, 6) [N, N.m].
    """
    total = max(share_left + share_right, 1e-6)
    wrenches[:] = 0.0
    for foot in range(2):
        force = weight * ((share_left if foot == 0 else share_right) / total)
        wrenches[foot, 2] = force
        wrenches[foot, 3] = force * 0.5 * (areas[foot, 2] + areas[foot, 3])
        wrenches[foot, 4] = -force * 0.5 * (areas[foot, 0] + areas[foot, 1])
