"""Solves the reduced QP by a configured back-end, checks the KKT residual of each solution, and falls back in order."""

from time import perf_counter
from typing import Any

import daqp
import numpy as np
import quadprog
import scipy.sparse as sp
from msgspec import Struct
from numpy.typing import NDArray

from controllers.qp.active_set import QP, Prepared, Workspace, all_finite, kkt_residual, make_workspace, solve_few
from models.errors import ConfigError
from models.numerics.unboxed import Unboxed, unbox
from models.types import SolveStatus, Vector

Index = NDArray[np.int64]

OWN, DAQP = "own", "daqp"

_HARD, _SOFT = 0, 8  #: Kinds of rows of daqp
_INFEASIBLE = -1  #: Exit flag of daqp: infeasible
_OPTIMAL = (1, 2)  #: Exit flags of daqp: optimal, optimal with violated soft rows
#: Largest accepted KKT residual of the own solver; daqp solves problems with nearly dependent rows [-]
_EXACT = 1e-9
INFINITE = 1e20  #: Magnitude from which a bound is infinite; ``UNBOUNDED`` over the scale of a row is larger
TOLERANCE = 0.01  #: Tolerance of a back-end of qpsolvers, relative to the largest accepted residual [-]
_SPARSE = ("osqp", "clarabel")  #: Back-ends of qpsolvers that work on sparse matrices


class Solution(Struct, frozen=True):
    """Result of one solve."""

    z: Vector | None  #: Minimiser (nz,); None when no solver found one
    status: SolveStatus  #: Solver that found it; ``HELD`` without a solution
    residual: float  #: Scaled KKT residual; NaN without a solution
    time: float  #: Wall-clock duration of the solve [s], for reports only


Answer = tuple[Vector | None, float]  #: Minimiser (None without a solution) and KKT residual
_NO_ANSWER: Answer = (None, float("nan"))


def backends() -> list[str]:
    """Valid values of ``solver.backend``: the own solver, daqp, and the installed back-ends of qpsolvers."""
    import qpsolvers

    return list(dict.fromkeys((OWN, DAQP, *sorted(qpsolvers.available_solvers))))


def solver_options(backend: str, tolerance: float) -> dict[str, Any]:
    """Options that set the tolerance of a back-end of qpsolvers."""
    if backend == "osqp":
        return {"eps_abs": tolerance, "eps_rel": tolerance, "max_iter": 200_000, "polishing": True}
    if backend in ("proxqp", "piqp"):
        return {"eps_abs": tolerance, "eps_rel": 0.0}
    if backend == "clarabel":
        return {"tol_feas": tolerance, "tol_gap_abs": tolerance, "tol_gap_rel": tolerance}
    return {}


