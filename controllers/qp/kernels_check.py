"""Compiled checks of a QP before it is solved and of its answer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.compiled import njit

Array = NDArray[np.float64]


@njit(cache=True, fastmath={"reassoc"})
def all_finite(matrix: Array, vector: Array, rows: Array) -> bool:
    """Whether a QP's Hessian, gradient and rows hold neither NaN nor infinity (a sum shows either)."""
    total = 0.0
    for i in range(vector.size):
        total += vector[i]
    flat = matrix.reshape(matrix.size)
    for i in range(flat.size):
        total += flat[i]
    flat = rows.reshape(rows.size)
    for i in range(flat.size):
        total += flat[i]
    return bool(np.isfinite(total))


@njit(cache=True)
def finite_state(q: Array, v: Array) -> bool:
    """Whether a configuration (nq,) and a velocity (nv,) hold neither NaN nor infinity."""
    total = 0.0
    for i in range(q.shape[0]):
        total += q[i]
    for i in range(v.shape[0]):
        total += v[i]
    return bool(np.isfinite(total))


@njit(cache=True, fastmath={"reassoc", "contract"})
def kkt_residual(
    hessian: Array,
    gradient: Array,
    matrix: Array,
    lower: Array,
    upper: Array,
    z: Array,
    multipliers: Array,
) -> float:
    """Largest of stationarity, primal violation, wrong multiplier sign and complementarity, scaled.

    With simple bounds first and multipliers positive at an upper bound, negative at a lower one::

        stationarity = |H z + f + A' y| / (1 + |H z| + |f| + |A' y|)   (largest entries)

    Args:
        hessian: H (nz, nz).
        gradient: f (nz,).
        matrix: General rows (m, nz).
        lower: Lower bounds of the nb simple rows, then of A's rows (nb + m,).
        upper: Upper bounds, likewise (nb + m,).
        z: Solution (nz,).
        multipliers: (nb + m,).

    Returns:
        The residual; NaN if the solution is not finite.
    """
    nz = z.shape[0]
    m = matrix.shape[0]
    nb = lower.shape[0] - m
    worst = 0.0
    scale = 1.0
    largest = 1.0
    for i in range(nb + m):
        largest = max(largest, abs(multipliers[i]))
    duals = np.zeros(nz)
    for r in range(nb):
        duals[r] = multipliers[r]
    for i in range(m):
        multiplier = multipliers[nb + i]
        if multiplier != 0.0:
            for r in range(nz):
                duals[r] += matrix[i, r] * multiplier
    for r in range(nz):
        quadratic = 0.0
        for c in range(nz):
            quadratic += hessian[r, c] * z[c]
        worst = max(worst, abs(quadratic + gradient[r] + duals[r]))
        scale = max(scale, abs(quadratic), abs(gradient[r]), abs(duals[r]))
        if not np.isfinite(z[r]):
            return np.nan
    worst /= scale
    for i in range(nb + m):
        if i < nb:
            value = z[i]
        else:
            value = 0.0
            for c in range(nz):
                value += matrix[i - nb, c] * z[c]
        size = 1.0 + abs(value)
        worst = max(worst, (lower[i] - value) / size, (value - upper[i]) / size)
        if multipliers[i] > 0.0:
            worst = max(worst, min(multipliers[i] / largest, abs(upper[i] - value) / size))
        elif multipliers[i] < 0.0:
            worst = max(worst, min(-multipliers[i] / largest, abs(value - lower[i]) / size))
    return worst
