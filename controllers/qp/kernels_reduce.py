"""Compiled kernels that eliminate the equalities of the whole-body QP.

The unknowns are the generalised acceleration ``a`` and one wrench ``w_i`` per contact. Both are affine in a smaller
vector ``z`` that satisfies the six floating-base rows and the contact rows for any value::

    a = N z + a0,    w_i = P_i z + p_i

Only the base and the legs enter the contact rows, and each foot-to-base adjoint ``X_i`` (6, 6) is invertible, so

* no contact:       z = joint accelerations; the base follows from its dynamics rows;
* one contact:      z = joint accelerations; the base follows from the contact, the wrench from the base rows;
* two contacts:     the legs keep 6 of their 12 accelerations (null space of the loop closure, by Householder
                    reflections), and the wrenches share the base wrench ``b`` up to a free internal wrench ``phi``:
                    ``w_1 = X_1^-T (b/2 + phi), w_2 = X_2^-T (b/2 - phi)``.

``z`` is ordered: joints outside the two legs, then leg coordinates, then ``phi``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.compiled import njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@njit(cache=True)
def adjoint_inverse(jacobian: Array, out: Array) -> None:
    """Inverse of the base block ``X = [R', -R'[p]x; 0, R']`` of a sole Jacobian, by its structure (6, 6)."""
    for i in range(3):
        for j in range(3):
            out[i, j] = jacobian[j, i]
            out[3 + i, 3 + j] = jacobian[j, i]
            out[3 + i, j] = 0.0
    for i in range(3):
        for j in range(3):
            total = 0.0
            for k in range(3):
                for m in range(3):
                    total -= jacobian[k, i] * jacobian[k, 3 + m] * jacobian[j, m]
            out[i, 3 + j] = total


@njit(cache=True)
def null_space(constraint: Array, right: Array, basis: Array, particular: Array, floor: float) -> None:
    """Least-norm solution and orthonormal null space of ``C y = r`` with C (m, n), m < n, by Householder reflections.

    Args:
        constraint: C (m, n), overwritten.
        right: r (m,).
        basis: Out, null space (n, n - m).
        particular: Out, least-norm solution (n,).
        floor: Smallest pivot; below it the row is treated as dependent, its share of the solution is zero.
    """
    m, n = constraint.shape
    reflectors = np.zeros((m, n))
    factor = np.zeros((m, m))
    for k in range(m):
        norm = 0.0
        for j in range(k, n):
            norm += constraint[k, j] * constraint[k, j]
        norm = np.sqrt(norm)
        alpha = -norm if constraint[k, k] > 0.0 else norm
        length = 0.0
        for j in range(k, n):
            value = constraint[k, j]
            if j == k:
                value -= alpha
            reflectors[k, j] = value
            length += value * value
        if length > 0.0:
            length = np.sqrt(length)
            for j in range(k, n):
                reflectors[k, j] /= length
        for i in range(k, m):
            dot = 0.0
            for j in range(k, n):
                dot += constraint[i, j] * reflectors[k, j]
            for j in range(k, n):
                constraint[i, j] -= 2.0 * dot * reflectors[k, j]
        for i in range(k, m):
            factor[i, k] = constraint[i, k]
    y = np.zeros(n)
    for i in range(m):
        total = right[i]
        for j in range(i):
            total -= factor[i, j] * y[j]
        y[i] = total / factor[i, i] if abs(factor[i, i]) > floor else 0.0
    for j in range(n):
        particular[j] = y[j]
    for j in range(n):
        for c in range(n - m):
            basis[j, c] = 1.0 if j == m + c else 0.0
    for k in range(m - 1, -1, -1):
        dot = 0.0
        for j in range(k, n):
            dot += reflectors[k, j] * particular[j]
        for j in range(k, n):
            particular[j] -= 2.0 * dot * reflectors[k, j]
        for c in range(n - m):
            dot = 0.0
            for j in range(k, n):
                dot += reflectors[k, j] * basis[j, c]
            for j in range(k, n):
                basis[j, c] -= 2.0 * dot * reflectors[k, j]


@njit(cache=True)
def base_from_foot(
    jacobian: Array, inverse: Array, leg: Index, wanted: Array, legs: Array, offset: Array, basis: Array, start: Array
) -> None:
    """Base rows of N and a0 from ``X a_base + J_leg a_leg = wanted`` where ``a_leg = legs z + offset``.

    Args:
        jacobian: Sole Jacobian (6, nv).
        inverse: X^-1 (6, 6).
        leg: Velocity indices of the leg (6,).
        wanted: Contact acceleration less the drift (6,).
        legs: Leg rows of N (6, k), for the k leg coordinates.
        offset: Leg part of a0 (6,).
        basis: Out, base rows (6, k).
        start: Out, base part of a0 (6,).
    """
    k = legs.shape[1]
    reach = np.zeros((6, 6))
    for i in range(6):
        for j in range(6):
            total = 0.0
            for m in range(6):
                total += inverse[i, m] * jacobian[m, leg[j]]
            reach[i, j] = total
    for i in range(6):
        total = 0.0
        for m in range(6):
            total += inverse[i, m] * wanted[m] - reach[i, m] * offset[m]
        start[i] = total
        for c in range(k):
            total = 0.0
            for m in range(6):
                total -= reach[i, m] * legs[m, c]
            basis[i, c] = total


@njit(cache=True)
def solve_base(mass_matrix: Array, right: Array) -> None:
    """``right = M_bb^-1 right`` (6, k) in place, with the base block of M factored as L L' (Cholesky)."""
    factor = np.zeros((6, 6))
    for j in range(6):
        for i in range(j, 6):
            total = mass_matrix[i, j]
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            factor[i, j] = np.sqrt(total) if i == j else total / factor[j, j]
    for c in range(right.shape[1]):
        for i in range(6):
            for k in range(i):
                right[i, c] -= factor[i, k] * right[k, c]
            right[i, c] /= factor[i, i]
        for i in range(5, -1, -1):
            for k in range(i + 1, 6):
                right[i, c] -= factor[k, i] * right[k, c]
            right[i, c] /= factor[i, i]


@njit(cache=True)
def reduce_accelerations(
    mode: int,
    mass_matrix: Array,
    bias: Array,
    jacobian_1: Array,
    jacobian_2: Array,
    inverse_1: Array,
    inverse_2: Array,
    wanted_1: Array,
    wanted_2: Array,
    upper: Index,
    leg_1: Index,
    leg_2: Index,
    pivot_floor: float,
    basis: Array,
    start: Array,
) -> None:
    """Fill ``a = basis z + start`` for a contact mode: 0 none, 1 first foot, 2 second foot, 3 both.

    Args:
        mode: Contact mode.
        mass_matrix: (nv, nv).
        bias: (nv,).
        jacobian_1: Sole Jacobians in their frames (6, nv).
        jacobian_2: Sole Jacobians in their frames (6, nv).
        inverse_1: Out, inverses of their base blocks (6, 6).
        inverse_2: Out, inverses of their base blocks (6, 6).
        wanted_1: Contact accelerations less the drifts (6,).
        wanted_2: Contact accelerations less the drifts (6,).
        upper: Velocity indices.
        leg_1: Velocity indices.
        leg_2: Velocity indices.
        pivot_floor: See ``null_space``.
        basis: Out, N (nv, na).
        start: Out, a0 (nv,).
    """
    nu = upper.shape[0]
    n1, n2 = leg_1.shape[0], leg_2.shape[0]
    basis[:, :] = 0.0
    start[:] = 0.0
    for i in range(nu):
        basis[upper[i], i] = 1.0
    adjoint_inverse(jacobian_1, inverse_1)
    adjoint_inverse(jacobian_2, inverse_2)
    if mode == 3:
        closure = np.zeros((6, n1 + n2))
        right = np.zeros(6)
        for i in range(6):
            for j in range(n1):
                for m in range(6):
                    closure[i, j] += inverse_1[i, m] * jacobian_1[m, leg_1[j]]
            for j in range(n2):
                for m in range(6):
                    closure[i, n1 + j] -= inverse_2[i, m] * jacobian_2[m, leg_2[j]]
            for m in range(6):
                right[i] += inverse_1[i, m] * wanted_1[m] - inverse_2[i, m] * wanted_2[m]
        free = np.zeros((n1 + n2, n1 + n2 - 6))
        offset = np.zeros(n1 + n2)
        null_space(closure, right, free, offset, pivot_floor)
        for i in range(n1):
            start[leg_1[i]] = offset[i]
            for c in range(n1 + n2 - 6):
                basis[leg_1[i], nu + c] = free[i, c]
        for i in range(n2):
            start[leg_2[i]] = offset[n1 + i]
            for c in range(n1 + n2 - 6):
                basis[leg_2[i], nu + c] = free[n1 + i, c]
        base = np.zeros((6, n1 + n2 - 6))
        origin = np.zeros(6)
        base_from_foot(jacobian_1, inverse_1, leg_1, wanted_1, free[:n1], offset[:n1], base, origin)
        for i in range(6):
            start[i] = origin[i]
            for c in range(n1 + n2 - 6):
                basis[i, nu + c] = base[i, c]
        return
    for i in range(n1):
        basis[leg_1[i], nu + i] = 1.0
    for i in range(n2):
        basis[leg_2[i], nu + n1 + i] = 1.0
    if mode == 1:
        base = np.zeros((6, n1))
        origin = np.zeros(6)
        base_from_foot(jacobian_1, inverse_1, leg_1, wanted_1, np.eye(n1), np.zeros(n1), base, origin)
        for i in range(6):
            start[i] = origin[i]
            for c in range(n1):
                basis[i, nu + c] = base[i, c]
    elif mode == 2:
        base = np.zeros((6, n2))
        origin = np.zeros(6)
        base_from_foot(jacobian_2, inverse_2, leg_2, wanted_2, np.eye(n2), np.zeros(n2), base, origin)
        for i in range(6):
            start[i] = origin[i]
            for c in range(n2):
                basis[i, nu + n1 + c] = base[i, c]
    else:
        nv = mass_matrix.shape[0]
        right_side = np.zeros((6, nv - 6 + 1))
        for i in range(6):
            for j in range(nu):
                right_side[i, j] = -mass_matrix[i, upper[j]]
            for j in range(n1):
                right_side[i, nu + j] = -mass_matrix[i, leg_1[j]]
            for j in range(n2):
                right_side[i, nu + n1 + j] = -mass_matrix[i, leg_2[j]]
            right_side[i, nv - 6] = -bias[i]
        solve_base(mass_matrix, right_side)
        for i in range(6):
            start[i] = right_side[i, nv - 6]
            for c in range(nv - 6):
                basis[i, c] = right_side[i, c]
