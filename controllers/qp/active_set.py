"""Active-set solver of the whole-body QP for few active rows, and KKT residual of a solution."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.numerics.compiled import njit
from models.numerics.unboxed import Unboxed

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Flags = NDArray[np.bool_]

MARKED_MAX = 48  #: Largest number of marked rows; more require a general solver
_ROUNDS = 5  #: Largest number of rounds that add violated rows
_CHANGES = 4 * MARKED_MAX  #: Largest number of rows added or dropped in one round
_ROUNDING = 1e-12  #: Largest excess over a bound, relative to the value, that is not a violation [-]
_DEPENDENT = 1e-10  #: Relative squared norm of a row outside the span of the others, below which it is dependent [-]
_VIOLATION = 1e-9  #: Largest relative violation of unmarked rows for an accepted solution [-]


class QP(NamedTuple):
    """``minimise 1/2 z'Hz + f'z  subject to  lower <= A z <= upper``."""

    hessian: Array  #: H, positive definite (nz, nz)
    gradient: Array  #: f (nz,)
    matrix: Array  #: A (m, nz)
    lower: Array  #: (m,)
    upper: Array  #: (m,)
    soft: Flags  #: Rows that a relaxed solve may violate at a cost (m,)


class Workspace(NamedTuple):
    """Memory of ``solve_few`` for problems of one size."""

    factor: Array  #: L of H = L L', with inverted diagonal (nz, nz)
    shift: Array  #: L^-1 f (nz,)
    marks: Flags  #: Rows to satisfy: active in the last solution, or violated since (m,)
    rows: Index  #: Indices of the marked rows (m,)
    whitened: Array  #: Marked rows in coordinates in which H is the identity (m, nz)
    bounds: Array  #: Lower and upper bounds of the marked rows (2, m)
    multipliers: Array  #: Multipliers of all rows (m,)


def make_workspace(qp: QP) -> Workspace:
    """Allocate the workspace for problems of the size of ``qp``."""
    m, nz = qp.matrix.shape
    return Workspace(
        np.zeros((nz, nz)),
        np.zeros(nz),
        np.zeros(m, dtype=bool),
        np.zeros(m, dtype=np.int64),
        np.zeros((m, nz)),
        np.zeros((2, m)),
        np.zeros(m),
    )


@njit(cache=True, forceinline=True, fastmath={"reassoc"})
def all_finite(qp: QP) -> bool:
    """Whether Hessian, gradient and rows are finite (by their sum) and the bounds contain no NaN."""
    total = 0.0
    for i in range(qp.gradient.size):
        total += qp.gradient[i]
    flat = qp.hessian.reshape(qp.hessian.size)
    for i in range(flat.size):
        total += flat[i]
    flat = qp.matrix.reshape(qp.matrix.size)
    for i in range(flat.size):
        total += flat[i]
    for i in range(qp.lower.size):
        if np.isnan(qp.lower[i]) or np.isnan(qp.upper[i]):
            return False
    return bool(np.isfinite(total))


class Prepared(NamedTuple):
    """A problem, overwritten in every tick, with its workspace."""

    qp: QP
    work: Workspace


@njit(cache=True)
def solve_few(problem: Unboxed[Prepared], z: Array) -> float:
    """Compute the minimiser z (nz,) of the QP with an active-set method that considers only few rows.

    ``marks`` contains the rows that are likely active; after a solution, the active rows. Violated rows are added.
    Returns the residual of ``kkt_residual``; infinity when a general solver is required; NaN when H is not positive
    definite or the problem is not finite.
    """
    qp, work = problem.record.qp, problem.record.work
    residual = free_minimum(qp, work, z) if all_finite(qp) else np.nan
    if not residual < np.inf:
        return residual
    marks = work.marks
    if mark_violated(qp, z, 0.0, marks) == 0:
        marks[:] = False
        work.multipliers[:] = 0.0
        return residual
    sides, dual = np.zeros(MARKED_MAX, dtype=np.int8), np.zeros(MARKED_MAX)
    for _ in range(_ROUNDS):
        if np.count_nonzero(marks) > MARKED_MAX:
            return np.inf
        k = _whiten(qp, work)
        if not _active_rows(work.whitened[:k], work.bounds[:, :k], work.shift, sides, dual):
            return np.inf
        for i in range(z.shape[0]):
            z[i] = -work.shift[i]
            for a in range(k):
                z[i] -= dual[a] * work.whitened[a, i]
        _solve_transposed(work.factor, z)
        if mark_violated(qp, z, _VIOLATION, marks) > 0:
            continue
        work.multipliers[:] = 0.0
        marks[:] = False
        for a in range(k):
            work.multipliers[work.rows[a]] = dual[a]
            marks[work.rows[a]] = dual[a] != 0.0
        return kkt_residual(qp, z, work.multipliers)
    return np.inf


@njit(cache=True, forceinline=True, fastmath={"reassoc", "contract"})
def free_minimum(qp: QP, work: Workspace, z: Array) -> float:
    """Compute the unconstrained minimiser by Cholesky; returns its KKT residual, NaN if H is not positive definite."""
    hessian, gradient, factor, shift = qp.hessian, qp.gradient, work.factor, work.shift
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


@njit(cache=True, forceinline=True, fastmath={"reassoc", "contract"})
def mark_violated(qp: QP, z: Array, tolerance: float, marks: Flags) -> int:
    """Mark the rows that z violates by more than ``tolerance (1 + |value|)``; returns their number."""
    count = 0
    for i in range(qp.matrix.shape[0]):
        value = 0.0
        for c in range(z.shape[0]):
            value += qp.matrix[i, c] * z[c]
        slack = tolerance * (1.0 + abs(value))
        if not qp.lower[i] - slack <= value <= qp.upper[i] + slack:
            marks[i] = True
            count += 1
    return count


@njit(cache=True, fastmath={"reassoc", "contract"})
def _whiten(qp: QP, work: Workspace) -> int:
    """Transform the marked rows to ``w = L' z``, in which H is the identity: ``a' L^-T``; returns their number."""
    factor, count = work.factor, 0
    for row in range(qp.lower.shape[0]):
        if not work.marks[row]:
            continue
        work.rows[count] = row
        work.bounds[0, count], work.bounds[1, count] = qp.lower[row], qp.upper[row]
        out = work.whitened[count]
        out[:] = qp.matrix[row]
        for i in range(factor.shape[0]):
            total = out[i]
            for k in range(i):
                total -= factor[i, k] * out[k]
            out[i] = total * factor[i, i]
        count += 1
    return count


@njit(cache=True, fastmath={"reassoc", "contract"})
def _solve_transposed(factor: Array, z: Array) -> None:
    """Solve L' z = z in place."""
    for i in range(z.shape[0] - 1, -1, -1):
        z[i] *= factor[i, i]
        for k in range(i):
            z[k] -= factor[i, k] * z[i]


