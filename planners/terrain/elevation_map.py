"""A square grid of heights around the robot, with their variances, that point clouds are fused into."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.numerics.compiled import njit
from models.types import Matrix, Vector
from planners.terrain.config import TerrainMapConfig

_NEIGHBOURS = 5  #: Known ones of 8 from which on a hole is closed
_HOLE = 0.02  #: Difference of their heights up to which it is [m]


class _Layers(NamedTuple):
    """Layers of a map, each (n, n)."""

    height: Matrix
    variance: Matrix
    seen: Matrix


class _Points(NamedTuple):
    """Points of a cloud within a map, each (k,)."""

    cells: NDArray[np.int64]  # row-major index
    heights: Vector  # [m]
    deviations: Vector  # [m]
    common: Vector  # [m]


class _Limits(NamedTuple):
    """See ``FusionConfig``."""

    floor: float
    layer: float
    gate: float
    disagree: float


class Heights(NamedTuple):
    """A grid of heights of the ground in W."""

    values: Matrix  #: (n, m) [m]; nan where unknown
    corner: tuple[float, float]  #: x and y of the first cell's outer corner [m]
    cell: float  #: Edge of a cell [m]

    def at(self, points: Matrix) -> Vector:
        """Heights at points x, y (n, 2) [m]: (n,) [m]."""
        index = np.floor((points - self.corner) / self.cell).astype(np.int64)
        inside = ((index >= 0) & (index < self.values.shape)).all(axis=1)
        heights = np.full(len(points), np.nan)
        heights[inside] = self.values[tuple(index[inside].T)]
        return heights

    def closed(self) -> Heights:
        """With cells that no ray has met half-way between their neighbours, where most are known, and level."""
        around = np.pad(self.values, 1, constant_values=np.nan)
        n, m = self.values.shape
        near = np.stack([around[i : i + n, j : j + m] for i in range(3) for j in range(3) if (i, j) != (1, 1)])
        known = np.isfinite(near)
        low, high = np.where(known, near, np.inf).min(axis=0), np.where(known, near, -np.inf).max(axis=0)
        hole = np.isnan(self.values) & (known.sum(axis=0) >= _NEIGHBOURS) & (high - low <= _HOLE)
        values = self.values.copy()
        values[hole] = 0.5 * (low[hole] + high[hole])
        return self._replace(values=values)


def level_offset(heights: Vector, known: float, roughness: float) -> float | None:
    """Median of the heights of level ground (n,) [m], nan where unknown.

    None where less than the share ``known`` is, or their standard deviation exceeds ``roughness`` [m].
    """
    found = heights[np.isfinite(heights)]
    if not len(found) or len(found) < known * len(heights) or found.std() > roughness:
        return None
    return float(np.median(found))


def off_level(heights: Matrix, level: float, most: float) -> Matrix:
    """How far heights (any shape) are off a level by more than ``most`` [m], in cells just off it; 0 for nan.

    Lower ones count 1, higher ones their height over ``most``: a sole spans a narrow hole, but no post.
    """
    rise = heights - level
    off: Matrix = np.where(np.abs(rise) > most, np.maximum(rise / most, 1.0), 0.0)
    return off


class ElevationMap:
    r"""Heights of cells whose edges are parallel to x and y of W.

    A cloud gives each cell the weighted mean of its highest points, with variance ``1 / sum(1 / s_i^2) + s_0^2``
    of the points' deviations s_i. Height h and variance P of a cell follow by the Kalman filter of a constant,

    .. math:: K = P / (P + v), \quad h \leftarrow h + K (m - h), \quad P \leftarrow \max((1 - K) P, s_{floor}^2)

    A measurement outside the gate does not change the height but adds a share of its squared error to the variance, so
    that some four in a row replace it. Rays that pass below a cell's height empty it.

    Attributes:
        origin: Index of the first cell along x and y: cell (i, j) has its middle at ``(origin + (i, j) + 0.5) cell``.
        height: (n, n) [m]; nan where unknown.
        variance: (n, n) [m^2]; infinite where unknown.
        seen: Stamp of the newest measurement within the gate (n, n) [s]; -inf where there was none.
        measured: Whether a ray has met or emptied the cell (n, n); given heights replace none of these.

    References:
        Fankhauser, Bloesch, Hutter: Probabilistic terrain mapping for mobile robots with uncertain localization,
        RA-L 2018.
        Miki et al.: Elevation mapping for locomotion and navigation using GPU, IROS 2022 (gate, rays, drift).
    """

    def __init__(self, config: TerrainMapConfig) -> None:
        self.cell, self._fusion = config.cell, config.fusion
        self.cells = config.cells
        shape = (self.cells, self.cells)
        self.height, self.variance, self.seen = np.empty(shape), np.empty(shape), np.empty(shape)
        self.measured = np.zeros(shape, dtype=np.bool_)
        self.origin: NDArray[np.int64] = np.zeros(2, dtype=np.int64)
        self.clear()

    def clear(self) -> None:
        """Every cell becomes unknown."""
        self.height[:], self.variance[:], self.seen[:], self.measured[:] = np.nan, np.inf, -np.inf, False

    @property
    def known(self) -> NDArray[np.bool_]:
        """Cells whose height is certain enough (n, n)."""
        known: NDArray[np.bool_] = self.variance <= self._fusion.variance_max
        return known

    @property
    def centre(self) -> Vector:
        """Middle of the map in W (2,) [m]."""
        return np.array((self.origin + 0.5 * self.cells) * self.cell, dtype=np.float64)

    def index(self, points: Matrix) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Cells of points x, y (n, 2) [m]: their indices (n, 2), and whether they are in the map (n,)."""
        index: NDArray[np.int64] = np.floor(points / self.cell).astype(np.int64) - self.origin
        i, j = index.T
        return index, (i >= 0) & (i < self.cells) & (j >= 0) & (j < self.cells)

    def at(self, points: Matrix, *, measured: bool = False) -> Vector:
        """Heights at points x, y (n, 2) [m]: (n,) [m], nan where unknown, or not ``measured`` if that is asked for."""
        index, inside = self.index(points)
        heights = np.full(len(points), np.nan)
        i, j = index[inside].T
        known = self.known[i, j] & (self.measured[i, j] | (not measured))
        heights[inside] = np.where(known, self.height[i, j], np.nan)
        return heights

    def heights(self, reference: float) -> Heights:
        """What is known of the ground, ``reference`` [m] above the heights of the map."""
        x, y = (self.origin * self.cell).tolist()
        return Heights(np.where(self.known, self.height + reference, np.nan), (x, y), self.cell).closed()

    def move_to(self, x: float, y: float) -> None:
        """Centre the map on a point of W [m] up to a cell; what it leaves behind is forgotten."""
        origin = np.round(np.array([x, y]) / self.cell - 0.5 * self.cells).astype(np.int64)
        shift, self.origin = origin - self.origin, origin
        if not shift.any():
            return
        layers: list[tuple[NDArray[Any], float]] = [(self.height, np.nan), (self.variance, np.inf)]
        for array, unknown in (*layers, (self.seen, -np.inf), (self.measured, False)):
            array[:] = np.roll(array, -shift, axis=(0, 1))
            for axis in (0, 1):
                count = min(abs(int(shift[axis])), self.cells)
                new = slice(self.cells - count, None) if shift[axis] > 0 else slice(0, count)
                array[(new, slice(None)) if axis == 0 else (slice(None), new)] = unknown

    def fill(self, ground: Heights, reference: float, variance: float) -> None:
        """Take cells neither measured nor known from given heights, ``reference`` [m] above those of the map."""
        i, j = np.nonzero(~self.known & ~self.measured)
        places: Matrix = ((self.origin + np.column_stack([i, j]) + 0.5) * self.cell).astype(np.float64)
        heights = ground.at(places) - reference
        found = np.isfinite(heights)
        i, j = i[found], j[found]
        self.height[i, j], self.variance[i, j] = heights[found], variance

    def shift(self, height: float) -> None:
        """Raise every height [m]."""
        self.height += height

    def age(self, variance: float) -> None:
        """Add to the variance of what was measured [m^2]; given heights do not age."""
        self.variance[self.measured] += variance

    def fuse(self, t: float, points: Matrix, deviations: Vector, common: Vector, eye: Vector) -> int:
        """Fuse a cloud of points (n, 3) [m] with a stamp [s] that a sensor at ``eye`` (3,) measured.

        ``deviations`` of the heights are independent, those ``common`` to all points of a cell are not (n,) [m].
        Returns how many cells were measured.
        """
        fusion = self._fusion
        index, inside = self.index(points[:, :2])
        cells = index[inside, 0] * self.cells + index[inside, 1]  # (k,)
        layers = _Layers(self.height, self.variance, self.seen)
        cloud = _Points(cells, points[inside, 2], deviations[inside], common[inside])
        limits = _Limits(fusion.floor, fusion.layer, fusion.gate, fusion.disagree)
        measured = _fuse(t, cloud, layers, limits)
        followed, before = np.ascontiguousarray(points[:: fusion.clear_stride]), np.isfinite(self.variance)
        _clear(followed, eye, self.cell, self.origin, layers, measured, fusion.clear)
        self.measured |= measured | (before & ~np.isfinite(self.variance))
        return int(measured.sum())


