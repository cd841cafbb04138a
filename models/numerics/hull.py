"""Convex hulls in the plane."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.numerics.compiled import njit


@njit(cache=True)
def convex_hull(points: NDArray[Any], hull: NDArray[Any]) -> int:
    """Write the corners of the hull of points (n, 2) to ``hull`` (>= 2 n, 2), counter-clockwise; returns their number.

    Takes linear time for points sorted by x, then y. Coincident points give no corner.

    Reference: Andrew: Another efficient algorithm for convex hulls in two dimensions, 1979 (monotone chain).
    """
    n = points.shape[0]
    order = np.arange(n)
    for i in range(1, n):
        k = order[i]
        j = i - 1
        while j >= 0 and (
            points[order[j], 0] > points[k, 0]
            or (points[order[j], 0] == points[k, 0] and points[order[j], 1] > points[k, 1])
        ):
            order[j + 1] = order[j]
            j -= 1
        order[j + 1] = k
    count = 0
    for turn in range(2):
        base = count
        for step in range(n):
            k = order[step] if turn == 0 else order[n - 1 - step]
            while count - base >= 2:
                ax = hull[count - 1, 0] - hull[count - 2, 0]
                ay = hull[count - 1, 1] - hull[count - 2, 1]
                bx = points[k, 0] - hull[count - 2, 0]
                by = points[k, 1] - hull[count - 2, 1]
                if ax * by - ay * bx > 0.0:
                    break
                count -= 1
            hull[count, 0] = points[k, 0]
            hull[count, 1] = points[k, 1]
            count += 1
        count -= 1  # the last point starts the other chain
    return count
