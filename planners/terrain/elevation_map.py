"""Robot-centric elevation map: a square grid of heights and variances that is updated from point clouds."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from models.numerics.compiled import njit
from models.types import Matrix, Vector
from planners.gait.footsteps import Foothold
from planners.terrain.config import TerrainMapConfig

_NEIGHBOURS = 5  #: Least number of known neighbours, of 8, for a hole to be closed
_HOLE = 0.02  #: Largest height difference between these neighbours [m]
_SPANNED = (3, 3)  #: Cells of a hole that is too narrow for a sole


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
    """Fields of ``FusionConfig`` for compiled code."""

    floor: float
    layer: float
    gate: float
    disagree: float


class Heights(NamedTuple):
    """Grid of ground heights in W."""

    values: Matrix  #: (n, m) [m]; nan where unknown
    corner: tuple[float, float]  #: x and y of the outer corner of the first cell [m]
    cell: float  #: Edge length of a cell [m]
    deviations: Matrix | None = None  #: Standard deviations of the heights (n, m) [m]; optional

    def at(self, points: Matrix) -> Vector:
        """Heights (n,) [m] at points x, y (n, 2) [m]; nan where unknown or outside the grid."""
        return self._sample(self.values, points)

    def deviations_at(self, points: Matrix) -> Vector:
        """Standard deviations (n,) of the heights at points x, y (n, 2) [m]; 0 where not known."""
        if self.deviations is None:
            return np.zeros(len(points))
        found = self._sample(self.deviations, points)
        return np.where(np.isfinite(found), found, 0.0)

    def _sample(self, values: Matrix, points: Matrix) -> Vector:
        index = np.floor((points - self.corner) / self.cell).astype(np.int64)
        inside = ((index >= 0) & (index < values.shape)).all(axis=1)
        found = np.full(len(points), np.nan)
        found[inside] = values[tuple(index[inside].T)]
        return found

    def closed(self) -> Heights:
        """The grid with holes closed: an unknown cell in known, level surroundings gets their mid-height."""
        around = np.pad(self.values, 1, constant_values=np.nan)
        n, m = self.values.shape
        near = np.stack([around[i : i + n, j : j + m] for i in range(3) for j in range(3) if (i, j) != (1, 1)])
        known = np.isfinite(near)
        low, high = np.where(known, near, np.inf).min(axis=0), np.where(known, near, -np.inf).max(axis=0)
        hole = np.isnan(self.values) & (known.sum(axis=0) >= _NEIGHBOURS) & (high - low <= _HOLE)
        values = self.values.copy()
        values[hole] = 0.5 * (low[hole] + high[hole])
        return self._replace(values=values)


def lattice(line: Foothold, ways: ArrayLike, sides: ArrayLike) -> Matrix:
    """Points in W (n m, 2) [m] at ``ways`` along a line (n,) and ``sides`` across it (m,) [m], row by row."""
    along, across = (each.ravel() for each in np.meshgrid(ways, sides, indexing="ij"))
    c, s = math.cos(line.yaw), math.sin(line.yaw)
    return np.stack([line.x + c * along - s * across, line.y + s * along + c * across], axis=-1)


def level_offset(heights: Vector, known: float, roughness: float) -> float | None:
    """Median [m] of the heights (n,) [m] of level ground, nan where unknown.

    None if the known share is below ``known``, or the standard deviation exceeds ``roughness`` [m].
    """
    found = heights[np.isfinite(heights)]
    if not len(found) or len(found) < known * len(heights) or found.std() > roughness:
        return None
    return float(np.median(found))


def off_level(heights: Matrix, level: float, most: float, margin: Matrix | float = 0.0) -> Matrix:
    """Penalty of heights (n, m) that are off a level by more than ``most`` [m], in cells; 0 for others and nan.

    A higher cell counts its height over ``most``, a lower one 1, and none in a hole that a sole spans. A cell off by
    less than ``most`` plus its ``margin`` (n, m) [m], for the error of its height, does not count.
    """
    known = np.isfinite(heights)
    around = ndimage.grey_dilation(np.where(known, heights, -np.inf), _SPANNED)
    spanned = ndimage.grey_erosion(np.where(np.isfinite(around), around, np.inf), _SPANNED)
    rise = np.where(known, spanned, np.nan) - level
    off: Matrix = np.where(np.abs(rise) > most + margin, np.maximum(rise / most, 1.0), 0.0)
    return off


class ElevationMap:
    r"""Elevation map with cells aligned to x and y of W.

    A cloud measures each cell it hits: m is the weighted mean of the points within ``layer`` deviations of the highest,
    with variance ``v = 1 / sum(1 / s_i^2) + s_floor^2 + s_0^2``. The deviations s_i of the points are independent, s_0
    is common to the cell. A Kalman filter of a constant updates height h and variance P:

    .. math:: K = P / (P + v), \quad h \leftarrow h + K (m - h), \quad P \leftarrow \max((1 - K) P, s_{floor}^2)

    A measurement outside the gate does not change the height. It adds a share of its squared error to the variance, so
    that about four in a row replace the height. A ray that passes below the height of a cell clears the cell.

    Attributes:
        origin: Index of the first cell along x and y; the centre of cell (i, j) is ``(origin + (i, j) + 0.5) cell``.
        height: (n, n) [m]; nan where unknown.
        variance: (n, n) [m^2]; infinite where unknown.
        seen: Stamp of the newest measurement within the gate (n, n) [s]; -inf without one.
        measured: Whether a ray has hit or cleared the cell (n, n); given heights do not replace such cells.

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
        """Set every cell to unknown."""
        self.height[:], self.variance[:], self.seen[:], self.measured[:] = np.nan, np.inf, -np.inf, False

    @property
    def known(self) -> NDArray[np.bool_]:
        """Cells with a variance of at most ``variance_max`` (n, n)."""
        known: NDArray[np.bool_] = self.variance <= self._fusion.variance_max
        return known

    @property
    def centre(self) -> Vector:
        """Centre of the map in W (2,) [m]."""
        return np.array((self.origin + 0.5 * self.cells) * self.cell, dtype=np.float64)

    def index(self, points: Matrix) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Indices (n, 2) of the cells at points x, y (n, 2) [m], and whether they are in the map (n,)."""
        index: NDArray[np.int64] = np.floor(points / self.cell).astype(np.int64) - self.origin
        i, j = index.T
        return index, (i >= 0) & (i < self.cells) & (j >= 0) & (j < self.cells)

    def at(self, points: Matrix, *, measured: bool = False) -> Vector:
        """Heights (n,) [m] at points x, y (n, 2) [m]; nan where unknown or, with ``measured``, not measured."""
        index, inside = self.index(points)
        heights = np.full(len(points), np.nan)
        i, j = index[inside].T
        known = self.known[i, j] & (self.measured[i, j] | (not measured))
        heights[inside] = np.where(known, self.height[i, j], np.nan)
        return heights

    def heights(self, reference: float) -> Heights:
        """Known ground in W, with holes closed; ``reference`` is the height in W of the zero of the map [m]."""
        x, y = (self.origin * self.cell).tolist()
        values = np.where(self.known, self.height + reference, np.nan)
        return Heights(values, (x, y), self.cell, np.sqrt(self.variance)).closed()

    def move_to(self, x: float, y: float) -> None:
        """Centre the map on a point of W [m], rounded to a cell; cells that leave the map are discarded."""
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
        """Fill cells neither measured nor known with given heights less ``reference`` [m], and a variance [m^2]."""
        i, j = np.nonzero(~self.known & ~self.measured)
        places: Matrix = ((self.origin + np.column_stack([i, j]) + 0.5) * self.cell).astype(np.float64)
        heights = ground.at(places) - reference
        found = np.isfinite(heights)
        i, j = i[found], j[found]
        self.height[i, j], self.variance[i, j] = heights[found], variance

    def shift(self, height: float) -> None:
        """Raise all cells by a height [m]."""
        self.height += height

    def age(self, variance: float) -> None:
        """Increase the variance of measured cells [m^2]; given heights do not age."""
        self.variance[self.measured] += variance

    def fuse(self, t: float, points: Matrix, deviations: Vector, common: Vector, eye: Vector) -> int:
        """Fuse points (n, 3) [m] seen from ``eye`` (3,) [m] at time ``t`` [s]; returns the number of measured cells.

        The height errors ``deviations`` are independent, ``common`` ones are shared by all points of a cell (n,) [m].
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
    """Update the cells that a cloud hits; returns which were measured (n, n)."""
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
    """Clear cells above the rays from ``eye`` to the points, except those that the same cloud measured."""
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
        for step in range(1, steps):  # from the point to the eye, without the cell of the point
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
