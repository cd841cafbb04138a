"""Solves recorded QPs with poise's own solver and with back-ends of qpsolvers, and certifies every answer alike."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from time import perf_counter_ns
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.optimize import nnls

from controllers.qp.build import QP
from controllers.qp.solve import QPSolver
from controllers.whole_body_config import WholeBodyConfig
from models.config import default_config
from models.types import Matrix, Vector

OWN = "poise"
"""The tick's own solver."""

BACKENDS = ("daqp", "quadprog", "proxqp", "piqp", "osqp", "clarabel")
"""Back-ends of qpsolvers that are asked for."""

SPARSE = ("osqp", "clarabel")
"""Those that work on sparse matrices: they get them so, and the conversion is not timed."""

INFINITE = 1e20
"""From this size on a bound is none: the tick writes 1e30, divided by the weight, for a row without one."""

Solve = Callable[[], Vector | None]


@dataclass(frozen=True, slots=True)
class Certificate:
    """How far an answer is from being the minimiser; all relative to the size of what is compared.

    Attributes:
        primal: Largest violation of a row [-].
        dual: Largest entry of the gradient of the Lagrangian, multipliers of the right sign chosen best [-].
        gap: Duality gap with these multipliers [-].
    """

    primal: float
    dual: float
    gap: float


def certify(qp: QP, z: Vector | None, tolerances: Sequence[float]) -> Certificate:
    """Certify an answer, whoever gave it: multipliers of the rows it has active come from least squares.

    Args:
        qp: The problem.
        z: The answer (nz,); None for none.
        tolerances: A row so close to its bound, relative to its size, is active [-]: the one that certifies the answer
            best counts, since interior-point methods end a little before their rows.
    """
    if z is None or not np.isfinite(z).all():
        return Certificate(math.inf, math.inf, math.inf)
    return min((_proof(qp, z, tolerance) for tolerance in tolerances), key=lambda proof: max(proof.dual, proof.gap))


def _proof(qp: QP, z: Vector, tolerance: float) -> Certificate:
    """The certificate with one idea of which rows are active."""
    rows = _rows(qp)
    values = rows @ z
    size = 1.0 + np.abs(values)
    below, above = (qp.lower - values) / size, (values - qp.upper) / size
    slack = max(tolerance, 2.0 * float(max(below.max(), above.max(), 0.0)))
    low, high = (below > -slack) & (qp.lower > -INFINITE), (above > -slack) & (qp.upper < INFINITE)
    normals = np.vstack([-rows[low], rows[high]])  # (active, nz), outward
    gradient = qp.hessian @ z + qp.gradient
    scale = 1.0 + float(np.abs(qp.gradient).max())
    if len(normals):
        multipliers, _ = nnls(normals.T, -gradient, maxiter=50 * len(normals))
        pull = normals.T @ multipliers
        bounds = np.concatenate([-qp.lower[low], qp.upper[high]])
        complementary = float(multipliers @ (bounds - normals @ z))
    else:
        pull, complementary = np.zeros_like(z), 0.0
    residual = gradient + pull
    objective = 0.5 * float(z @ qp.hessian @ z) + float(qp.gradient @ z)
    # Primal minus dual objective of these multipliers: what complementarity and stationarity leave.
    gap = abs(float(residual @ z)) + abs(complementary)
    return Certificate(
        primal=float(max(below.max(), above.max(), 0.0)),
        dual=float(np.abs(residual).max()) / scale,
        gap=gap / (1.0 + abs(objective)),
    )


def _rows(qp: QP) -> Matrix:
    """All rows of a problem, simple ones first (rows, nz)."""
    simple = len(qp.lower) - len(qp.matrix)
    return np.vstack([np.eye(len(qp.gradient))[:simple], qp.matrix])


def own_solver() -> QPSolver:
    """The tick's own solver as it is configured."""
    config = default_config(WholeBodyConfig, "controllers", "whole_body").solver
    return QPSolver(config.residual_max, config.iterations_max, config.soft_rho)


def available() -> tuple[list[str], list[str]]:
    """Back-ends that can be used here, and those that are missing."""
    if find_spec("qpsolvers") is None:
        return [], list(BACKENDS)
    import qpsolvers

    found = [name for name in BACKENDS if name in qpsolvers.available_solvers]
    return found, [name for name in BACKENDS if name not in found]


def through_qpsolvers(qp: QP, backend: str, options: dict[str, Any]) -> Solve:
    """A problem as a back-end gets it; calling what is returned solves it, and that alone is to be timed."""
    import qpsolvers

    simple = len(qp.lower) - len(qp.matrix)
    nz = len(qp.gradient)
    lower, upper = np.full(nz, -np.inf), np.full(nz, np.inf)
    lower[:simple], upper[:simple] = qp.lower[:simple], qp.upper[:simple]
    lower[lower < -INFINITE], upper[upper > INFINITE] = -np.inf, np.inf
    rows = np.vstack([qp.matrix, -qp.matrix])
    bounds = np.concatenate([qp.upper[simple:], -qp.lower[simple:]])
    bounded = np.abs(bounds) < INFINITE
    rows, bounds = rows[bounded], bounds[bounded]
    hessian: Any = qp.hessian
    if backend in SPARSE:
        hessian, rows = sp.csc_matrix(qp.hessian), sp.csc_matrix(rows)
    problem = qpsolvers.Problem(hessian, qp.gradient, rows, bounds, lb=lower, ub=upper)

    def solve() -> Vector | None:
        solution = qpsolvers.solve_problem(problem, solver=backend, **options)
        return None if not solution.found or solution.x is None else np.asarray(solution.x)

    return solve


def timed(solve: Solve) -> tuple[Vector | None, float]:
    """Solve once; returns the answer and the time it took [us]. A back-end that raises has no answer."""
    start = perf_counter_ns()
    try:
        z = solve()
    except (ValueError, RuntimeError, ArithmeticError):
        z = None
    return z, (perf_counter_ns() - start) * 1e-3
