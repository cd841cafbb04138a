"""Eliminates the equalities of the whole-body QP: floating-base dynamics and rigid contacts.

The unknowns are the generalised acceleration ``a`` and one wrench ``w_i`` per contact. Both are affine in a smaller
vector ``z`` that satisfies the six floating-base rows and the contact rows for any value::

    a = N z + a0,    w_i = P_i z + p_i

Only the base and the joints between base and contacts enter the contact rows ``J_i a + drift_i = a_i*``. Each
foot-to-base adjoint ``X_i`` (6, 6), the base block of ``J_i``, is invertible. Therefore:

* no contact:  z is the joint accelerations; the base follows from its dynamics rows;
* k contacts:  the joints between base and contacts move in the null space of the k - 1 loop closures
               ``X_1^-1 J_1 a = X_i^-1 J_i a`` (Householder reflections); the base follows from the first contact; the
               wrenches share the base wrench ``b``, up to k - 1 free internal wrenches ``phi``:
               ``w_i = X_i^-T (b/k + phi_i)`` with ``phi_k = -(phi_1 + ... + phi_k-1)``.

Legs that cannot turn their soles about the vertical fix the heading of the base relative to each planted sole. The last
row of each closure then depends on the others and is omitted.

A sole on its edge turns freely about the edge: ``J_i a + drift_i = a_i* + e_i s_i``, where ``e_i`` is the twist of the
rotation and ``s_i`` an additional unknown, like a joint between ground and sole. A row of the wrench cone sets the
moment about the edge to zero.

The order in ``z`` is: joints outside the contact chains, coordinates of the chains and edges, ``phi``.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.qp.terms import Dynamics, pose_error
from models.numerics.cholesky import factorise, solve_factored
from models.numerics.compiled import njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]

PIVOT_FLOOR = 1e-6  #: Pivot of a loop closure below which a row is dependent, as with both knees straight [-]


class Reduction(NamedTuple):
    """``a = basis z + start``, ``w_i = maps_i z + offsets_i`` for one set of active contacts."""

    active: Index  #: Indices of the active contacts (k,)
    core: Index  #: Velocity indices of the base, then of the joints between base and active contacts (n,)
    upper: Index  #: Other velocity indices (nv - n,)
    closing: Index  #: Rows of each loop closure, as components of the base twist (r,)
    basis: Array  #: N (nv, na)
    start: Array  #: a0 (nv,)
    maps: Array  #: P of all contacts, zero where inactive (contacts, 6, nz)
    offsets: Array  #: p of all contacts (contacts, 6)


class Edges(NamedTuple):
    """Contacts that turn about an edge, or about a corner when both axes are free."""

    free: NDArray[np.bool_]  #: Whether a contact turns freely about its x and y axes (contacts, 2)
    pivots: Array  #: Fixed point of each contact in its frame; zero for a flat contact (contacts, 2) [m]


def make_reduction(
    contacts: Sequence[bool],
    chains: Sequence[Sequence[int]],
    nv: int,
    turns: int = 0,
    closing: Sequence[int] = range(6),
) -> Reduction:
    """Allocate the reduction for a set of active contacts with a total of ``turns`` free axes.

    ``chains`` are velocity indices of the joints from base to contact, ``closing`` the independent rows of a closure.
    """
    active = np.flatnonzero(contacts)
    joints = sorted({joint for contact in active for joint in chains[contact]})
    core = np.array([*range(6), *joints], dtype=np.int64)
    others = max(len(active) - 1, 0)
    na, count = nv - 6 - len(closing) * others + turns, len(chains)
    nz = na + 6 * others
    return Reduction(
        active.astype(np.int64),
        core,
        np.setdiff1d(np.arange(nv), core).astype(np.int64),
        np.array(closing, dtype=np.int64),
        np.zeros((nv, na)),
        np.zeros(nv),
        np.zeros((count, 6, nz)),
        np.zeros((count, 6)),
    )


class ContactGains(NamedTuple):
    """Gains of the contact feedback ``clip(stiffness * error - damping * twist)``; arrays per component (6,)."""

    stiffness: Array  #: [1/s^2]
    damping: Array  #: [1/s]
    largest: Array  #: Bound of the acceleration [m/s^2, rad/s^2]
    wrench_scale: float  #: Unit of phi, so that the entries of z have similar magnitude [N]


@njit(cache=True, forceinline=True)
def eliminate(
    terms: Dynamics,
    rotations: Array,
    positions: Array,
    gains: ContactGains,
    edges: Edges,
    desired: Array,
    reduction: Reduction,
) -> None:
    """Compute the reduction of the active contacts; the contacts are the first frames of ``terms``.

    ``rotations`` (contacts, 3, 3) and ``positions`` (contacts, 3) are the desired poses in W. Also writes ``desired``,
    the desired acceleration of each contact in its frame (contacts, 6).
    """
    for contact in range(desired.shape[0]):
        pose, twist, out = terms.poses[contact], terms.twists[contact], desired[contact]
        hold_contact(pose, twist, rotations[contact], positions[contact], gains, edges.pivots[contact], out)
    inverses = np.empty((reduction.active.shape[0], 6, 6))
    _reduce_accelerations(terms, desired, edges, inverses, reduction)
    _reduce_wrenches(terms, gains.wrench_scale, inverses, reduction)


@njit(cache=True, forceinline=True)
def hold_contact(
    pose: Array, twist: Array, rotation: Array, position: Array, gains: ContactGains, pivot: Array, out: Array
) -> None:
    """Bounded acceleration that returns a contact to its desired pose, in its frame (6,) [m/s^2, rad/s^2].

    The feedback acts at the ``pivot`` (2,) [m]; at the contact's origin, ``a = a_p + p x alpha - w x (w x p)``.
    """
    pose_error(pose, rotation, position, out)
    px, py = pivot
    wx, wy, wz = twist[3], twist[4], twist[5]
    held = px != 0.0 or py != 0.0
    vx, vy, vz = twist[0], twist[1], twist[2]
    if held:
        for i in range(3):  # e_p = e + R' R_d p - p
            for k in range(3):
                out[i] += pose[k, i] * (rotation[k, 0] * px + rotation[k, 1] * py)
        out[0], out[1] = out[0] - px, out[1] - py
        vx, vy, vz = vx - wz * py, vy + wz * px, vz + wx * py - wy * px
    for i in range(6):
        limit, rate = gains.largest[i], (vx, vy, vz, wx, wy, wz)[i]
        out[i] = min(max(gains.stiffness[i] * out[i] - gains.damping[i] * rate, -limit), limit)
    if held:
        along, square = wx * px + wy * py, wx * wx + wy * wy + wz * wz
        out[0] += py * out[5] - (along * wx - square * px)
        out[1] += -px * out[5] - (along * wy - square * py)
        out[2] += px * out[4] - py * out[3] - along * wz


@njit(cache=True, forceinline=True)
def _reduce_accelerations(terms: Dynamics, desired: Array, edges: Edges, inverses: Array, reduction: Reduction) -> None:
    """Compute ``a = N z + a0`` and ``X_i^-1`` of each active contact (k, 6, 6)."""
    basis, start, upper = reduction.basis, reduction.start, reduction.upper
    joints, count = reduction.core[6:], reduction.active.shape[0]
    nu, used = upper.shape[0], joints.shape[0]
    basis[:, :] = 0.0
    start[:] = 0.0
    for i in range(nu):
        basis[upper[i], i] = 1.0
    if count == 0:
        right = np.empty((6, nu + 1))
        for i in range(6):
            for j in range(nu):
                right[i, j] = -terms.mass_matrix[i, upper[j]]
            right[i, nu] = -terms.bias[i]
        _solve_base(terms.mass_matrix, right)
        for i in range(6):
            start[i] = right[i, nu]
            for c in range(nu):
                basis[i, c] = right[i, c]
        return
    closing = reduction.closing
    size = closing.shape[0]
    rows = size * (count - 1)
    n = basis.shape[1] - nu + rows  # joints, then free rotations
    reach = np.zeros((count, 6, n))  # X^-1 J, columns of the joints; then -X^-1 e
    target = np.zeros((count, 6))  # X^-1 (a* - drift)
    for k in range(count):
        contact, inverse = reduction.active[k], inverses[k]
        jacobian = terms.jacobians[contact]
        _adjoint_inverse(jacobian, inverse)
        for i in range(6):
            for m in range(6):
                value = inverse[i, m]
                if value == 0.0:
                    continue
                target[k, i] += value * (desired[contact, m] - terms.drifts[contact, m])
                for j in range(joints.shape[0]):
                    reach[k, i, j] += value * jacobian[m, joints[j]]
        for axis in range(2):
            if edges.free[contact, axis]:
                lever = edges.pivots[contact, 0] if axis == 1 else -edges.pivots[contact, 1]
                for i in range(6):
                    reach[k, i, used] = -(lever * inverse[i, 2] + inverse[i, 3 + axis])
                used += 1
    free, offset = np.eye(n)[:, : n - rows].copy(), np.zeros(n)
    if count > 1:
        closure, right_side = np.empty((rows, n)), np.empty(rows)
        for k in range(1, count):
            for r in range(size):
                i, row = closing[r], size * (k - 1) + r
                right_side[row] = target[0, i] - target[k, i]
                for j in range(n):
                    closure[row, j] = reach[0, i, j] - reach[k, i, j]
        _null_space(closure, right_side, free, offset, PIVOT_FLOOR)
    for j in range(joints.shape[0]):
        start[joints[j]] = offset[j]
        for c in range(n - rows):
            basis[joints[j], nu + c] = free[j, c]
    for i in range(6):
        start[i] = target[0, i]
        for j in range(n):
            value = reach[0, i, j]
            if value == 0.0:
                continue
            start[i] -= value * offset[j]
            for c in range(n - rows):
                basis[i, nu + c] -= value * free[j, c]


@njit(cache=True, forceinline=True, fastmath={"contract"})
def _reduce_wrenches(terms: Dynamics, scale: float, inverses: Array, reduction: Reduction) -> None:
    """Compute ``w_i = P_i z + p_i`` from the floating-base rows; ``scale`` is the unit of phi [N]."""
    maps, offsets = reduction.maps, reduction.offsets
    count, na = reduction.active.shape[0], reduction.basis.shape[1]
    maps[:, :, :] = 0.0
    offsets[:, :] = 0.0
    if count == 0:
        return
    rows, constant = np.empty((6, na)), np.empty(6)
    for i in range(6):
        constant[i] = terms.bias[i] + reduce_row(terms.mass_matrix[i], 1.0, reduction, rows[i])
    share = 1.0 / count
    for k in range(count):
        contact, inverse = reduction.active[k], inverses[k]
        for i in range(6):
            for m in range(6):
                value = inverse[m, i]
                if value == 0.0:
                    continue
                offsets[contact, i] += share * value * constant[m]
                for c in range(na):
                    maps[contact, i, c] += share * value * rows[m, c]
                for other in range(count - 1):
                    if k == count - 1:
                        maps[contact, i, na + 6 * other + m] -= scale * value
                    elif k == other:
                        maps[contact, i, na + 6 * other + m] += scale * value


@njit(cache=True, forceinline=True, fastmath={"contract"})
def reduce_row(row: Array, scale: float, reduction: Reduction, out: Array) -> float:
    """Compute ``out[:na] = scale row N``; returns ``scale row a0``.

    Outside the core, the rows of N are unit vectors and a0 is zero. With a contact, the core depends only on the
    coordinates of the chains. Most of the product is therefore skipped.
    """
    basis, start, upper = reduction.basis, reduction.start, reduction.upper
    nu, na = upper.shape[0], basis.shape[1]
    for c in range(nu):
        out[c] = scale * row[upper[c]]
    for c in range(nu, na):
        out[c] = 0.0
    first = nu if reduction.active.shape[0] > 0 else 0
    constant = 0.0
    for k in reduction.core:
        value = scale * row[k]
        if value == 0.0:
            continue
        constant += value * start[k]
        for c in range(first, na):
            out[c] += value * basis[k, c]
    return constant


@njit(cache=True)
def _adjoint_inverse(jacobian: Array, out: Array) -> None:
    """Inverse (6, 6) of the base block ``X = [R', -R'[p]x; 0, R']`` of a contact Jacobian, by its structure."""
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
def _null_space(constraint: Array, right: Array, basis: Array, particular: Array, floor: float) -> None:
    """Least-norm solution and orthonormal null space of ``C y = r`` by Householder; overwrites C (m, n), m < n."""
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
def _solve_base(mass_matrix: Array, right: Array) -> None:
    """Compute ``right = M_bb^-1 right`` (6, k) in place, with the base block of M."""
    factor = mass_matrix[:6, :6].copy()
    factorise(factor)
    solve_factored(factor, right)
