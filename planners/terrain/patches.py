"""Planar patches of an elevation map, as convex polygons inset by half the width of a sole."""

import math
from collections.abc import Iterator

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray
from scipy import ndimage

from models.numerics.compiled import njit
from models.numerics.hull import convex_hull
from models.types import Matrix, Vector
from planners.terrain.config import PatchConfig
from planners.terrain.elevation_map import ElevationMap

Cells = NDArray[np.int64]  #: Indices of cells in a map (k, 2)
_CUTS = np.array([(1, 0), (0, 1), (1, 1), (1, -1)])  #: Normals of the candidate cuts
_NEIGHBOURS = np.array([(1, 0), (-1, 0), (0, 1), (0, -1)])


class Patch(Struct, frozen=True):
    """Convex polygon of level or tilted ground."""

    normal: Vector  # unit vector, up (3,)
    vertices: Matrix  # counter-clockwise seen from above; z relative to the map's reference (k, 3) [m]

    @property
    def area(self) -> float:
        """Area of the horizontal projection [m^2]."""
        return float(_area(self.vertices))

    def height(self, x: float, y: float) -> float:
        """Height of the plane at a point [m]."""
        n, p = self.normal, self.vertices[0]
        return float(p[2] - (n[0] * (x - p[0]) + n[1] * (y - p[1])) / n[2])


def find_patches(terrain: ElevationMap, config: PatchConfig, inset: float) -> list[Patch]:
    """Find convex polygons of planar ground, ``inset`` [m] from the edges of their patch and from unknown ground.

    A cell is planar if the square of ``window`` cells around it deviates from its plane by at most ``roughness`` and is
    at most as steep as ``slope``. Starting at the smoothest cells, a patch grows by neighbours whose normals and
    heights agree with its plane, then by non-planar cells at its edge that lie in the plane. It is shrunk by the inset
    and cut in two until no cell in the convex hull of a part is more than ``slack`` cells outside that part.

    References:
        Poppinga et al.: Fast plane detection and polygonalization in noisy 3D range images, IROS 2008 (growing).
    """
    cell = terrain.cell
    height = np.where(terrain.known, terrain.height, np.nan)
    slopes, roughness = _fit_planes(height, config.window, cell)
    rough = np.isnan(roughness) | (roughness > config.roughness)
    rough |= np.hypot(slopes[..., 0], slopes[..., 1]) > math.tan(config.slope)
    order = np.argsort(np.where(rough, np.inf, roughness), axis=None)[: int((~rough).sum())]
    labels = _grow(height, slopes, ~rough, order, math.cos(config.bend), config.thickness, cell)
    found: list[Patch] = []
    least, reach = config.area / cell**2, config.window // 2
    for label, box in enumerate(ndimage.find_objects(labels), start=1):
        if box is None:
            continue
        box = tuple(slice(max(part.start - reach - 1, 0), part.stop + reach + 1) for part in box)
        mask = labels[box] == label
        if mask.sum() < least:
            continue
        corner = np.array([part.start for part in box])
        # plane[2] is the height at the centre of the corner cell
        plane = _plane(np.argwhere(mask).astype(np.float64) * cell, height[box][mask])
        grid = np.indices(mask.shape) * cell
        deviation = height[box] - (plane[0] * grid[0] + plane[1] * grid[1] + plane[2])
        grown = ndimage.binary_dilation(mask, iterations=reach) & (np.abs(deviation) <= config.thickness)
        depth = ndimage.distance_transform_edt(np.pad(grown, 1))[1:-1, 1:-1]
        normal = np.array([-plane[0], -plane[1], 1.0])
        middle = (terrain.origin + corner + 0.5) * cell
        for corners in _convex_parts((depth - 0.5) * cell >= inset, config.slack, config.pieces):
            xy = corners * cell
            z = xy @ plane[:2] + plane[2]
            patch = Patch(normal / np.linalg.norm(normal), np.column_stack([xy + middle, z]))
            if patch.area >= config.area:
                found.append(patch)
    return found


def _plane(places: Matrix, heights: Vector) -> Vector:
    """Least-squares plane through points: slopes along x and y, and height at the origin (3,)."""
    columns = np.column_stack([places, np.ones(len(places))])
    return np.array(np.linalg.lstsq(columns, heights, rcond=None)[0], dtype=np.float64)


def _convex_parts(mask: NDArray[np.bool_], slack: int, most: int) -> Iterator[Matrix]:
    """Yield at most ``most`` convex polygons (k, 2) in cells that cover a mask and exceed it by ``slack`` at most.

    A part is cut through the cell of its hull that is farthest outside the part, in the direction with the smallest
    hulls on both sides; cells on the cut belong to both.
    """
    waiting, given = _components(np.argwhere(mask)), 0
    while waiting and given < most:
        cells = waiting.pop()
        hull, low = _hull(cells), cells.min(axis=0)
        if len(hull) < 3:
            continue
        part = np.zeros(np.ptp(cells, axis=0) + 1, dtype=bool)
        part[tuple((cells - low).T)] = True
        beside = np.where(_inside(hull - low, part.shape), ndimage.distance_transform_edt(~part), 0.0)
        if beside.max() < slack + 1:
            given += 1
            yield hull.astype(float)
            continue
        deepest = np.array(np.unravel_index(beside.argmax(), part.shape)) + low
        sides = (cells - deepest) @ _CUTS.T  # (n, 4)
        cuts = [[cells[side >= 0], cells[side <= 0]] for side in sides.T]
        cuts = [halves for halves in cuts if max(map(len, halves)) < len(cells)]
        if cuts:
            best = min(cuts, key=lambda halves: sum(_area(_hull(half).astype(np.float64)) for half in halves))
            waiting += [each for half in best for each in _components(half)]


