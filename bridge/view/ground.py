"""Map of the ground and its planar patches in a viser scene."""

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bridge.view.scene import LIFT, WORLD, closed
from models.errors import MessageError
from models.nodes import topics
from models.nodes.grid_map import grid_map_type, layer_of
from models.nodes.messages import decode
from models.nodes.qos import SENSOR
from models.nodes.services import own_message
from models.types import Matrix, Vector

MESH, PATCHES = f"{WORLD}/ground/map", f"{WORLD}/ground/patches"
COLORS = {MESH: (150, 140, 120), PATCHES: (120, 60, 160)}


class GroundScene:
    """Draws the newest map as a mesh, and the outlines of its patches; nothing if their types are not built.

    ``silence`` is the age from which a map is removed [s].
    """

    def __init__(self, scene: Any, node: Any, silence: float) -> None:
        self._scene, self._silence = scene, silence
        self._newest: dict[str, bytes] = {}
        self._drawn: dict[str, float] = {}  # monotonic time of each drawn object by name [s]
        self._kinds: dict[str, Any] = {}
        try:
            self._kinds = {MESH: grid_map_type(), PATCHES: own_message("TerrainPatches")}
        except MessageError:  # not built without a compiler; then there is no map either
            return
        for name, topic in ((MESH, topics.TERRAIN_MAP), (PATCHES, topics.TERRAIN_PATCHES)):
            node.create_subscription(self._kinds[name], topic, self._keep(name), SENSOR, raw=True)

    def _keep(self, name: str) -> Any:
        def keep(data: bytes) -> None:
            self._newest[name] = data

        return keep

    def show(self) -> str:
        """Draw the messages since the last call; returns the reason if one cannot be read, empty otherwise."""
        now = time.monotonic()
        for name in [name for name, drawn in self._drawn.items() if now - drawn > self._silence]:
            self._scene.remove_by_name(name)
            del self._drawn[name]
        newest, self._newest = self._newest, {}
        try:
            for name, data in newest.items():
                self._draw(name, decode(data, self._kinds[name]))
                self._drawn[name] = now
        except MessageError as error:
            return f"map of the ground: {error}"
        return ""

    def _draw(self, name: str, message: Any) -> None:
        if name == PATCHES:
            lines = [closed(_corners(patch)) for patch in message.patches]
            drawn = np.concatenate([np.zeros((0, 2, 3)), *lines]).astype(np.float32)
            self._scene.add_line_segments(name, drawn, COLORS[name])
            return
        place, heights = message.info.pose.position, layer_of(message, "elevation")
        vertices, faces = surface(heights, np.array([place.x, place.y]), message.info.resolution)
        self._scene.add_mesh_simple(name, vertices, faces, color=COLORS[name], flat_shading=True, side="double")


def surface(heights: Matrix, centre: Vector, cell: float) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """Vertices (k, 3) [m] and triangles (t, 3) of a grid of heights (n, m) about a centre (2,); NaN makes a hole."""
    rows, columns = heights.shape
    i, j = np.indices(heights.shape)
    x, y = (
        centre[axis] + cell * (each + 0.5 - 0.5 * size) for axis, (each, size) in enumerate(((i, rows), (j, columns)))
    )
    known = np.isfinite(heights)
    number = np.cumsum(known).reshape(heights.shape) - 1  # vertex number of each known cell
    whole = known[:-1, :-1] & known[1:, :-1] & known[:-1, 1:] & known[1:, 1:]
    a, b, c, d = (part[whole] for part in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    vertices = np.column_stack([x[known], y[known], heights[known]])
    return vertices.astype(np.float32), faces.astype(np.uint32)


def _corners(patch: Any) -> Matrix:
    """Corners of a poise_interfaces/TerrainPatch, slightly above the ground (k, 3) [m]."""
    return np.array([(point.x, point.y, point.z + LIFT) for point in patch.boundary.points]).reshape(-1, 3)
