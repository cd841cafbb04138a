"""Compiled solution of a QP of which few rows are active: the minimum without rows, then with those it breaks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from controllers.qp.kernels_whiten import free_minimum, judge, mark_broken, whiten
from models.compiled import njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Flags = NDArray[np.bool_]

MANY = 48
"""Rows from which on the problem is left to a general solver."""

_ROUNDS = 5
"""Times that rows which an answer breaks are added."""

_CHANGES = 4 * MANY
"""Times that a row is added or dropped in one round."""

_ROUNDING = 1e-12
"""Excess over a bound, relative to the value, up to which a row is not broken [-]."""

_DEPENDENT = 1e-10
"""Share of a row's square that those before it leave, below which it depends on them [-]: rounding."""


@njit(cache=True)
def solve_few(
    hessian: Array,
    gradient: Array,
    matrix: Array,
    lower: Array,
    upper: Array,
    factor: Array,
    shift: Array,
    marks: Flags,
    rows: Index,
    whitened: Array,
    bounds: Array,
    full: Array,
    broken: float,
    accepted: float,
    z: Array,
) -> float:
    """Minimum without rows, and where it breaks any, that with the marked rows and those broken.

    Args:
        hessian: H, positive definite (nz, nz).
        gradient: f (nz,).
        matrix: General rows (m, nz).
        lower: Lower bounds of the nb simple rows, then of the general rows (nb + m,).
        upper: Upper bounds, likewise (nb + m,).
        factor: Out: see ``free_minimum``.
        shift: Out: likewise.
        marks: In and out: rows that are likely to be active; those that are, when it was solved (nb + m,).
        rows: Memory (nb + m,).
        whitened: Memory (nb + m, nz).
        bounds: Memory (2, nb + m).
        full: Out: multipliers of all rows, when any is active (nb + m,).
        broken: By how much, of its size, an answer may break a row [-].
        accepted: Largest KKT residual at which the minimum without rows is taken.
        z: Out (nz,).

    Returns:
        KKT residual of ``kkt_residual``; infinity when the problem is one for a general solver, NaN when H is not
        positive definite.
    """
    residual = free_minimum(hessian, gradient, factor, shift, z)
    if not residual < np.inf:
        return residual
    if mark_broken(matrix, lower, upper, z, 0.0, marks) == 0:
        marks[:] = False
        return residual
    sides, dual = np.zeros(MANY, dtype=np.int8), np.zeros(MANY)
    for _ in range(_ROUNDS):
        if np.count_nonzero(marks) > MANY:
            return np.inf
        k = whiten(factor, matrix, lower, upper, marks, rows, whitened, bounds)
        if not _active_rows(whitened[:k], bounds[:, :k], shift, sides, dual):
            return np.inf
        for i in range(z.shape[0]):
            z[i] = -shift[i]
            for a in range(k):
                z[i] -= dual[a] * whitened[a, i]
        residual = judge(hessian, gradient, matrix, lower, upper, factor, z, rows[:k], dual[:k], broken, marks, full)
        if residual != np.inf:
            return residual
    return np.inf


