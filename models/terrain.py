"""Terrain: tiles, slopes and stairs as blocks, and the ground height at any point."""

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, Positive, default_config
from models.errors import ConfigError
from models.types import Matrix

Angle = Annotated[float, Field(gt=-0.6, lt=0.6)]
Coordinate = TypeVar("Coordinate", float, NDArray[np.floating[Any]])  #: Coordinate of one point, or of several

FLAT = "flat"
_SEAM = 1e-9  #: Overlap of the blocks in height queries, so that no point falls between two [m]
_DEPTH = 0.5  #: Thickness of a block, enough that nothing passes through it in one physics step [m]


@dataclass(frozen=True, slots=True, config=STRICT)
class Box:
    """A movable box on the ground."""

    size: tuple[Positive, Positive, Positive]  # along x, y and z [m]
    place: tuple[float, float] | None = None  # initial x and y of the centre in W [m]; None: parked


@dataclass(frozen=True, slots=True, config=STRICT)
class Terrain:
    """Terrain; the robot starts at the origin, on a level patch at height zero, heading along x."""

    kind: Literal["flat", "tiles", "stones", "slope", "stairs"]  # slope: a plane; stairs: level treads
    height: float = 0.0  # tiles, stones: uniformly random from 0 to this; stairs: rise, down if negative [m]
    size: Positive = 0.4  # edge of a tile or stone, or depth of a tread [m]
    gap: Positive = 0.15  # width of the gaps between stones, 0.5 m deep [m]
    count: Annotated[int, Field(ge=1)] | None = None  # stairs: rises to a landing; None: to the end of the ground
    landing: Positive = 1.0  # depth of the landing; behind it the same number of rises leads back down [m]
    pitch: Angle = 0.0  # slope along x, up positive [rad]
    roll: Angle = 0.0  # slope along y, up positive; reached gradually over ``ease`` [rad]
    ease: Positive = 0.8  # length of the transition from level ground to ``roll``, in strips [m]
    strips: Annotated[int, Field(ge=1, le=32)] = 8  # number of strips of the transition [1]
    patch: Positive = 0.4  # the level patch extends this far ahead of the origin, and ``width`` behind it [m]
    length: Positive = 12.0  # extent of the ground ahead of the origin [m]
    width: Positive = 3.0  # extent of the ground to each side [m]
    give: Positive | None = None  # contact time constant, long on soft ground; plant's default when None [s]
    seed: Annotated[int, Field(ge=0)] = 0  # seed of the random heights
    obstacle: Box | None = None  # optional

    def __post_init__(self) -> None:
        if self.kind in ("tiles", "stones") and self.height < 0.0:
            raise ValueError(f"height {self.height} m of the {self.kind} is negative")


@dataclass(frozen=True, slots=True)
class Block:
    """A box of ground; the robot walks on its top face."""

    top: tuple[float, float, float]  # centre of the top face in W [m]
    half: tuple[float, float]  # half lengths along x and y, measured along the face [m]
    pitch: float = 0.0  # slope of the face along x, up positive [rad]
    roll: float = 0.0  # slope along y, up positive [rad]; at most one of pitch and roll is nonzero

    @property
    def rotation(self) -> Matrix:
        """Rotation of the block in W (3, 3)."""
        cp, sp, cr, sr = math.cos(self.pitch), math.sin(self.pitch), math.cos(self.roll), math.sin(self.roll)
        along = np.array([[cp, 0.0, -sp], [0.0, 1.0, 0.0], [sp, 0.0, cp]])
        across = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
        rotation: Matrix = along @ across
        return rotation

    @property
    def reach(self) -> tuple[float, float]:
        """Half extents of the top face along x and y of W, including the overlap [m]."""
        return self.half[0] * math.cos(self.pitch) + _SEAM, self.half[1] * math.cos(self.roll) + _SEAM

    @property
    def centre(self) -> tuple[float, float, float]:
        """Centre of the box in W [m]."""
        x, y, z = np.array(self.top) - 0.5 * _DEPTH * self.rotation[:, 2]
        return float(x), float(y), float(z)

    @property
    def half_sizes(self) -> tuple[float, float, float]:
        """Half sizes of the box along the axes of the block [m]."""
        return self.half[0], self.half[1], 0.5 * _DEPTH

    def height(self, x: Coordinate, y: Coordinate) -> Coordinate:
        """Height of the plane of the top face at x, y, also outside the face [m]."""
        return self.top[2] + (x - self.top[0]) * math.tan(self.pitch) + (y - self.top[1]) * math.tan(self.roll)


def terrain_named(terrain: str | Terrain, *, seed: int | None = None) -> Terrain:
    """Terrain given directly or by name, with ``seed`` if not None; ``ConfigError`` for an unknown name."""
    if isinstance(terrain, str):
        known = terrains()
        if terrain not in known:
            raise ConfigError(f"terrain: unknown '{terrain}'; known: {', '.join(known)}")
        terrain = known[terrain]
    return terrain if seed is None else replace(terrain, seed=seed)


