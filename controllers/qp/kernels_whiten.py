"""Compiled part of the QP's solution: its minimum without rows, and few rows in coordinates where H is the identity."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from controllers.qp.kernels_check import kkt_residual
from models.compiled import njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Flags = NDArray[np.bool_]


@njit(cache=True, fastmath={"reassoc", "contract"})
def free_minimum(hessian: Array, gradient: Array, factor: Array, shift: Array, z: Array) -> float:
    """Minimiser of the cost alone, ``z = -H^-1 f``, by Cholesky factors; it solves the QP when it breaks no row.

    Args:
        hessian: H (nz, nz).
        gradient: f (nz,).
        factor: Out: L of H = L L', its diagonal inverted (nz, nz).
        shift: Out: L^-1 f (nz,).
        z: Out (nz,).

    Returns:
        Largest KKT residual with all multipliers zero, scaled as in ``kkt_residual``; NaN when H is not positive
        definite.
    """
    nz = hessian.shape[0]
    for i in range(nz):
        for j in range(i + 1):
            total = hessian[i, j]
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            if i > j:
                factor[i, j] = total * factor[j, j]
            elif total > 0.0:
                factor[i, i] = 1.0 / np.sqrt(total)  # the diagonal holds inverses
            else:
                return np.nan
    for i in range(nz):
        total = gradient[i]
        for k in range(i):
            total -= factor[i, k] * shift[k]
        shift[i] = total * factor[i, i]
        z[i] = -shift[i]
    _solve_transposed(factor, z)
    worst, scale = 0.0, 1.0
    for i in range(nz):
        quadratic = 0.0
        for c in range(nz):
            quadratic += hessian[i, c] * z[c]
        worst = max(worst, abs(quadratic + gradient[i]))
        scale = max(scale, abs(quadratic), abs(gradient[i]))
    return worst / scale


@njit(cache=True, fastmath={"reassoc", "contract"})
def mark_broken(matrix: Array, lower: Array, upper: Array, z: Array, tolerance: float, marks: Flags) -> int:
    """Mark the rows that a point breaks by more than ``tolerance (1 + |value|)``.

    Args:
        matrix: General rows (m, nz).
        lower: Lower bounds of the nb simple rows, then of the general rows (nb + m,).
        upper: Upper bounds, likewise (nb + m,).
        z: The point (nz,).
        tolerance: [-].
        marks: Rows that are broken are added (nb + m,).

    Returns:
        How many are broken, marked before or not.
    """
    nz, m = z.shape[0], matrix.shape[0]
    nb = lower.shape[0] - m
    count = 0
    for i in range(nb + m):
        value = 0.0
        if i < nb:
            value = z[i]
        else:
            for c in range(nz):
                value += matrix[i - nb, c] * z[c]
        slack = tolerance * (1.0 + abs(value))
        if not lower[i] - slack <= value <= upper[i] + slack:
            marks[i] = True
            count += 1
    return count


@njit(cache=True, fastmath={"reassoc", "contract"})
def whiten(
    factor: Array, matrix: Array, lower: Array, upper: Array, marks: Flags, rows: Index, whitened: Array, bounds: Array
) -> int:
    """Marked rows in the coordinates ``w = L' z``, in which H is the identity: ``a' L^-T``.

    Args:
        factor: L, its diagonal inverted (nz, nz).
        matrix: General rows (m, nz).
        lower: Lower bounds of the nb simple rows, then of the general rows (nb + m,).
        upper: Upper bounds, likewise (nb + m,).
        marks: Which rows are wanted (nb + m,).
        rows: Out: their indices (>= k,).
        whitened: Out: the rows (>= k, nz).
        bounds: Out: their lower and upper bounds (2, >= k).

    Returns:
        How many there are, k.
    """
    nz, simple = factor.shape[0], lower.shape[0] - matrix.shape[0]
    count = 0
    for row in range(lower.shape[0]):
        if not marks[row]:
            continue
        rows[count] = row
        bounds[0, count], bounds[1, count] = lower[row], upper[row]
        out = whitened[count]
        if row >= simple:
            out[:] = matrix[row - simple]
        else:
            out[:] = 0.0
            out[row] = 1.0
        for i in range(nz):
            total = out[i]
            for k in range(i):
                total -= factor[i, k] * out[k]
            out[i] = total * factor[i, i]
        count += 1
    return count


@njit(cache=True)
def judge(
    hessian: Array,
    gradient: Array,
    matrix: Array,
    lower: Array,
    upper: Array,
    factor: Array,
    z: Array,
    rows: Index,
    multipliers: Array,
    tolerance: float,
    marks: Flags,
    full: Array,
) -> float:
    """Bring an answer for some rows back, and judge it in the whole problem.

    Args:
        hessian: H (nz, nz).
        gradient: f (nz,).
        matrix: General rows (m, nz).
        lower: Lower bounds of the nb simple rows, then of the general rows (nb + m,).
        upper: Upper bounds, likewise (nb + m,).
        factor: L, its diagonal inverted (nz, nz).
        z: The answer w; out, ``z = L^-T w`` (nz,).
        rows: The rows that it knows (k,).
        multipliers: Their multipliers (k,).
        tolerance: By how much, of its size, a row may be broken [-].
        marks: Rows that it breaks are added; without one, those with a multiplier alone are left (nb + m,).
        full: Out: multipliers of all rows (nb + m,).

    Returns:
        The KKT residual of ``kkt_residual``; infinity when a row is broken.
    """
    _solve_transposed(factor, z)
    if mark_broken(matrix, lower, upper, z, tolerance, marks) > 0:
        return np.inf
    full[:] = 0.0
    marks[:] = False
    for i in range(rows.shape[0]):
        full[rows[i]] = multipliers[i]
        marks[rows[i]] = multipliers[i] != 0.0
    return kkt_residual(hessian, gradient, matrix, lower, upper, z, full)


@njit(cache=True, fastmath={"reassoc", "contract"})
def _solve_transposed(factor: Array, z: Array) -> None:
    """Solve L' z = z in place."""
    for i in range(z.shape[0] - 1, -1, -1):
        z[i] *= factor[i, i]
        for k in range(i):
            z[k] -= factor[i, k] * z[i]
