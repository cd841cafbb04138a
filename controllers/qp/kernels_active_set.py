"""Compiled dual active-set solver for the small QPs of the tick."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from controllers.qp.kernels_check import kkt_residual
from controllers.qp.kernels_cholesky import factorise, solve_lower, solve_upper
from models.compiled import njit

Array = NDArray[np.float64]

VIOLATION = 1e-12
"""Excess over a bound, relative to the row's size, from which on a row counts as broken [-]: rounding."""

DEPENDENT = 1e-10
"""Share of a row's square that the active rows leave, below which it depends on them [-]: rounding."""


@njit(cache=True, fastmath={"reassoc", "contract"})
def _worst_row(matrix: Array, lower: Array, upper: Array, active: NDArray[np.int8], z: Array) -> tuple[int, int]:
    """Row, not active, that z (nz,) breaks most, and its side (1 upper, -1 lower); (-1, 0) when it breaks none."""
    simple = lower.shape[0] - matrix.shape[0]
    row, side, most = -1, 0, 0.0
    for i in range(lower.shape[0]):
        if active[i] != 0:
            continue
        value = 0.0
        if i < simple:
            value = z[i]
        else:
            for c in range(z.shape[0]):
                value += matrix[i - simple, c] * z[c]
        excess = max(value - upper[i], lower[i] - value)
        if excess > VIOLATION * (1.0 + abs(value)) and excess > most:
            row, most = i, excess
            side = 1 if value > upper[i] else -1
    return row, side


@njit(cache=True, fastmath={"reassoc", "contract"})
def _transformed_row(matrix: Array, simple: int, row: int, side: int, factor: Array, out: Array) -> None:
    """Row a in the coordinates x = L'z, turned so that its bound is an upper one: out = L^-1 (side a) (nz,)."""
    nz = out.shape[0]
    if row < simple:
        out[:] = 0.0
        out[row] = side
    else:
        for c in range(nz):
            out[c] = side * matrix[row - simple, c]
    solve_lower(factor, nz, out)


@njit(cache=True, fastmath={"reassoc", "contract"})
def _drop(j: int, count: int, rows: NDArray[np.int64], y: Array, gram: Array, bound: Array, dual: Array) -> None:
    """Take the j-th of ``count`` rows out of the lists."""
    for a in range(j, count - 1):
        rows[a], bound[a], dual[a] = rows[a + 1], bound[a + 1], dual[a + 1]
        y[a] = y[a + 1]
    for a in range(count - 1):
        for b in range(a + 1):
            gram[a, b] = gram[a if a < j else a + 1, b if b < j else b + 1]


@njit(cache=True, fastmath={"reassoc", "contract"})
def _minimum_on_rows(count: int, y: Array, factor: Array, bound: Array, x_free: Array, dual: Array, x: Array) -> None:
    """Minimum with ``count`` rows at their bounds b: x = x_free - Y'u, with (Y Y') u = Y x_free - b."""
    for a in range(count):
        dual[a] = -bound[a]
        for k in range(x.shape[0]):
            dual[a] += y[a, k] * x_free[k]
    solve_lower(factor, count, dual)
    solve_upper(factor, count, dual)
    x[:] = x_free
    for a in range(count):
        for k in range(x.shape[0]):
            x[k] -= dual[a] * y[a, k]


@njit(cache=True, fastmath={"reassoc", "contract"})
def _longest_steps(
    count: int, y: Array, gram: Array, factor: Array, bound: Array, dual: Array, x: Array, ratio: Array
) -> tuple[float, float, int]:
    """How far the multiplier of the row y[count] may grow.

    Args:
        count: Active rows; the one to be added stands behind them.
        y: Rows (count + 1, nz).
        gram: Products of the rows, those of the last one filled here (count + 1, count + 1).
        factor: Of the active rows' products (count, count).
        bound: Upper bounds (count + 1,).
        dual: Multipliers (count + 1,).
        x: Where the active rows hold (nz,).
        ratio: Out: r, by which the multipliers of the active rows shrink for each unit (count,).

    Returns:
        Growth at which the row holds, infinity when it depends on the active ones; growth at which the multiplier of an
        active row vanishes, infinity when none does; and that row.
    """
    own = 0.0
    for k in range(x.shape[0]):
        own += y[count, k] * y[count, k]
    for a in range(count):
        total = 0.0
        for k in range(x.shape[0]):
            total += y[count, k] * y[a, k]
        gram[count, a] = ratio[a] = total
    gram[count, count] = own
    solve_lower(factor, count, ratio)
    solve_upper(factor, count, ratio)
    left = own
    for a in range(count):
        left -= gram[count, a] * ratio[a]
    until_dual, blocking = np.inf, -1
    for a in range(count):
        if ratio[a] > 0.0 and dual[a] < until_dual * ratio[a]:
            until_dual, blocking = dual[a] / ratio[a], a
    if left <= DEPENDENT * own:
        return np.inf, until_dual, blocking
    excess = -bound[count]
    for k in range(x.shape[0]):
        excess += y[count, k] * x[k]
    return excess / left, until_dual, blocking


