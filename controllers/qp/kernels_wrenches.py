"""Compiled products with the reduction's basis: single rows, and the contact wrenches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.compiled import njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@njit(cache=True, fastmath={"contract"})
def reduce_row(
    row: Array, scale: float, flight: bool, upper: Index, core: Index, basis: Array, start: Array, out: Array
) -> float:
    """``out = scale row N``; returns ``scale row a0``.

    The upper body's rows of N are unit vectors and its part of a0 is zero; outside flight the base and the legs depend
    on the leg coordinates alone. So most of the product need not be formed.

    Args:
        row: (nv,).
        scale: Factor.
        flight: Whether no foot is in contact: the base then depends on all coordinates.
        upper: Velocity indices outside base and legs (nu,).
        core: Those of base and legs.
        basis: N (nv, na) and a0 (nv,).
        start: a0 (nv,).
        out: Out (na,) or longer.
    """
    nu, na = upper.shape[0], basis.shape[1]
    for c in range(nu):
        out[c] = scale * row[upper[c]]
    for c in range(nu, na):
        out[c] = 0.0
    constant = 0.0
    for k in core:
        value = scale * row[k]
        if value == 0.0:
            continue
        constant += value * start[k]
        for c in range(0 if flight and k < 6 else nu, na):
            out[c] += value * basis[k, c]
    return constant


@njit(cache=True, fastmath={"contract"})
def reduce_wrenches(
    mode: int,
    mass_matrix: Array,
    bias: Array,
    inverse_1: Array,
    inverse_2: Array,
    upper: Index,
    core: Index,
    basis: Array,
    start: Array,
    wrench_scale: float,
    maps: Array,
    offsets: Array,
) -> None:
    """Fill ``w_i = maps[i] z + offsets[i]`` from the floating-base rows; see ``kernels_reduce``.

    Args:
        mode: Contact mode.
        mass_matrix: Dynamics.
        bias: Dynamics.
        inverse_1: X_i^-1 (6, 6).
        inverse_2: X_i^-1 (6, 6).
        upper: Velocity indices outside base and legs (nu,).
        core: Those of the base, then of the legs.
        basis: N (nv, na).
        start: a0 (nv,).
        wrench_scale: Scale of phi, so that all of z has similar size [N].
        maps: Out (2, 6, nz).
        offsets: Out (2, 6).
    """
    na = basis.shape[1]
    maps[:, :, :] = 0.0
    offsets[:, :] = 0.0
    if mode == 0:
        return
    rows = np.empty((6, na))
    constant = np.empty(6)
    for i in range(6):
        constant[i] = bias[i] + reduce_row(mass_matrix[i], 1.0, False, upper, core, basis, start, rows[i])
    share = 0.5 if mode == 3 else 1.0
    for foot in range(2):
        if mode != 3 and mode != foot + 1:
            continue
        inverse = inverse_1 if foot == 0 else inverse_2
        sign = 1.0 if foot == 0 else -1.0
        for i in range(6):
            for k in range(6):
                value = inverse[k, i]
                if value == 0.0:
                    continue
                offsets[foot, i] += share * value * constant[k]
                for c in range(na):
                    maps[foot, i, c] += share * value * rows[k, c]
                if mode == 3:
                    maps[foot, i, na + k] += sign * wrench_scale * value