@cache
def terrains() -> Mapping[str, Terrain]:
    """Packaged terrains by name; ``flat`` is the first."""
    return {FLAT: Terrain(kind="flat"), **default_config(dict[str, Terrain], "models", "terrain")}


def blocks(terrain: Terrain) -> list[Block]:
    """Blocks of the terrain; empty for flat ground, which is a plane."""
    if terrain.kind == "flat":
        return []
    reach = terrain.patch + terrain.width  # the patch extends backward as far as the ground extends sideways
    patch = Block((terrain.patch - 0.5 * reach, 0.0, 0.0), (0.5 * reach, terrain.width))
    return [patch, *{"tiles": _tiles, "stones": _stones, "slope": _slope, "stairs": _stairs}[terrain.kind](terrain)]


class Ground:
    """Height queries on a terrain."""

    def __init__(self, terrain: Terrain) -> None:
        self._blocks = blocks(terrain)
        self._box = np.array([[*block.top[:2], *block.reach] for block in self._blocks]).reshape(-1, 4)

    def height(self, x: float, y: float) -> float:
        """Ground height at a point [m]; outside the terrain, height of its lowest corner."""
        if not self._blocks:
            return 0.0
        near = (np.abs(self._box[:, 0] - x) <= self._box[:, 2]) & (np.abs(self._box[:, 1] - y) <= self._box[:, 3])
        heights = [self._blocks[int(i)].height(x, y) for i in np.flatnonzero(near)]
        return max(heights) if heights else self.lowest

    @property
    def lowest(self) -> float:
        """Height of the lowest corner [m]."""
        return min(
            (b.top[2] - b.half[0] * abs(math.sin(b.pitch)) - b.half[1] * abs(math.sin(b.roll)) for b in self._blocks),
            default=0.0,
        )


def _tiles(terrain: Terrain) -> list[Block]:
    rng = np.random.default_rng(terrain.seed)
    half, size = 0.5 * terrain.size, terrain.size
    tiles = []
    rows = math.ceil(terrain.width / size)
    for i in range(math.ceil((terrain.length - terrain.patch) / size)):
        for j in range(-rows, rows):
            place = terrain.patch + (i + 0.5) * size, (j + 0.5) * size
            tiles.append(Block((*place, float(rng.uniform(0.0, terrain.height))), (half, half)))
    return tiles


def _stones(terrain: Terrain) -> list[Block]:
    """Rows of stones with one column at y = 0, in a pit as deep as the stones are thick; level ground behind them."""
    rng, half, pitch = np.random.default_rng(terrain.seed), 0.5 * terrain.size, terrain.size + terrain.gap
    rows, columns = math.floor((terrain.length - terrain.patch) / pitch) - 1, math.floor(terrain.width / pitch)
    stones = [
        Block(
            (terrain.patch + (i + 1) * pitch - half, j * pitch, float(rng.uniform(0.0, terrain.height))), (half, half)
        )
        for i in range(rows)
        for j in range(-columns, columns + 1)
    ]
    begin = terrain.patch + rows * pitch + terrain.gap
    run = 0.5 * (begin - terrain.patch)
    pit = Block((terrain.patch + run, 0.0, -_DEPTH), (run, terrain.width))
    return [*stones, pit, Block((begin + 0.5 * terrain.width, 0.0, 0.0), (0.5 * terrain.width, terrain.width))]


def _stairs(terrain: Terrain) -> list[Block]:
    size, reach = terrain.size, terrain.length - terrain.patch
    if terrain.count is None:
        levels = [(i + 1, size) for i in range(math.ceil(reach / size))]
    else:
        up = [(i, size) for i in range(1, terrain.count)]
        levels = [*up, (terrain.count, terrain.landing), *reversed(up)]
        levels.append((0, max(reach - sum(depth for _, depth in levels), size)))
    edges = np.cumsum([terrain.patch, *(depth for _, depth in levels)])
    return [
        Block((float(edge) + 0.5 * depth, 0.0, level * terrain.height), (0.5 * depth, terrain.width))
        for edge, (level, depth) in zip(edges[:-1], levels, strict=True)
    ]


def _slope(terrain: Terrain) -> list[Block]:
    """A ramp along x; or strips with increasing roll, followed by a plane with the full roll."""
    if terrain.pitch:
        run = terrain.length - terrain.patch
        top = terrain.patch + 0.5 * run, 0.0, 0.5 * run * math.tan(terrain.pitch)
        return [Block(top, (0.5 * run / math.cos(terrain.pitch), terrain.width), pitch=terrain.pitch)]
    half = 0.5 * terrain.ease / terrain.strips
    pieces = [
        Block(
            (terrain.patch + (2 * i + 1) * half, 0.0, 0.0),
            (half, terrain.width),
            roll=terrain.roll * (i + 1) / (terrain.strips + 1),
        )
        for i in range(terrain.strips)
    ]
    start = terrain.patch + terrain.ease
    rest = Block(
        (0.5 * (start + terrain.length), 0.0, 0.0),
        (0.5 * (terrain.length - start), terrain.width),
        roll=terrain.roll,
    )
    return [*pieces, rest]
