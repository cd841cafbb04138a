"""Compiled kernels that fill the reduced QP's cost and rows, and that recover the full solution."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@njit(cache=True)
def assemble_cost(
    jacobian: Array,
    target: Array,
    weight: Array,
    posture_target: Array,
    posture_weight: Array,
    basis: Array,
    start: Array,
    maps: Array,
    offsets: Array,
    wrench_target: Array,
    wrench_weight: Array,
    regularisation: float,
    hessian: Array,
    gradient: Array,
) -> None:
    """Cost ``1/2 z'Hz + f'z`` of the weighted tasks, the posture and the wrench regularisation.

    Each task row contributes ``weight (J a - target)^2 / 2`` with ``a = N z + a0``; wrench rows likewise with
    ``w_i = P_i z + p_i``.

    Args:
        jacobian: Stacked task Jacobians (m, nv).
        target: Wanted task accelerations less drifts (m,).
        weight: (m,).
        posture_target: Wanted joint accelerations (nj,).
        posture_weight: (nj,).
        basis: N (nv, na) and a0 (nv,).
        start: N (nv, na) and a0 (nv,).
        maps: P (2, 6, nz) and p (2, 6).
        offsets: P (2, 6, nz) and p (2, 6).
        wrench_target: (2, 6).
        wrench_weight: (2, 6).
        regularisation: Added to the diagonal of H.
        hessian: Out (nz, nz).
        gradient: Out (nz,).
    """
    m, nv = jacobian.shape
    na = basis.shape[1]
    nz = hessian.shape[0]
    nj = nv - 6
    rows = np.zeros((m + 12, nz))
    errors = np.zeros(m + 12)
    for i in range(m):
        root = np.sqrt(weight[i])
        if root == 0.0:
            continue
        error = -target[i]
        for k in range(nv):
            value = jacobian[i, k]
            if value == 0.0:
                continue
            error += value * start[k]
            value *= root
            for c in range(na):
                rows[i, c] += value * basis[k, c]
        errors[i] = root * error
    for foot in range(2):
        for i in range(6):
            root = np.sqrt(wrench_weight[foot, i])
            line = m + 6 * foot + i
            errors[line] = root * (offsets[foot, i] - wrench_target[foot, i])
            for c in range(nz):
                rows[line, c] = root * maps[foot, i, c]
    hessian[:, :] = 0.0
    gradient[:] = 0.0
    for i in range(m + 12):
        for r in range(nz):
            value = rows[i, r]
            if value == 0.0:
                continue
            gradient[r] += value * errors[i]
            for c in range(r, nz):
                hessian[r, c] += value * rows[i, c]
    for k in range(nj):
        w = posture_weight[k]
        error = start[6 + k] - posture_target[k]
        for r in range(na):
            value = w * basis[6 + k, r]
            if value == 0.0:
                continue
            gradient[r] += value * error
            for c in range(r, na):
                hessian[r, c] += value * basis[6 + k, c]
    for r in range(nz):
        hessian[r, r] += regularisation
        for c in range(r):
            hessian[r, c] = hessian[c, r]


@njit(cache=True)
def assemble_rows(
    mode: int,
    mass_matrix: Array,
    bias: Array,
    jacobian_1: Array,
    jacobian_2: Array,
    upper: Index,
    legs: Index,
    basis: Array,
    start: Array,
    maps: Array,
    offsets: Array,
    cone: Array,
    cone_lower: Array,
    cone_upper: Array,
    torque_max: Array,
    acceleration_lower: Array,
    acceleration_upper: Array,
    row_scale: Array,
    matrix: Array,
    lower: Array,
    upper_bound: Array,
) -> int:
    """Rows ``lower <= A z <= upper``: first simple bounds on the upper-body accelerations, then general rows.

    General rows in order: wrench cones of the feet in contact, joint torques (all joints), leg accelerations.

    Args:
        mode: Contact mode: 0 none, 1 first foot, 2 second foot, 3 both.
        mass_matrix: Dynamics.
        bias: Dynamics.
        jacobian_1: Sole Jacobians (6, nv).
        jacobian_2: Sole Jacobians (6, nv).
        upper: Velocity indices outside the legs (nu,).
        legs: Velocity indices of both legs (nl,).
        basis: N and a0.
        start: N and a0.
        maps: P and p.
        offsets: P and p.
        cone: Wrench cone of each foot (2, rows, 6), scaled.
        cone_lower: Its bounds (2, rows).
        cone_upper: Its bounds (2, rows).
        torque_max: (nj,).
        acceleration_lower: (nj,).
        acceleration_upper: (nj,).
        row_scale: Scale of torque rows and of acceleration rows (2,).
        matrix: Out, general rows (>= used, nz).
        lower: Out, bounds of the simple rows, then of the general rows.
        upper_bound: Out, bounds of the simple rows, then of the general rows.

    Returns:
        Number of general rows used.
    """
    nz = matrix.shape[1]
    na = basis.shape[1]
    nu = upper.shape[0]
    nv = mass_matrix.shape[0]
    nj = nv - 6
    for i in range(nu):
        lower[i] = acceleration_lower[upper[i] - 6]
        upper_bound[i] = acceleration_upper[upper[i] - 6]
    used = 0
    for foot in range(2):
        if mode != 3 and mode != foot + 1:
            continue
        for i in range(cone.shape[1]):
            constant = 0.0
            for c in range(nz):
                matrix[used, c] = 0.0
            for k in range(6):
                value = cone[foot, i, k]
                if value == 0.0:
                    continue
                constant += value * offsets[foot, k]
                for c in range(nz):
                    matrix[used, c] += value * maps[foot, k, c]
            lower[nu + used] = cone_lower[foot, i] - constant
            upper_bound[nu + used] = cone_upper[foot, i] - constant
            used += 1
    torque_scale, acceleration_scale = row_scale[0], row_scale[1]
    for j in range(nj):
        scale = torque_scale / torque_max[j]
        constant = bias[6 + j] * scale
        for c in range(nz):
            matrix[used, c] = 0.0
        for k in range(nv):
            value = mass_matrix[6 + j, k] * scale
            if value == 0.0:
                continue
            constant += value * start[k]
            for c in range(na):
                matrix[used, c] += value * basis[k, c]
        for foot in range(2):
            if mode != 3 and mode != foot + 1:
                continue
            for k in range(6):
                value = (jacobian_1[k, 6 + j] if foot == 0 else jacobian_2[k, 6 + j]) * scale
                if value == 0.0:
                    continue
                constant -= value * offsets[foot, k]
                for c in range(nz):
                    matrix[used, c] -= value * maps[foot, k, c]
        lower[nu + used] = -torque_scale - constant
        upper_bound[nu + used] = torque_scale - constant
        used += 1
    for i in range(legs.shape[0]):
        row = legs[i]
        for c in range(nz):
            matrix[used, c] = basis[row, c] * acceleration_scale if c < na else 0.0
        lower[nu + used] = (acceleration_lower[row - 6] - start[row]) * acceleration_scale
        upper_bound[nu + used] = (acceleration_upper[row - 6] - start[row]) * acceleration_scale
        used += 1
    return used


@njit(cache=True)
def recover(
    z: Array,
    mass_matrix: Array,
    bias: Array,
    jacobian_1: Array,
    jacobian_2: Array,
    basis: Array,
    start: Array,
    maps: Array,
    offsets: Array,
    acceleration: Array,
    wrenches: Array,
    torque: Array,
) -> None:
    """Accelerations (nv,), wrenches (2, 6) and joint torques ``M_j a + h_j - sum J_ij' w_i`` (nj,) of a solution z."""
    nv, na = basis.shape
    nz = z.shape[0]
    for i in range(nv):
        total = start[i]
        for c in range(na):
            total += basis[i, c] * z[c]
        acceleration[i] = total
    for foot in range(2):
        for i in range(6):
            total = offsets[foot, i]
            for c in range(nz):
                total += maps[foot, i, c] * z[c]
            wrenches[foot, i] = total
    for j in range(nv - 6):
        total = bias[6 + j]
        for k in range(nv):
            total += mass_matrix[6 + j, k] * acceleration[k]
        for i in range(6):
            total -= jacobian_1[i, 6 + j] * wrenches[0, i] + jacobian_2[i, 6 + j] * wrenches[1, i]
        torque[j] = total


@njit(cache=True)
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
        hessian: Cost (nz, nz), (nz,).
        gradient: Cost (nz, nz), (nz,).
        matrix: General rows (m, nz).
        lower: Bounds (nb + m,); nb = number of simple bounds.
        upper: Bounds (nb + m,); nb = number of simple bounds.
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
    for r in range(nz):
        quadratic = 0.0
        for c in range(nz):
            quadratic += hessian[r, c] * z[c]
        dual = multipliers[r] if r < nb else 0.0
        for i in range(m):
            if multipliers[nb + i] != 0.0:
                dual += matrix[i, r] * multipliers[nb + i]
        worst = max(worst, abs(quadratic + gradient[r] + dual))
        scale = max(scale, abs(quadratic), abs(gradient[r]), abs(dual))
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
