"""Compiled Cholesky factors of small matrices; their diagonals hold inverses, so that solving only multiplies."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.compiled import njit

Array = NDArray[np.float64]


@njit(cache=True, fastmath={"reassoc", "contract"})
def factorise(matrix: Array, size: int, factor: Array) -> bool:
    """Factor L of L L' = M.

    Args:
        matrix: M, of which the lower triangle is read (at least size, size).
        size: Rows and columns that count.
        factor: Out: L, its diagonal inverted; the upper triangle stays as it was (at least size, size).

    Returns:
        Whether M is positive definite.
    """
    for i in range(size):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            if i > j:
                factor[i, j] = total * factor[j, j]
            elif total > 0.0:
                factor[i, i] = 1.0 / np.sqrt(total)
            else:
                return False
    return True


@njit(cache=True, fastmath={"reassoc", "contract"})
def solve_lower(factor: Array, size: int, vector: Array) -> None:
    """Replace the first ``size`` entries of a vector by L^-1 times them."""
    for i in range(size):
        total = vector[i]
        for k in range(i):
            total -= factor[i, k] * vector[k]
        vector[i] = total * factor[i, i]


@njit(cache=True, fastmath={"reassoc", "contract"})
def solve_upper(factor: Array, size: int, vector: Array) -> None:
    """Replace the first ``size`` entries of a vector by L^-T times them."""
    for i in range(size - 1, -1, -1):
        vector[i] *= factor[i, i]
        for k in range(i):
            vector[k] -= factor[i, k] * vector[i]