@njit(cache=True, fastmath={"reassoc", "contract"})
def active_set(
    hessian: Array,
    gradient: Array,
    matrix: Array,
    lower: Array,
    upper: Array,
    hessian_factor: Array,
    iterations: int,
    z: Array,
) -> float:
    r"""Solve a strictly convex QP by the dual method of Goldfarb and Idnani.

    With H = L L' and x = L'z the cost is a squared distance, and a row a of the QP is the vector y = L^-1 a. From the
    free minimum on, the row broken most is added: its multiplier grows by t, those of the active rows change by -t r
    with r = (Y Y')^-1 Y y, and x by -t (y - Y'r), until the row holds, or a multiplier vanishes and its row is dropped.
    Few rows are ever active, so Y Y' is small, and factorised anew each time. A general solver first prepares all rows.

    Args:
        hessian: H, positive definite (nz, nz).
        gradient: f (nz,).
        matrix: General rows (m, nz).
        lower: Lower bounds of the nb simple rows, then of the general rows (nb + m,).
        upper: Upper bounds, likewise (nb + m,).
        hessian_factor: L of ``factorise`` (nz, nz).
        iterations: Most rows that are added or dropped.
        z: Out (nz,).

    Returns:
        KKT residual of ``kkt_residual``; infinity when the QP is infeasible or ``iterations`` did not suffice.

    References:
        Goldfarb, Idnani: A numerically stable dual method for solving strictly convex quadratic programs (1983).
    """
    nz, simple = gradient.shape[0], lower.shape[0] - matrix.shape[0]
    active = np.zeros(lower.shape[0], dtype=np.int8)
    rows = np.empty(nz + 1, dtype=np.int64)
    y, gram, factor = np.empty((nz + 1, nz)), np.empty((nz + 1, nz + 1)), np.empty((nz + 1, nz + 1))
    bound, dual, ratio = np.empty(nz + 1), np.empty(nz + 1), np.empty(nz + 1)
    x_free = -gradient
    solve_lower(hessian_factor, nz, x_free)
    x = x_free.copy()
    count, row, side, solved = 0, -1, 0, False
    for _ in range(iterations):
        if row < 0:
            z[:] = x
            solve_upper(hessian_factor, nz, z)
            row, side = _worst_row(matrix, lower, upper, active, z)
            if row < 0:
                solved = True
                break
            _transformed_row(matrix, simple, row, side, hessian_factor, y[count])
            rows[count], dual[count], bound[count] = row, 0.0, upper[row] if side > 0 else -lower[row]
        until_row, until_dual, blocking = _longest_steps(count, y, gram, factor, bound, dual, x, ratio)
        step = min(until_row, until_dual)
        if step == np.inf:
            return np.inf
        for a in range(count):
            dual[a] -= step * ratio[a]
        dual[count] += step
        if until_row < np.inf:
            for k in range(nz):
                change = y[count, k]
                for a in range(count):
                    change -= ratio[a] * y[a, k]
                x[k] -= step * change
        if until_row <= until_dual:
            active[row] = side
            count, row = count + 1, -1
        else:
            active[rows[blocking]] = 0
            _drop(blocking, count + 1, rows, y, gram, bound, dual)
            count -= 1
        if not factorise(gram, count, factor):
            return np.inf
    if not solved:
        return np.inf
    # Once more from the active rows alone: the rounding of the steps does not add up.
    _minimum_on_rows(count, y, factor, bound, x_free, dual, x)
    z[:] = x
    solve_upper(hessian_factor, nz, z)
    multipliers = np.zeros(lower.shape[0])
    for a in range(count):
        multipliers[rows[a]] = dual[a] * active[rows[a]]
    return kkt_residual(hessian, gradient, matrix, lower, upper, z, multipliers)
