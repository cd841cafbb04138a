"""Cholesky factors of small matrices."""

import math

import numpy as np
from numpy.typing import NDArray

from models.numerics.compiled import njit

Array = NDArray[np.float64]


@njit(cache=True)
def factorise(matrix: Array) -> bool:
    """Factorise in place, in the lower triangle; False if the matrix is not positive definite or not finite."""
    for i in range(matrix.shape[0]):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i == j:
                if not 0.0 < total < np.inf:
                    return False
                matrix[i, i] = math.sqrt(total)
            else:
                matrix[i, j] = total / matrix[j, j]
    return True


@njit(cache=True)
def solve_factored(factor: Array, right: Array) -> None:
    """Solve in place: ``right = (L L')^-1 right`` (n, k), with L in the lower triangle of ``factor`` (n, n)."""
    count, columns = right.shape
    for i in range(count):
        for k in range(i):
            for c in range(columns):
                right[i, c] -= factor[i, k] * right[k, c]
        for c in range(columns):
            right[i, c] /= factor[i, i]
    for i in range(count - 1, -1, -1):
        for k in range(i + 1, count):
            for c in range(columns):
                right[i, c] -= factor[k, i] * right[k, c]
        for c in range(columns):
            right[i, c] /= factor[i, i]
