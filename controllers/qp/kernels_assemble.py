"""Compiled kernels that fill the reduced QP's cost and rows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from controllers.qp.kernels_wrenches import reduce_row
from models.compiled import njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@njit(cache=True, fastmath={"contract"})
def assemble_cost(
    mode: int,
    jacobian: Array,
    target: Array,
    weight: Array,
    posture_target: Array,
    posture_weight: Array,
    upper: Index,
    core: Index,
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
        mode: Contact mode: 0 none, 1 first foot, 2 second foot, 3 both.
        jacobian: Stacked task Jacobians (m, nv).
        target: Wanted task accelerations less drifts (m,).
        weight: (m,).
        posture_target: Wanted joint accelerations (nj,).
        posture_weight: (nj,).
        upper: Velocity indices outside base and legs (nu,).
        core: Those of the base, then of the legs.
        basis: N (nv, na) and a0 (nv,).
        start: a0 (nv,).
        maps: P (2, 6, nz) and p (2, 6).
        offsets: p (2, 6).
        wrench_target: (2, 6).
        wrench_weight: (2, 6).
        regularisation: Added to the diagonal of H.
        hessian: Out (nz, nz).
        gradient: Out (nz,).
    """
    m = jacobian.shape[0]
    nu, na, nz = upper.shape[0], basis.shape[1], hessian.shape[0]
    rows = np.zeros((m + 12 + 3, nz))  # 3: the sums below take four rows at a time
    errors = np.zeros(m + 12 + 3)
    used = 0
    for i in range(m):
        if weight[i] == 0.0:
            continue
        root = np.sqrt(weight[i])
        errors[used] = (
            reduce_row(jacobian[i], root, mode == 0, upper, core, basis, start, rows[used]) - root * target[i]
        )
        used += 1
    for foot in range(2):
        if mode != 3 and mode != foot + 1:
            continue
        for i in range(6):
            root = np.sqrt(wrench_weight[foot, i])
            errors[used] = root * (offsets[foot, i] - wrench_target[foot, i])
            for c in range(nz):
                rows[used, c] = root * maps[foot, i, c]
            used += 1
    hessian[:, :] = 0.0
    gradient[:] = 0.0
    for i in range(0, used, 4):
        for r in range(nz):
            v0, v1, v2, v3 = rows[i, r], rows[i + 1, r], rows[i + 2, r], rows[i + 3, r]
            gradient[r] += v0 * errors[i] + v1 * errors[i + 1] + v2 * errors[i + 2] + v3 * errors[i + 3]
            for c in range(r, nz):
                hessian[r, c] += (v0 * rows[i, c] + v1 * rows[i + 1, c]) + (v2 * rows[i + 2, c] + v3 * rows[i + 3, c])
    for c in range(nu):
        joint = upper[c] - 6
        hessian[c, c] += posture_weight[joint]
        gradient[c] -= posture_weight[joint] * posture_target[joint]
    for i in range(6, core.shape[0]):
        k = core[i]
        error = start[k] - posture_target[k - 6]
        for r in range(nu, na):
            value = posture_weight[k - 6] * basis[k, r]
            if value == 0.0:
                continue
            gradient[r] += value * error
            for c in range(r, na):
                hessian[r, c] += value * basis[k, c]
    for r in range(nz):
        hessian[r, r] += regularisation
        for c in range(r):
            hessian[r, c] = hessian[c, r]


@njit(cache=True, fastmath={"contract"})
def assemble_rows(
    mode: int,
    mass_matrix: Array,
    bias: Array,
    jacobian_1: Array,
    jacobian_2: Array,
    upper: Index,
    core: Index,
    leg_1: Index,
    leg_2: Index,
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
) -> None:
    """Rows ``lower <= A z <= upper``: first simple bounds on the upper-body accelerations, then general rows.

    General rows in order: wrench cones of the feet in contact, joint torques (all joints), leg accelerations.

    Args:
        mode: Contact mode: 0 none, 1 first foot, 2 second foot, 3 both.
        mass_matrix: Dynamics.
        bias: h (nv,).
        jacobian_1: Sole Jacobians (6, nv).
        jacobian_2: Sole Jacobians (6, nv).
        upper: Velocity indices outside base and legs (nu,).
        core: Those of the base, then of the legs.
        leg_1: Those of each leg (6,).
        leg_2: Those of each leg (6,).
        basis: N and a0.
        start: a0 (nv,).
        maps: P and p.
        offsets: p (2, 6).
        cone: Wrench cone of each foot (2, rows, 6), scaled.
        cone_lower: Its bounds (2, rows).
        cone_upper: Its bounds (2, rows).
        torque_max: (nj,).
        acceleration_lower: (nj,).
        acceleration_upper: (nj,).
        row_scale: Scale of torque rows and of acceleration rows (2,).
        matrix: Out, general rows (m, nz).
        lower: Out, bounds of the simple rows, then of the general rows.
        upper_bound: Out, bounds of the simple rows, then of the general rows.
    """
    nu, na, nz = upper.shape[0], basis.shape[1], matrix.shape[1]
    nj = mass_matrix.shape[0] - 6
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
    # N' M and a0' M, joint columns only: M is symmetric, so these sums run along its contiguous rows.
    product = np.zeros((na, nj))
    torque = np.empty(nj)
    for j in range(nj):
        torque[j] = bias[6 + j]
    for c in range(nu):
        for j in range(nj):
            product[c, j] = mass_matrix[upper[c], 6 + j]
    for k in core:
        for j in range(nj):
            torque[j] += start[k] * mass_matrix[k, 6 + j]
        for c in range(0 if mode == 0 and k < 6 else nu, na):
            value = basis[k, c]
            if value == 0.0:
                continue
            for j in range(nj):
                product[c, j] += value * mass_matrix[k, 6 + j]
    for j in range(nj):
        scale = row_scale[0] / torque_max[j]
        for c in range(na):
            matrix[used + j, c] = scale * product[c, j]
        for c in range(na, nz):
            matrix[used + j, c] = 0.0
    for foot in range(2):
        if mode != 3 and mode != foot + 1:
            continue
        jacobian = jacobian_1 if foot == 0 else jacobian_2
        for column in leg_1 if foot == 0 else leg_2:
            j = column - 6
            scale = row_scale[0] / torque_max[j]
            for k in range(6):
                torque[j] -= jacobian[k, column] * offsets[foot, k]
                value = scale * jacobian[k, column]
                for c in range(nz):
                    matrix[used + j, c] -= value * maps[foot, k, c]
    for j in range(nj):
        constant = torque[j] * row_scale[0] / torque_max[j]
        lower[nu + used] = -row_scale[0] - constant
        upper_bound[nu + used] = row_scale[0] - constant
        used += 1
    scale = row_scale[1]
    for i in range(6, core.shape[0]):
        k = core[i]
        for c in range(nz):
            matrix[used, c] = basis[k, c] * scale if c < na else 0.0
        lower[nu + used] = (acceleration_lower[k - 6] - start[k]) * scale
        upper_bound[nu + used] = (acceleration_upper[k - 6] - start[k]) * scale
        used += 1