@njit(cache=True)
def _fuse(t: float, cloud: _Points, layers: _Layers, limits: _Limits) -> NDArray[np.bool_]:
    """Update the cells of a cloud; returns which were measured (n, n)."""
    cells, heights, deviations, common = cloud
    height, variance, seen = layers.height.reshape(-1), layers.variance.reshape(-1), layers.seen.reshape(-1)
    floor, layer, gate, disagree = limits
    size, count = len(height), len(cells)
    top = np.full(size, -np.inf)
    for k in range(count):
        top[cells[k]] = max(top[cells[k]], heights[k])
    weights, sums, bias = np.zeros(size), np.zeros(size), np.zeros(size)
    measured = np.zeros(layers.height.shape, dtype=np.bool_)
    touched = measured.reshape(-1)
    for k in range(count):
        c, s = cells[k], deviations[k]
        if heights[k] < top[c] - layer * s:
            continue
        touched[c] = True
        w = 1.0 / (s * s)
        weights[c] += w
        sums[c] += w * heights[k]
        bias[c] = max(bias[c], common[k])
    for c in np.flatnonzero(touched):
        m, v = sums[c] / weights[c], 1.0 / weights[c] + floor * floor + bias[c] * bias[c]
        p = variance[c]
        if not math.isfinite(p):
            height[c], variance[c], seen[c] = m, v, t
            continue
        error = m - height[c]
        if error * error > gate * gate * (p + v):
            variance[c] = p + disagree * error * error
            continue
        gain = p / (p + v)
        height[c] += gain * error
        variance[c] = max((1.0 - gain) * p, floor * floor)
        seen[c] = max(seen[c], t)
    return measured