def _components(cells: Cells) -> list[Cells]:
    """Connected components of cells (n, 2)."""
    if not len(cells):
        return []
    low = cells.min(axis=0)
    part = np.zeros(np.ptp(cells, axis=0) + 1, dtype=bool)
    part[tuple((cells - low).T)] = True
    labels, count = ndimage.label(part)
    return [np.argwhere(labels == label) + low for label in range(1, count + 1)]


@njit(cache=True)
def _hull(cells: Cells) -> Cells:
    """Corners (k, 2) of the convex hull of cells (n, 2), counter-clockwise."""
    hull = np.empty((2 * len(cells) + 1, 2), dtype=np.int64)
    return hull[: convex_hull(cells, hull)].copy()


@njit(cache=True)
def _area(polygon: Matrix) -> float:
    """Area of the horizontal projection of a counter-clockwise polygon with corners (k, 2 or 3)."""
    area = 0.0
    for k in range(len(polygon)):
        a, b = polygon[k - 1], polygon[k]
        area += 0.5 * (a[0] * b[1] - b[0] * a[1])
    return area


@njit(cache=True)
def _inside(hull: Cells, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Whether cells are within a convex polygon with counter-clockwise corners (k, 2), edge included."""
    inside = np.ones(shape, dtype=np.bool_)
    for k in range(len(hull)):
        a, b = hull[k], hull[(k + 1) % len(hull)]
        for i in range(shape[0]):
            for j in range(shape[1]):
                if (b[0] - a[0]) * (j - a[1]) - (b[1] - a[1]) * (i - a[0]) < 0:
                    inside[i, j] = False
    return inside


@njit(cache=True)
def _fit_planes(height: Matrix, window: int, cell: float) -> tuple[NDArray[np.float64], Matrix]:
    """Slopes along x and y (n, n, 2) and RMS deviation (n, n) of the square around each cell; nan if any is unknown.

    Over a full square the coordinates are uncorrelated, so each slope follows from one sum.
    """
    size, half = len(height), window // 2
    slopes, roughness = np.full((size, size, 2), np.nan), np.full((size, size), np.nan)
    count = window * window
    spread = 0.0  # sum of the squares of one coordinate over the square [m^2]
    for a in range(-half, half + 1):
        spread += window * (a * cell) ** 2
    for i in range(half, size - half):
        for j in range(half, size - half):
            mean, sx, sy, square = 0.0, 0.0, 0.0, 0.0
            base = height[i, j]
            for a in range(-half, half + 1):
                for b in range(-half, half + 1):
                    z = height[i + a, j + b] - base
                    mean += z
                    square += z * z
                    sx += a * cell * z
                    sy += b * cell * z
            if math.isnan(mean):
                continue
            slopes[i, j, 0], slopes[i, j, 1] = sx / spread, sy / spread
            rest = square - mean * mean / count - sx * sx / spread - sy * sy / spread
            roughness[i, j] = math.sqrt(max(rest, 0.0) / count)
    return slopes, roughness


@njit(cache=True)
def _grow(
    height: Matrix,
    slopes: NDArray[np.float64],
    planar: NDArray[np.bool_],
    order: NDArray[np.int64],
    bend: float,
    thickness: float,
    cell: float,
) -> NDArray[np.int64]:
    """Patch number of each cell, from 1; 0 for none (n, n). ``bend`` is the cosine of the largest angle.

    A patch starts with the plane of its seed, which is fitted again whenever the number of cells has doubled.
    """
    size = len(height)
    labels = np.zeros((size, size), dtype=np.int64)
    queue = np.empty(size * size, dtype=np.int64)
    patch = 0
    for seed in order:
        si, sj = seed // size, seed % size
        if labels[si, sj]:
            continue
        patch += 1
        labels[si, sj] = patch
        sx, sy = slopes[si, sj]
        base, fitted = height[si, sj], 4
        queue[0] = seed
        first, last = 0, 1
        while first < last:
            i, j = queue[first] // size, queue[first] % size
            first += 1
            if last >= 2 * fitted:
                fitted = last
                base, sx, sy = _fit_cells(height, queue[:last], si, sj, cell)
            norm = math.sqrt(1.0 + sx * sx + sy * sy)
            for k in range(4):
                u, v = i + _NEIGHBOURS[k, 0], j + _NEIGHBOURS[k, 1]
                if u < 0 or v < 0 or u >= size or v >= size or labels[u, v] or not planar[u, v]:
                    continue
                x, y = slopes[u, v]
                if 1.0 + sx * x + sy * y < bend * norm * math.sqrt(1.0 + x * x + y * y):
                    continue
                if abs(height[u, v] - base - cell * ((u - si) * sx + (v - sj) * sy)) > thickness:
                    continue
                labels[u, v] = patch
                queue[last] = u * size + v
                last += 1
    return labels


@njit(cache=True)
def _fit_cells(height: Matrix, cells: NDArray[np.int64], i: int, j: int, cell: float) -> tuple[float, float, float]:
    """Least-squares plane through cells: height at the cell (i, j), and slopes along x and y."""
    size, normal, right = len(height), np.zeros((3, 3)), np.zeros(3)
    row = np.ones(3)
    for k in cells:
        a, b = k // size, k % size
        row[1], row[2] = (a - i) * cell, (b - j) * cell
        for m in range(3):
            right[m] += row[m] * height[a, b]
            for n in range(3):
                normal[m, n] += row[m] * row[n]
    for m in range(3):
        normal[m, m] += 1e-9  # regularisation: cells on one line have no slope across it
    plane = np.linalg.solve(normal, right)
    return plane[0], plane[1], plane[2]
