"""Survey of a lattice of places: whether a sole fits on measured ground, its room, and nearby higher ground."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.numerics.compiled import njit
from models.robot_model import RobotModel
from models.types import Matrix, Vector
from planners.gait.config import GaitConfig
from planners.gait.footsteps import LEFT, Foothold
from planners.terrain.elevation_map import Heights
from planners.terrain.ground_config import SoleConfig
from planners.terrain.leg_extent import layer_at, leg_extent

GRID = (0.01, 0.02)  #: Spacing of places along and across a line [m]
_POINTS = 0.02  #: Largest spacing of the points that a plane is fitted to [m]


class _Lattice(NamedTuple):
    """Places along and across a line on a grid of heights, for compiled code."""

    heights: Matrix  #: See ``Heights``
    corner: tuple[float, float]
    cell: float
    line: tuple[float, float, float, float]  #: x and y of the start in W [m], cosine and sine of the heading
    ways: Vector  #: Positions along the line (n,) [m]
    sides: Vector  #: Positions across the line, left positive (m,) [m]


class Survey(NamedTuple):
    """Ground under a sole at each place of a lattice (n, m)."""

    #: 1: the sole fits; 2: the ground is rough, and the sole may only be moved there; 0: it does not fit, or the leg is
    #: in higher ground; -1: some of the ground is unknown
    fits: NDArray[np.int8]
    height: Matrix  #: Height of the fitted plane at the place [m]
    along: Matrix  #: Slope of the plane along the line [-]
    across: Matrix  #: Slope of the plane across the line [-]
    low: Matrix  #: Lowest known height [m]
    high: Matrix  #: Highest known height [m]
    room: Matrix  #: Distance that the sole may move on the same ground: back, forward, right, left (n, m, 4) [m]
    wall: Matrix  #: Proximity of higher ground to the leg: 0 from ``SoleConfig.wall`` on, 1 at contact [-]
    top: Matrix  #: Highest known ground across the width of the sole at the place; -inf if unknown [m]


class SoleSurvey:
    """Fits planes to the ground under a sole, extended by ``swing.edge`` at its ends and ``beside`` at its sides.

    A sole does not fit where its leg would be in higher ground, see ``leg_extent``.

    Attributes:
        points: Sample points of this ground in the frame of the sole (k, 2) [m].
    """

    def __init__(self, robot: RobotModel, config: GaitConfig, sole: SoleConfig) -> None:
        self._sole, beside = sole, sole.beside
        x_min, x_max, y_min, y_max = robot.feet[LEFT].rectangle
        self._leg, edge = leg_extent(robot, config.pace.fast.crouch), config.swing.edge
        across = np.linspace(y_min - beside, y_max + beside, 2 + round((y_max - y_min + 2.0 * beside) / _POINTS))
        along = np.linspace(x_min - edge, x_max + edge, 2 + round((x_max - x_min + 2.0 * edge) / _POINTS))
        self.points, self._across = np.array([(x, y) for x in along for y in across]), across
        self._inverse = np.linalg.pinv(np.column_stack([self.points, np.ones(len(self.points))]))

    def survey(self, ground: Heights, line: Foothold, ways: Vector, sides: Vector) -> Survey:
        """Survey places at ``ways`` along a line (n,) and ``sides`` across it (m,), ``GRID`` apart [m]."""
        sole = self._sole
        more = round(sole.along / GRID[0])  # extra places, for the room of the first and last
        beyond = GRID[0] * np.arange(1, more + 1)
        longer = np.concatenate([ways[0] - beyond[::-1], ways, ways[-1] + beyond])
        grid = _lattice_on(ground, line, longer, sides)
        fits, planes, bounds = _fit_planes(grid, self.points, self._inverse, (sole.flat, sole.rough))
        height = planes[..., 2]
        wall = _walls(grid, self._leg, self._across, fits, planes, sole.higher, sole.wall)
        fits[wall > 1.0] = 0
        room = _rooms(fits, height, (more, round(sole.across / GRID[1])), sole.same) * np.repeat(GRID, 2)
        top = _tops(grid, self._across)
        layers = fits, height, planes[..., 0], planes[..., 1], bounds[..., 0], bounds[..., 1], room, wall, top
        return Survey(*(np.ascontiguousarray(layer[more:-more]) for layer in layers))

    def height_under(self, ground: Heights, hold: Foothold) -> float:
        """Height of the plane under a sole at ``hold`` [m]; nan if the sole does not fit."""
        grid = _lattice_on(ground, hold, np.zeros(1), np.zeros(1))
        fits, planes, _ = _fit_planes(grid, self.points, self._inverse, (self._sole.flat, self._sole.rough))
        return float(planes[0, 0, 2]) if fits[0, 0] == 1 else math.nan

    def tops(self, ground: Heights, line: Foothold, ways: Vector, sides: Vector) -> Matrix:
        """``Survey.top`` of places at ``ways`` along a line (n,) and ``sides`` across it (m,) [m]."""
        return _tops(_lattice_on(ground, line, ways, sides), self._across)


def _lattice_on(ground: Heights, line: Foothold, ways: Vector, sides: Vector) -> _Lattice:
    values, corner, cell, _ = ground
    return _Lattice(values, corner, cell, (line.x, line.y, math.cos(line.yaw), math.sin(line.yaw)), ways, sides)


@njit(cache=True, forceinline=True)
def _cell_of(x: float, x_min: float, cell: float, count: int) -> int:
    """Cell of a coordinate along an axis; -1 outside. Takes scalars: an array argument takes twice as long."""
    k = math.floor((x - x_min) / cell)
    return k if 0 <= k < count else -1


@njit(cache=True, forceinline=True)
def _height_at(grid: _Lattice, along: float, across: float) -> float:
    """Height at a place along and across the line; nan if unknown."""
    heights, (x_min, y_min), (x0, y0, c, s) = grid.heights, grid.corner, grid.line
    i = _cell_of(x0 + c * along - s * across, x_min, grid.cell, heights.shape[0])
    j = _cell_of(y0 + s * along + c * across, y_min, grid.cell, heights.shape[1])
    return float(heights[i, j]) if i >= 0 and j >= 0 else math.nan


@njit(cache=True)
def _tops(grid: _Lattice, points: Vector) -> Matrix:
    """Highest known ground at points (k,) [m] across from each place; -inf if unknown."""
    top = np.full((len(grid.ways), len(grid.sides)), -np.inf)
    for i in range(len(grid.ways)):
        for j in range(len(grid.sides)):
            for beside in points:
                height = _height_at(grid, grid.ways[i], grid.sides[j] + beside)
                if height > top[i, j]:
                    top[i, j] = height
    return top


@njit(cache=True)
def _fit_planes(
    grid: _Lattice,
    points: Matrix,
    inverse: Matrix,
    flat: tuple[float, float],
) -> tuple[NDArray[np.int8], Matrix, Matrix]:
    """Fit planes to the ground at points (k, 2) around each place: fits, planes, bounds of height; see ``Survey``."""
    shape, found = (len(grid.ways), len(grid.sides)), np.empty(len(points))
    fits, planes, bounds = np.zeros(shape, np.int8), np.zeros((*shape, 3)), np.empty((*shape, 2))
    heights, (x_min, y_min), cell, (x0, y0, c, s) = grid.heights, grid.corner, grid.cell, grid.line
    along, across = np.empty((len(points), 2)), np.empty((len(grid.sides), len(points), 2))
    for j in range(shape[1]):
        for k in range(len(points)):
            side = grid.sides[j] + points[k, 1]
            across[j, k, 0], across[j, k, 1] = s * side, c * side
    for i in range(shape[0]):
        for k in range(len(points)):
            way = grid.ways[i] + points[k, 0]
            along[k, 0], along[k, 1] = x0 + c * way, y0 + s * way
        for j in range(shape[1]):
            known, low, high = True, np.inf, -np.inf
            for k in range(len(points)):
                x = _cell_of(along[k, 0] - across[j, k, 0], x_min, cell, heights.shape[0])
                y = _cell_of(along[k, 1] + across[j, k, 1], y_min, cell, heights.shape[1])
                found[k] = heights[x, y] if x >= 0 and y >= 0 else math.nan
                if math.isnan(found[k]):
                    known = False
                else:
                    low, high = min(low, found[k]), max(high, found[k])
            bounds[i, j, 0], bounds[i, j, 1] = low, high
            if not known:
                fits[i, j] = -1
                continue
            for axis in range(3):
                total = 0.0
                for k in range(len(points)):
                    total += inverse[axis, k] * found[k]
                planes[i, j, axis] = total
            worst = 0.0
            for k in range(len(points)):
                on = planes[i, j, 0] * points[k, 0] + planes[i, j, 1] * points[k, 1] + planes[i, j, 2]
                worst = max(worst, abs(found[k] - on))
            fits[i, j] = 1 if worst <= flat[0] else 2 if worst <= flat[1] else 0
    return fits, planes, bounds


@njit(cache=True)
def _rooms(fits: NDArray[np.int8], height: Matrix, steps: tuple[int, int], same: float) -> Matrix:
    """Lattice steps, at most ``steps`` along and across, by which a sole may move: back, forward, right, left.

    The sole fits at all places in between (across, also on rough ground), and neighbours differ by at most ``same`` in
    height. Places across have at least the same room along, up to one step.
    """
    rooms = np.zeros((*fits.shape, 4))
    for way in range(2):  # the room across depends on the room along
        for i in range(fits.shape[0]):
            for j in range(fits.shape[1]):
                if fits[i, j] <= 0:
                    continue
                for sign in (-1, 1):
                    last, count = height[i, j], 0
                    while count < steps[way]:
                        row, column = (i + sign * (count + 1), j) if way == 0 else (i, j + sign * (count + 1))
                        if not (0 <= row < fits.shape[0] and 0 <= column < fits.shape[1]):
                            break
                        if fits[row, column] <= 0 or (way == 0 and fits[row, column] == 2):
                            break
                        if abs(height[row, column] - last) > same:
                            break
                        if way == 1 and (
                            rooms[row, column, 0] < rooms[i, j, 0] - 1 or rooms[row, column, 1] < rooms[i, j, 1] - 1
                        ):
                            break
                        last, count = height[row, column], count + 1
                    rooms[i, j, 2 * way + (sign + 1) // 2] = count
    return rooms


@njit(cache=True)
def _walls(
    grid: _Lattice,
    leg: Matrix,
    across: Vector,
    fits: NDArray[np.int8],
    planes: Matrix,
    higher: float,
    reach: float,
) -> Matrix:
    """Proximity of ground that is ``higher`` than the plane of a sole [m] to its leg: 0 at ``reach`` [m], 1 at contact.

    Beside the middle line, at the points ``across`` the sole (k,) [m], ground only counts within the leg (above 1).
    A value above 1 only shows that the leg is in higher ground, not how far.
    """
    wall, nearest = np.zeros(fits.shape), leg[0]
    for i in range(len(grid.ways)):
        for j in range(len(grid.sides)):
            if fits[i, j] <= 0:
                continue
            for k in range(-1, len(across)):
                beside, beyond = (across[k], 0.0) if k >= 0 else (0.0, reach)
                for side, sign in ((0, -1.0), (1, 1.0)):
                    ahead, farthest = nearest[side], leg[-1, side] + sign * beyond
                    while sign * (farthest - ahead) > 0.0 and wall[i, j] <= 1.0:
                        ahead += sign * 0.5 * grid.cell
                        above = _height_at(grid, grid.ways[i] + ahead, grid.sides[j] + beside)
                        above -= planes[i, j, 2] + planes[i, j, 0] * ahead + planes[i, j, 1] * beside
                        if above > higher:
                            share = 1.0 - sign * (ahead - leg[layer_at(above, len(leg)), side]) / reach
                            if k < 0 or share > 1.0:
                                wall[i, j] = max(wall[i, j], share)
    return wall
