"""Solves the reduced QP: few rows in compiled code, daqp, quadprog as the checked fallback, a softened problem."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

import daqp
import numpy as np
import quadprog
from msgspec import Struct

from controllers.qp.build import QP
from controllers.qp.kernels_check import all_finite, kkt_residual
from controllers.qp.kernels_few_rows import solve_few
from controllers.qp.kernels_whiten import free_minimum
from models.types import SolveStatus, Vector

_HARD = 0
_SOFT = 8
_OPTIMAL = (1, 2)
"""daqp exit flags: optimal, optimal with soft constraints in use."""

_BROKEN = 1e-9
"""By how much, of its size, the answer for few rows may break a row that it does not hold [-]."""

_EXACT = 1e-9
"""Largest KKT residual of an answer for few rows; rows that all but depend on each other are left to daqp [-]."""


class Solution(Struct, frozen=True):
    """Answer of one solve.

    Attributes:
        z: Minimiser (nz,), or None when no solver found one.
        status: How it was found; ``HELD`` when none was.
        residual: Scaled KKT residual; NaN when there is no answer.
        time: Wall-clock duration of the solve [s], for reports only.
    """

    z: Vector | None
    status: SolveStatus
    residual: float
    time: float


class _Workspace:
    """Memory for problems of one size.

    Args:
        nz: Number of unknowns.
        rows: Number of rows, simple ones included.
    """

    def __init__(self, nz: int, rows: int) -> None:
        self.nz = nz
        self.marks = np.zeros(rows, dtype=bool)  # rows to hold: those active in the last answer, and those broken
        self.arrays = (
            np.zeros((nz, nz)),
            np.zeros(nz),
            self.marks,
            np.zeros(rows, dtype=np.int64),
            np.zeros((rows, nz)),
            np.zeros((2, rows)),
            np.zeros(rows),
        )  # as ``solve_few`` wants them
        self.free = self.arrays[:2]  # as ``free_minimum`` wants them
        self.sense = np.zeros(rows, dtype=np.int32)
        self.held = False  # whether the last answer held any row


class QPSolver:
    """Solve, check the KKT conditions, fall back in order.

    1. The minimum without rows, where it breaks none; a QP that tells that by itself (``QP.keeps``) is spared its rows.
    2. That with the rows that were active on the last tick, those that this minimum breaks, and those that its answers
       break (``kernels_few_rows.py``): few of a hundred rows are ever active.
    3. daqp with all rows, quadprog with all rows, daqp with soft rows.

    Each answer is judged by its KKT residual in the whole problem.

    The softened problem keeps torque limits and wrench cones hard and lets the joint-limit rows give way, at the
    price ``|violation|^2 / (2 rho)``.

    Args:
        residual_max: Largest accepted KKT residual.
        iterations_max: daqp's iteration limit.
        soft_rho: daqp's weight of violated soft rows.
    """

    def __init__(self, residual_max: float, iterations_max: int, soft_rho: float) -> None:
        self._residual_max, self._accepted = residual_max, min(residual_max, _EXACT)
        self._iterations = iterations_max
        self._rho = soft_rho
        self._workspaces: dict[tuple[int, int], _Workspace] = {}
        self._warm_up()

    def _warm_up(self) -> None:
        """Compile every check now: the loop itself never waits for a compiler."""
        for lower in (0.0, 2.0):  # with an active row, and without a solution
            rows = np.array([[1.0]])
            self.solve(QP(rows, rows[0], rows, np.array([0.0, lower]), np.ones(2), np.array([False, True])))

    def reset(self) -> None:
        """Forget which rows were active."""
        for work in self._workspaces.values():
            work.marks[:] = False
            work.held = False

    def solve(self, qp: QP) -> Solution:
        """Solve one QP; never raises, a failure is in the status."""
        start = perf_counter()
        work = self._workspace(qp)
        if qp.complete is not None:
            if not work.held and qp.keeps is not None:
                z, residual = self._free(qp, work, qp.keeps)
                if z is not None:
                    return Solution(z, SolveStatus.OPTIMAL, residual, perf_counter() - start)
            qp.complete()
        finite = all_finite(qp.hessian, qp.gradient, qp.matrix) if qp.finite is None else qp.finite
        if not finite:
            return Solution(None, SolveStatus.HELD, float("nan"), perf_counter() - start)
        z, residual = self._few_rows(qp, work)
        if z is not None:
            return Solution(z, SolveStatus.OPTIMAL, residual, perf_counter() - start)
        z, residual, infeasible = self._daqp(qp, work)
        if z is not None:
            return Solution(z, SolveStatus.OPTIMAL, residual, perf_counter() - start)
        if not infeasible:
            z, residual = self._quadprog(qp)
            if z is not None:
                return Solution(z, SolveStatus.FALLBACK_SOLVER, residual, perf_counter() - start)
        z, residual = self._relaxed(qp)
        if z is not None:
            return Solution(z, SolveStatus.RELAXED, residual, perf_counter() - start)
        return Solution(None, SolveStatus.HELD, float("nan"), perf_counter() - start)

    def _workspace(self, qp: QP) -> _Workspace:
        size = qp.gradient.shape[0], qp.lower.shape[0]
        work = self._workspaces.get(size)
        if work is None:
            work = self._workspaces[size] = _Workspace(*size)
        return work

    def _free(self, qp: QP, work: _Workspace, keeps: Callable[[Vector], bool]) -> tuple[Vector | None, float]:
        """The minimum without rows, where it breaks none."""
        z: Vector = np.empty(work.nz)
        residual = free_minimum(qp.hessian, qp.gradient, *work.free, z)
        return (z, residual) if residual < self._accepted and keeps(z) else (None, residual)

    def _few_rows(self, qp: QP, work: _Workspace) -> tuple[Vector | None, float]:
        z: Vector = np.empty(work.nz)
        residual = solve_few(
            qp.hessian, qp.gradient, qp.matrix, qp.lower, qp.upper, *work.arrays, _BROKEN, self._accepted, z
        )
        if residual < self._accepted:
            work.held = 1 in work.marks.tobytes()  # numpy's any() takes ten times as long
            return z, residual
        work.marks[:] = work.held = False
        return None, residual

    def _daqp(self, qp: QP, work: _Workspace) -> tuple[Vector | None, float, bool]:
        z, _, flag, info = daqp.solve(
            qp.hessian, qp.gradient, qp.matrix, qp.upper, qp.lower, work.sense, iter_limit=self._iterations
        )
        if flag not in _OPTIMAL:
            return None, float("nan"), flag == -1
        residual = kkt_residual(qp.hessian, qp.gradient, qp.matrix, qp.lower, qp.upper, z, info["lam"])
        return (z, residual, False) if residual < self._residual_max else (None, residual, False)

    def _quadprog(self, qp: QP) -> tuple[Vector | None, float]:
        nz = qp.gradient.shape[0]
        simple = qp.lower.shape[0] - qp.matrix.shape[0]
        rows = np.vstack([np.eye(nz)[:simple], qp.matrix])
        try:
            z, _, _, _, multipliers, _ = quadprog.solve_qp(
                qp.hessian, -qp.gradient, np.vstack([rows, -rows]).T, np.concatenate([qp.lower, -qp.upper])
            )
        except ValueError:
            return None, float("nan")
        count = qp.lower.shape[0]
        signed = multipliers[count:] - multipliers[:count]
        residual = kkt_residual(qp.hessian, qp.gradient, qp.matrix, qp.lower, qp.upper, z, signed)
        return (z, residual) if residual < self._residual_max else (None, residual)

    def _relaxed(self, qp: QP) -> tuple[Vector | None, float]:
        sense = np.where(qp.soft, _SOFT, _HARD).astype(np.int32)
        crossed = qp.soft & (qp.lower > qp.upper)  # rows that contradict themselves
        lower, upper = qp.lower.copy(), qp.upper.copy()
        lower[crossed] = upper[crossed] = 0.5 * (lower[crossed] + upper[crossed])
        z, _, flag, info = daqp.solve(
            qp.hessian,
            qp.gradient,
            qp.matrix,
            upper,
            lower,
            sense,
            iter_limit=self._iterations,
            rho_soft=self._rho,
        )
        if flag not in _OPTIMAL or not np.isfinite(z).all():
            return None, float("nan")
        # The answer is optimal for bounds moved to where the soft rows ended; the hard ones stay where they were.
        values = np.concatenate([z[: len(qp.lower) - len(qp.matrix)], qp.matrix @ z])
        lower = np.where(qp.soft, np.minimum(lower, values), lower)
        upper = np.where(qp.soft, np.maximum(upper, values), upper)
        residual = kkt_residual(qp.hessian, qp.gradient, qp.matrix, lower, upper, z, info["lam"])
        return (z, residual) if residual < self._residual_max else (None, residual)
