"""Given map of the ground, known in advance: a grey image of heights, and a YAML file with its scale."""

from pathlib import Path

import numpy as np
import yaml
from PIL import Image
from pydantic.dataclasses import dataclass

from models.config import STRICT, Positive, load_config
from models.errors import ConfigError
from models.terrain import Terrain, blocks
from planners.terrain.elevation_map import Heights

_GREYS = 65535  #: Largest pixel value


@dataclass(frozen=True, slots=True, config=STRICT)
class GivenMap:
    """The YAML file of a map; its keys, except ``heights``, are those of the ROS map_server."""

    image: str  #: 16-bit grey PNG, beside this file or an absolute path; columns along x, rows along -y (left first)
    resolution: Positive  #: Edge length of a pixel [m]
    origin: tuple[float, float, float]  #: Corner of the lower left pixel, from the start of the robot: x, y [m], and 0
    heights: tuple[float, float]  #: Heights of the pixel values 1 and 65535 [m]; the value 0 is unknown

    def __post_init__(self) -> None:
        if self.origin[2] != 0.0:
            raise ValueError(f"origin {list(self.origin)}: the third, its yaw, must be 0: turn the image")
        if self.heights[0] >= self.heights[1]:
            raise ValueError(f"heights {list(self.heights)}: the first is not lower than the second")


def terrain_heights(terrain: Terrain, cell: float = 0.02) -> Heights:
    """Heights of a terrain and the box on it, in cells with an edge of ``cell`` [m]; nan beside the terrain."""
    size = terrain.length, terrain.width
    xs = np.arange(min(-terrain.width, -1.0) + 0.5 * cell, size[0], cell)[:, None]
    ys = np.arange(-size[1] + 0.5 * cell, size[1], cell)[None, :]
    pieces = blocks(terrain)
    values = np.full((xs.size, ys.size), np.nan if pieces else 0.0)
    for piece in pieces:
        inside = (np.abs(xs - piece.top[0]) <= piece.reach[0]) & (np.abs(ys - piece.top[1]) <= piece.reach[1])
        values = np.where(inside, np.fmax(values, piece.height(xs, ys)), values)
    box = terrain.obstacle
    if box is not None and box.place is not None:
        inside = (np.abs(xs - box.place[0]) <= 0.5 * box.size[0]) & (np.abs(ys - box.place[1]) <= 0.5 * box.size[1])
        values = np.where(inside, box.size[2], values)
    return Heights(values, (float(xs[0, 0]) - 0.5 * cell, -size[1]), cell)


def load_given_map(file: Path) -> Heights:
    """Load the heights of a map. Raises ``ConfigError`` that names the file that is missing or malformed."""
    file = file.expanduser()
    try:
        given = load_config(GivenMap, file)
    except ConfigError as error:
        raise ConfigError(f"{error}; poise map writes such a file") from None
    image = file.parent / Path(given.image).expanduser()
    try:
        with Image.open(image) as opened:
            pixels = np.asarray(opened, dtype=np.int64)
            mode = opened.mode
    except OSError as error:  # also UnidentifiedImageError
        raise ConfigError(f"{file}: image: {image}: {error.strerror or 'not an image'}") from None
    except (Image.DecompressionBombError, SyntaxError, ValueError) as error:  # the last two: a damaged PNG
        raise ConfigError(f"{file}: image: {error}") from None
    if not mode.startswith("I") or pixels.ndim != 2:
        raise ConfigError(f"{file}: image: {image} has pixels of mode '{mode}'; save it as a 16-bit grey PNG")
    low, high = given.heights
    heights = np.where(pixels > 0, low + (pixels - 1) * (high - low) / (_GREYS - 1), np.nan)
    return Heights(np.ascontiguousarray(heights[::-1].T), given.origin[:2], given.resolution)


def save_given_map(file: Path, ground: Heights, *, overwrite: bool = False) -> Path:
    """Write a map as ``file`` and an image beside it; returns the image file.

    ``overwrite`` replaces existing files. Raises ``ConfigError`` on failure.
    """
    if file.suffix not in (".yaml", ".yml"):
        raise ConfigError(f"{file}: the file of a map is a .yaml, with a .png beside it")
    known, image = np.isfinite(ground.values), file.with_suffix(".png")
    low = float(ground.values[known].min()) if known.any() else 0.0
    high = max(float(ground.values[known].max()) if known.any() else 0.0, low + 1.0)
    shares = (np.where(known, ground.values, low) - low) / (high - low)
    pixels = np.where(known, 1 + np.rint(shares * (_GREYS - 1)), 0).astype(np.uint16)
    lines = {
        "image": image.name,
        "resolution": ground.cell,
        "origin": [*ground.corner, 0.0],
        "heights": [low, high],
    }
    try:
        for existing in (file, image):
            if existing.exists() and not overwrite:
                raise ConfigError(f"{existing}: exists already: give another file, or --overwrite")
        Image.fromarray(np.ascontiguousarray(pixels.T[::-1])).save(image)
        file.write_text(yaml.safe_dump(lines, sort_keys=False), encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{file}: cannot be written: {error.strerror or error}") from None
    return image
