"""The support polygon: the convex hull of the loaded soles on the floor."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import ConvexHull

from models.types import Matrix, Vector


def support_polygon(corners: Sequence[Matrix]) -> Matrix:
    """Convex hull of the soles' corners, counter-clockwise (n, 2) [m].

    ``corners`` are those of each loaded sole in W, x and y (k, 2) or more columns [m]. Raises ``ValueError`` for fewer
    than three.
    """
    points = np.vstack([np.asarray(sole)[:, :2] for sole in corners])
    if len(points) < 3:
        raise ValueError(f"a support polygon needs three corners, found {len(points)}")
    return np.asarray(points[ConvexHull(points).vertices])


def _outward(polygon: Matrix) -> tuple[Matrix, Vector]:
    """Half-planes ``n . p <= b`` of a counter-clockwise polygon: normals (n, 2) [-] and offsets (n,) [m]."""
    edges = np.roll(polygon, -1, axis=0) - polygon
    normals = np.column_stack([edges[:, 1], -edges[:, 0]]) / np.linalg.norm(edges, axis=1)[:, None]  # (n, 2)
    return normals, np.einsum("ij,ij->i", normals, polygon)


def margin(polygon: Matrix, point: Vector) -> float:
    """Distance from a point to the nearest edge of a counter-clockwise polygon [m]; positive inside, negative outside.

    Outside it is minus the largest distance to a violated edge line, at most the true distance. ``polygon`` is (n, 2)
    and ``point`` (2,) in W [m].
    """
    normals, offsets = _outward(polygon)
    return float(np.min(offsets - normals @ point[:2]))


def distance_along(polygon: Matrix, point: Vector, direction: Vector) -> float:
    """Distance from a point inside a counter-clockwise polygon to its edge along a unit direction [m].

    0 on that edge or beyond it. ``polygon`` is (n, 2) [m], ``point`` (2,) [m] and ``direction`` (2,), all in W.
    """
    normals, offsets = _outward(polygon)
    slack = offsets - normals @ point[:2]
    rate = normals @ direction[:2]
    ahead = rate > 1e-12  # edges that the ray moves towards; 1e-12: parallel to rounding
    return float(max(0.0, np.min(slack[ahead] / rate[ahead])))