@njit(cache=True)
def _clear(
    points: Matrix,
    eye: Vector,
    cell: float,
    origin: NDArray[np.int64],
    layers: _Layers,
    measured: NDArray[np.bool_],
    margin: float,
) -> None:
    """Empty the cells above rays from ``eye`` to points, except those measured by the same cloud."""
    height, variance, seen = layers
    size = len(height)
    highest = -np.inf
    for i in range(size):
        for j in range(size):
            if height[i, j] > highest:
                highest = height[i, j]
    for k in range(len(points)):
        dx, dy, dz = points[k, 0] - eye[0], points[k, 1] - eye[1], points[k, 2] - eye[2]
        steps = int(math.hypot(dx, dy) / cell)
        for step in range(1, steps):  # from the point towards the eye; the cell of the point itself is left alone
            back = step / steps
            z = points[k, 2] - back * dz
            if z > highest - margin:
                break
            i = math.floor((points[k, 0] - back * dx) / cell) - origin[0]
            j = math.floor((points[k, 1] - back * dy) / cell) - origin[1]
            if i < 0 or j < 0 or i >= size or j >= size or measured[i, j] or not math.isfinite(variance[i, j]):
                continue
            if z < height[i, j] - margin - 3.0 * math.sqrt(variance[i, j]):
                height[i, j], variance[i, j], seen[i, j] = np.nan, np.inf, -np.inf
