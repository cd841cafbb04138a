"""Projection onto the support polygon, the convex hull of the contact rectangles of the soles."""

import numpy as np
from numpy.typing import NDArray

from models.numerics.compiled import njit

Array = NDArray[np.float64]


@njit(cache=True)
def edge_distance(hull: Array, count: int, x: float, y: float, margin: float, out: Array) -> float:
    """Signed distance [m] to a hull of ``count`` vertices that is shrunk by a margin; negative inside.

    ``out`` (4,) is the nearest point of the boundary of the shrunk hull and the outward unit direction.
    """
    inside = True
    best = -1e30
    for i in range(count):
        j = (i + 1) % count
        ex, ey = hull[j, 0] - hull[i, 0], hull[j, 1] - hull[i, 1]
        length = np.sqrt(ex * ex + ey * ey)
        if length < 1e-9:  # coincident vertices have no edge
            continue
        nx, ny = ey / length, -ex / length
        distance = nx * (x - hull[i, 0]) + ny * (y - hull[i, 1]) + margin
        if distance > best:
            best = distance
            out[0], out[1] = x - distance * nx, y - distance * ny
            out[2], out[3] = nx, ny
        if distance > 0.0:
            inside = False
    if inside:
        return best
    # Outside: nearest point of the edges of the shrunk hull.
    nearest = 1e30
    px, py = out[0], out[1]
    shrunk = np.zeros((count, 2))
    for i in range(count):
        h = (i - 1) % count
        j = (i + 1) % count
        ax, ay = hull[i, 0] - hull[h, 0], hull[i, 1] - hull[h, 1]
        bx, by = hull[j, 0] - hull[i, 0], hull[j, 1] - hull[i, 1]
        la, lb = max(np.sqrt(ax * ax + ay * ay), 1e-9), max(np.sqrt(bx * bx + by * by), 1e-9)
        n1x, n1y = ay / la, -ax / la
        n2x, n2y = by / lb, -bx / lb
        determinant = n1x * n2y - n1y * n2x
        if abs(determinant) < 1e-6:  # parallel edges
            shrunk[i, 0], shrunk[i, 1] = hull[i, 0] - margin * n1x, hull[i, 1] - margin * n1y
        else:
            c1 = n1x * hull[i, 0] + n1y * hull[i, 1] - margin
            c2 = n2x * hull[i, 0] + n2y * hull[i, 1] - margin
            shrunk[i, 0] = (c1 * n2y - c2 * n1y) / determinant
            shrunk[i, 1] = (n1x * c2 - n2x * c1) / determinant
    for i in range(count):
        j = (i + 1) % count
        ex, ey = shrunk[j, 0] - shrunk[i, 0], shrunk[j, 1] - shrunk[i, 1]
        square = ex * ex + ey * ey
        share = 0.0
        if square > 0.0:
            share = min(max(((x - shrunk[i, 0]) * ex + (y - shrunk[i, 1]) * ey) / square, 0.0), 1.0)
        cx, cy = shrunk[i, 0] + share * ex, shrunk[i, 1] + share * ey
        distance = np.sqrt((x - cx) ** 2 + (y - cy) ** 2)
        if distance < nearest:
            nearest = distance
            px, py = cx, cy
    out[0], out[1] = px, py
    if nearest > 1e-12:
        out[2], out[3] = (x - px) / nearest, (y - py) / nearest
    return nearest


@njit(cache=True)
def cmp_command(
    hull: Array,
    count: int,
    dcm: Array,
    desired: Array,
    margin: float,
    momentum_margin: float,
    momentum_gain: float,
    momentum_reach_max: float,
    out: Array,
) -> float:
    """Admissible CMP: the desired CMP projected into the polygon, plus a reach beyond the edge if the DCM nears it.

    Inside the polygon, the ankles suffice: the CMP is a CoP at least ``margin`` [m] from the edge. When the DCM nears
    or passes the edge, only a CMP beyond the edge returns it, at the cost of angular momentum. The reach is
    ``momentum_gain`` times the excess of the DCM over ``momentum_margin`` [m] before the edge, at most
    ``momentum_reach_max`` [m]. The margin is at most 0.4 of the width of the polygon: in the middle fifth, the nearest
    edge and thus the direction may change. Writes the CMP (2,) and returns the distance of the DCM inside the edge [m].
    """
    work = np.zeros(4)
    if edge_distance(hull, count, desired[0], desired[1], margin, work) > 0.0:
        out[0], out[1] = work[0], work[1]
    else:
        out[0], out[1] = desired[0], desired[1]
    depth = edge_distance(hull, count, dcm[0], dcm[1], 0.0, work)
    low, high = np.inf, -np.inf
    for i in range(count):
        along = hull[i, 0] * work[2] + hull[i, 1] * work[3]
        low, high = min(low, along), max(high, along)
    begin = min(momentum_margin, 0.4 * (high - low))
    reach = min(max(momentum_gain * (depth + begin), 0.0), momentum_reach_max)
    out[0] += reach * work[2]
    out[1] += reach * work[3]
    return -depth
