"""Elevation maps as grid_map_msgs/GridMap, and planar patches as poise_interfaces/TerrainPatches."""

from array import array
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from geometry_msgs.msg import Point32
from std_msgs.msg import Float32MultiArray, MultiArrayDimension

from models.errors import MessageError
from models.nodes.interfaces import interface
from models.nodes.messages import set_header
from models.nodes.services import own_message
from models.nodes.topics import ODOM_FRAME
from models.types import Matrix, Vector

_LABELS = ("column_index", "row_index")  #: Labels of the dimensions of a layer in column-major order


def grid_map_type() -> Any:
    """Type of the message; ``MessageError`` if it is not built."""
    return interface("grid_map_msgs", "msg", "GridMap")


def grid_map_message(stamp: int, centre: Vector, cell: float, layers: Mapping[str, Matrix], basic: str) -> Any:
    """Message with a stamp [ns] from named square layers (n, n); the first index runs along x, the second along y.

    ``centre`` is the centre of the map in ``odom`` (2,) [m], ``cell`` the size of a cell [m], ``basic`` the layer that
    is required for a valid cell. In the message, rows and columns start at the largest x and y.
    """
    message = grid_map_type()(layers=list(layers), basic_layers=[basic])
    set_header(message, stamp, ODOM_FRAME)
    size = len(layers[basic])
    message.info.resolution, message.info.length_x, message.info.length_y = cell, size * cell, size * cell
    message.info.pose.position.x, message.info.pose.position.y = map(float, centre)
    for layer in layers.values():
        data = Float32MultiArray()
        sizes = ((size, size * size), (size, size))
        data.layout.dim = [
            MultiArrayDimension(label=label, size=count, stride=stride)
            for label, (count, stride) in zip(_LABELS, sizes, strict=True)
        ]
        data.data = array("f", layer[::-1, ::-1].astype(np.float32).tobytes(order="F"))
        message.data.append(data)
    return message


def layer_of(message: Any, name: str) -> Matrix:
    """Layer (n, m) of a grid_map_msgs/GridMap, first index along x, second along y; nan where unknown.

    Raises ``MessageError`` for a missing layer, or a layer that is not in column-major order.
    """
    if name not in message.layers or len(message.data) != len(message.layers):
        raise MessageError(f"layers: no '{name[:32]}' among {', '.join(message.layers)}")
    data = message.data[message.layers.index(name)]
    labels, sizes = tuple(dim.label for dim in data.layout.dim), [dim.size for dim in data.layout.dim]
    if labels != _LABELS or len(data.data) != sizes[0] * sizes[1]:
        raise MessageError(
            f"data: {len(data.data)} numbers with the dimensions {labels} of {sizes}, expected {_LABELS}"
        )
    grid = np.array(data.data, dtype=np.float64).reshape(sizes[1], sizes[0], order="F")
    grid = np.roll(grid, (-message.outer_start_index, -message.inner_start_index), axis=(0, 1))
    layer: Matrix = grid[::-1, ::-1]
    return layer


def patches_message(stamp: int, patches: Iterable[tuple[Vector, Matrix]]) -> Any:
    """poise_interfaces/TerrainPatches with a stamp [ns] from normals (3,) and corners (k, 3) [m] in ``odom``."""
    kind, message = own_message("TerrainPatch"), own_message("TerrainPatches")()
    set_header(message, stamp, ODOM_FRAME)
    for normal, corners in patches:
        patch = kind()
        patch.normal.x, patch.normal.y, patch.normal.z = map(float, normal)
        patch.boundary.points = [Point32(x=float(x), y=float(y), z=float(z)) for x, y, z in corners]
        message.patches.append(patch)
    return message