class QPSolver:
    """Solves a QP, checks the KKT conditions and falls back in the order below.

    1. The back-end. The own solver tries the unconstrained minimum, then the minimum subject to the rows that were
       active in the last tick and those that its iterates violate. Few of about a hundred rows are active.
    2. daqp, then quadprog if daqp does not report infeasibility.
    3. daqp with soft rows: joint limits and the bounds of normal forces are relaxed at the cost
       ``|violation|^2 / (2 rho)``; torque limits and the other rows of the wrench cones remain hard.

    ``residual_max`` is the largest accepted KKT residual; ``iterations_max`` and ``soft_rho`` are options of daqp;
    ``backend`` is one of ``backends()``. Raises ``ConfigError``, which lists them, for any other.
    """

    def __init__(self, residual_max: float, iterations_max: int, soft_rho: float, backend: str = OWN) -> None:
        if backend not in (OWN, DAQP) and backend not in backends():
            raise ConfigError(f"solver.backend: unknown back-end '{backend}'; installed: {', '.join(backends())}")
        self._residual_max, self._iterations, self._rho = residual_max, iterations_max, soft_rho
        self._workspaces: dict[tuple[int, ...], Workspace] = {}
        self._prepared: dict[int, tuple[QP, Workspace, Unboxed[Prepared]]] = {}
        self._backend, self._tolerance = backend, TOLERANCE * residual_max
        self._accepted = min(residual_max, _EXACT)
        self._warm_up()

    def _warm_up(self) -> None:
        """Compile all kernels, so that no tick waits for the compiler."""
        rows = np.array([[1.0], [1.0]])
        for lower in (0.0, 2.0):  # with an active row, and without a solution
            qp = QP(rows[:1], rows[0], rows, np.array([0.0, lower]), np.ones(2), np.array([False, True]))
            self.solve(qp)

    def prepare(self, qp: QP) -> None:
        """Unbox a problem whose arrays every tick overwrites, so that ``solve`` does not unbox it again."""
        self._prepared[id(qp)] = qp, *self._unbox(qp)

    def _unbox(self, qp: QP) -> tuple[Workspace, Unboxed[Prepared]]:
        """Workspace for the size of a problem, and the problem for compiled code."""
        work = self._workspaces.get(qp.matrix.shape) or make_workspace(qp)
        self._workspaces[qp.matrix.shape] = work
        return work, unbox(Prepared(qp, work))

    def reset(self) -> None:
        """Discard the active set of the last tick."""
        for work in self._workspaces.values():
            work.marks[:] = False

    def solve(self, qp: QP) -> Solution:
        """Solve one QP. Does not raise; the status reports a failure."""
        start = perf_counter()
        z, status, residual = self._solve(qp)
        return Solution(z, status, residual, perf_counter() - start)

    def _solve(self, qp: QP) -> tuple[Vector | None, SolveStatus, float]:
        if self._backend == OWN:  # includes a check for NaN and infinity
            z, residual = self._few_rows(qp)
            if z is not None:
                return z, SolveStatus.OPTIMAL, residual
        if not all_finite(qp):
            return None, SolveStatus.HELD, float("nan")
        if self._backend not in (OWN, DAQP):
            z, residual = self._qpsolvers(qp)
            if z is not None:
                return z, SolveStatus.OPTIMAL, residual
        z, residual, infeasible = self._daqp(qp)
        if z is not None:
            status = SolveStatus.OPTIMAL if self._backend in (OWN, DAQP) else SolveStatus.FALLBACK_SOLVER
            return z, status, residual
        if not infeasible:
            z, residual = self._quadprog(qp)
            if z is not None:
                return z, SolveStatus.FALLBACK_SOLVER, residual
        z, residual = self._relaxed(qp)
        return z, SolveStatus.HELD if z is None else SolveStatus.RELAXED, residual

    def _few_rows(self, qp: QP) -> Answer:
        known = self._prepared.get(id(qp))
        work, problem = known[1:] if known else self._unbox(qp)
        z: Vector = np.empty(len(qp.gradient))
        residual = solve_few(problem, z)
        if residual < self._accepted:
            return z, residual
        work.marks[:] = False
        return _NO_ANSWER

    def _qpsolvers(self, qp: QP) -> Answer:
        import qpsolvers

        problem, upper, lower = to_qpsolvers(qp, self._backend)
        try:
            found = qpsolvers.solve_problem(problem, self._backend, **solver_options(self._backend, self._tolerance))
        except (ValueError, RuntimeError, ArithmeticError, TypeError):
            return _NO_ANSWER
        if not found.found or found.x is None or found.z is None:
            return _NO_ANSWER
        multipliers = np.zeros(len(qp.lower))
        multipliers[upper] += found.z[: len(upper)]
        multipliers[lower] -= found.z[len(upper) :]
        return self._checked(qp, np.ascontiguousarray(found.x), multipliers)

    def _daqp(self, qp: QP) -> tuple[Vector | None, float, bool]:
        z, flag, multipliers = self._call_daqp(qp, np.zeros(len(qp.lower), dtype=np.int32))
        if flag not in _OPTIMAL:
            return None, float("nan"), flag == _INFEASIBLE
        return *self._checked(qp, z, multipliers), False

    def _call_daqp(self, qp: QP, sense: NDArray[np.int32], **options: float) -> tuple[Vector, int, Vector]:
        """Minimiser, exit flag and multipliers for rows of the kinds ``sense``."""
        rows = qp.matrix, qp.upper, qp.lower, sense
        z, _, flag, info = daqp.solve(qp.hessian, qp.gradient, *rows, iter_limit=self._iterations, **options)
        return z, flag, info["lam"]

    def _quadprog(self, qp: QP) -> Answer:
        rows = np.vstack([qp.matrix, -qp.matrix])
        try:
            z, _, _, _, multipliers, _ = quadprog.solve_qp(
                qp.hessian, -qp.gradient, rows.T, np.concatenate([qp.lower, -qp.upper])
            )
        except ValueError:
            return _NO_ANSWER
        count = len(qp.lower)
        return self._checked(qp, z, multipliers[count:] - multipliers[:count])

    def _relaxed(self, qp: QP) -> Answer:
        sense = np.where(qp.soft, _SOFT, _HARD).astype(np.int32)
        crossed = qp.soft & (qp.lower > qp.upper)  # rows with inconsistent bounds
        lower, upper = qp.lower.copy(), qp.upper.copy()
        lower[crossed] = upper[crossed] = 0.5 * (lower[crossed] + upper[crossed])
        z, flag, multipliers = self._call_daqp(qp._replace(lower=lower, upper=upper), sense, rho_soft=self._rho)
        if flag not in _OPTIMAL or not np.isfinite(z).all():
            return _NO_ANSWER
        # The solution is optimal for unchanged hard bounds and soft bounds moved to the values of their rows.
        values = qp.matrix @ z
        lower = np.where(qp.soft, np.minimum(lower, values), lower)
        upper = np.where(qp.soft, np.maximum(upper, values), upper)
        return self._checked(qp._replace(lower=lower, upper=upper), z, multipliers)

    def _checked(self, qp: QP, z: Vector, multipliers: Vector) -> Answer:
        """Return the solution and its residual, or no solution when the residual is too large."""
        residual = kkt_residual(qp, z, multipliers)
        return (z, residual) if residual < self._residual_max else _NO_ANSWER


def to_qpsolvers(qp: QP, backend: str) -> tuple[Any, Index, Index]:
    """Convert to a ``qpsolvers.Problem``; also returns the indices of its rows: upper bounds, then lower ones."""
    import qpsolvers

    upper, lower = np.flatnonzero(qp.upper < INFINITE), np.flatnonzero(qp.lower > -INFINITE)
    hessian: Any = qp.hessian
    rows: Any = np.vstack([qp.matrix[upper], -qp.matrix[lower]])
    if backend in _SPARSE:
        hessian, rows = sp.csc_matrix(hessian), sp.csc_matrix(rows)
    bounds = np.concatenate([qp.upper[upper], -qp.lower[lower]])
    return qpsolvers.Problem(hessian, qp.gradient, rows, bounds), upper, lower