@njit(cache=True)
def _active_rows(rows: Array, bounds: Array, shift: Array, sides: NDArray[np.int8], dual: Array) -> bool:
    r"""Multipliers ``u`` of ``min 1/2 |w + s|^2`` within the bounds of the rows, by the dual active-set method.

    .. math:: w = -s - A^T u, \quad A_a A_a^T u_a = -A_a s - b_a

    Each iteration adds the most violated row. Its multiplier grows and the multipliers of the active rows change, until
    the row is satisfied, or an active multiplier vanishes and its row is dropped. Only inner products of the few rows A
    (k, nz) are needed. ``dual`` is u, positive at an upper bound. Returns False if rows are dependent or inconsistent.

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
    value, size, ratio = free.copy(), np.zeros(k), np.empty(k)  # size: magnitude of the multipliers
    sides[:] = 0
    added = -1
    for _ in range(_CHANGES):
        if added < 0:
            added = _most_violated(value, bounds, sides)
            if added < 0:
                return _multipliers_of_active(gram, free, bounds, sides, dual)
            side = 1 if value[added] > bounds[1, added] else -1
            excess = value[added] - bounds[1, added] if side > 0 else bounds[0, added] - value[added]
            size[added] = 0.0
        # ratio: decrease of the multipliers of the active rows per unit of the new multiplier
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
def _most_violated(value: Array, bounds: Array, sides: NDArray[np.int8]) -> int:
    """Most violated inactive row, beyond rounding; -1 if there is none."""
    found, most = -1, 0.0
    for a in range(value.shape[0]):
        if sides[a] == 0:
            excess = max(value[a] - bounds[1, a], bounds[0, a] - value[a])
            if excess > max(most, _ROUNDING * (1.0 + abs(value[a]))):
                found, most = a, excess
    return found


@njit(cache=True)
def _multipliers_of_active(gram: Array, free: Array, bounds: Array, sides: NDArray[np.int8], dual: Array) -> bool:
    """Solve for the multipliers of the active rows at their bounds, without the rounding errors of the iterations."""
    right = np.zeros(free.shape[0])
    for a in range(free.shape[0]):
        if sides[a] != 0:
            right[a] = free[a] - (bounds[1, a] if sides[a] > 0 else bounds[0, a])
    return _solve_active(gram, right, sides, dual)


@njit(cache=True)
def _solve_active(gram: Array, right: Array, sides: NDArray[np.int8], out: Array) -> bool:
    """Solve ``gram out = right`` for the active rows; zero elsewhere. Returns whether the rows are independent."""
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


@njit(cache=True, fastmath={"reassoc", "contract"})
def kkt_residual(qp: QP, z: Array, multipliers: Array) -> float:
    """Maximum of the residuals of stationarity, primal feasibility and complementarity; NaN if z is not finite.

    Multipliers y (m,) are positive at an upper bound and negative at a lower one. With maximum norms, the residual of
    stationarity is |H z + f + A' y| / max(1, |H z|, |f|, |A' y|).
    """
    nz, m = z.shape[0], qp.matrix.shape[0]
    worst, scale, largest = 0.0, 1.0, 1.0
    duals = np.zeros(nz)
    for i in range(m):
        multiplier = multipliers[i]
        largest = max(largest, abs(multiplier))
        if multiplier != 0.0:
            for r in range(nz):
                duals[r] += qp.matrix[i, r] * multiplier
    for r in range(nz):
        quadratic = 0.0
        for c in range(nz):
            quadratic += qp.hessian[r, c] * z[c]
        worst = max(worst, abs(quadratic + qp.gradient[r] + duals[r]))
        scale = max(scale, abs(quadratic), abs(qp.gradient[r]), abs(duals[r]))
        if not np.isfinite(z[r]):
            return np.nan
    worst /= scale
    for i in range(m):
        value = 0.0
        for c in range(nz):
            value += qp.matrix[i, c] * z[c]
        size = 1.0 + abs(value)
        worst = max(worst, (qp.lower[i] - value) / size, (value - qp.upper[i]) / size)
        if multipliers[i] > 0.0:
            worst = max(worst, min(multipliers[i] / largest, abs(qp.upper[i] - value) / size))
        elif multipliers[i] < 0.0:
            worst = max(worst, min(-multipliers[i] / largest, abs(value - qp.lower[i]) / size))
    return worst