@njit(cache=True)
def _active_rows(rows: Array, bounds: Array, shift: Array, sides: NDArray[np.int8], dual: Array) -> bool:
    r"""Multipliers ``u`` of ``min 1/2 |w + s|^2`` within the bounds of the rows, by the dual active-set method.

    .. math:: w = -s - A^T u, \quad A_a A_a^T u_a = -A_a s - b_a

    The row broken most is added: its multiplier grows, by which those of the active rows shrink, until the row holds or
    one of them vanishes and its row is dropped. All of it in products of the rows, of which there are few.

    Args:
        rows: A (k, nz).
        bounds: Lower and upper ones (2, k).
        shift: s (nz,).
        sides: Memory (>= k,).
        dual: Out: u, positive at an upper bound (>= k,).

    Returns:
        Whether it came to an end; not where rows all but depend on each other or contradict each other.

    References:
        Goldfarb, Idnani: A numerically stable dual method for solving strictly convex quadratic programs (1983).
    """
    k, nz = rows.shape
    gram, free = np.empty((k, k)), np.empty(k)
    for a in range(k):
        total = 0.0
        for i in range(nz):
            total -= rows[a, i] * shift[i]
        free[a] = total
        for b in range(a + 1):
            total = 0.0
            for i in range(nz):
                total += rows[a, i] * rows[b, i]
            gram[a, b] = gram[b, a] = total
    value, size, ratio = free.copy(), np.zeros(k), np.empty(k)  # size: of the multipliers
    sides[:] = 0
    added = -1
    for _ in range(_CHANGES):
        if added < 0:
            added = _most_broken(value, bounds, sides)
            if added < 0:
                return _hold(gram, free, bounds, sides, dual)
            side = 1 if value[added] > bounds[1, added] else -1
            excess = value[added] - bounds[1, added] if side > 0 else bounds[0, added] - value[added]
            size[added] = 0.0
        # ratio: by how much the multipliers of the active rows shrink for each unit of the new one
        if not _solve_active(gram, side * gram[added], sides, ratio):
            return False
        left, until, blocking = gram[added, added], np.inf, -1
        for a in range(k):
            if sides[a] != 0:
                left -= side * gram[added, a] * ratio[a]
                shrink = ratio[a] * sides[a]
                if shrink > 0.0 and size[a] < until * shrink:
                    until, blocking = size[a] / shrink, a
        whole = excess / left if left > _DEPENDENT * gram[added, added] else np.inf
        step = min(whole, until)
        if step == np.inf:
            return False
        size[added] += step
        excess -= step * left
        for a in range(k):
            if sides[a] != 0:
                size[a] -= step * ratio[a] * sides[a]
        for a in range(k):
            value[a] -= step * side * gram[added, a]
            for b in range(k):
                if sides[b] != 0:
                    value[a] += step * ratio[b] * gram[a, b]
        if whole <= until:
            sides[added], added = side, -1
        else:
            sides[blocking] = 0
    return False


@njit(cache=True)
def _most_broken(value: Array, bounds: Array, sides: NDArray[np.int8]) -> int:
    """The row, not active, that is broken most, beyond rounding; -1 for none."""
    found, most = -1, 0.0
    for a in range(value.shape[0]):
        if sides[a] == 0:
            excess = max(value[a] - bounds[1, a], bounds[0, a] - value[a])
            if excess > max(most, _ROUNDING * (1.0 + abs(value[a]))):
                found, most = a, excess
    return found


@njit(cache=True)
def _hold(gram: Array, free: Array, bounds: Array, sides: NDArray[np.int8], dual: Array) -> bool:
    """Multipliers that hold the active rows at their bounds, from those alone: rounding of steps does not add up."""
    right = np.zeros(free.shape[0])
    for a in range(free.shape[0]):
        if sides[a] != 0:
            right[a] = free[a] - (bounds[1, a] if sides[a] > 0 else bounds[0, a])
    return _solve_active(gram, right, sides, dual)


@njit(cache=True)
def _solve_active(gram: Array, right: Array, sides: NDArray[np.int8], out: Array) -> bool:
    """Solve ``gram out = right`` for the active rows, zero elsewhere; whether they are independent."""
    k = right.shape[0]
    active, lower, solved = np.empty(k, dtype=np.int64), np.empty((k, k)), np.empty(k)
    count = 0
    for a in range(k):
        out[a] = 0.0
        if sides[a] != 0:
            active[count] = a
            count += 1
    for i in range(count):
        total = right[active[i]]
        for j in range(i + 1):
            product = gram[active[i], active[j]]
            for c in range(j):
                product -= lower[i, c] * lower[j, c]
            if i > j:
                lower[i, j] = product / lower[j, j]
                total -= lower[i, j] * solved[j]
            elif product > _DEPENDENT * gram[active[i], active[i]]:
                lower[i, i] = np.sqrt(product)
            else:
                return False
        solved[i] = total / lower[i, i]
    for i in range(count - 1, -1, -1):
        for c in range(i + 1, count):
            solved[i] -= lower[c, i] * solved[c]
        solved[i] /= lower[i, i]
        out[active[i]] = solved[i]
    return True
