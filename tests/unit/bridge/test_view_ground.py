"""The mesh of the map: places of its vertices, holes where it is unknown, outlines, and its end."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser")
pytest.importorskip("rclpy")

from rclpy.serialization import serialize_message

from bridge.view.ground import MESH, PATCHES, GroundScene, surface
from models.errors import MessageError
from models.nodes import topics
from models.nodes.grid_map import grid_map_message, grid_map_type, patches_message


def test_a_surface_has_its_cells_as_vertices_and_leaves_out_what_is_unknown() -> None:
    heights = np.arange(12.0).reshape(3, 4)
    heights[0, 3] = np.nan
    vertices, faces = surface(heights, np.array([1.0, -1.0]), 0.5)
    assert vertices.shape == (11, 3) and len(faces) == 10  # five of six squares
    np.testing.assert_allclose(vertices[0], [0.5, -1.75, 0.0])
    np.testing.assert_allclose(vertices[-1], [1.5, -0.25, 11.0])
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] > 0.0).all()
    np.testing.assert_allclose(0.5 * normals[:, 2].sum(), 5 * 0.25)


def test_a_map_is_drawn_and_taken_away_when_it_is_old(monkeypatch: pytest.MonkeyPatch) -> None:
    try:
        grid_map_type()
    except MessageError as error:
        pytest.skip(str(error))
    drawn: dict[str, Any] = {}
    scene = SimpleNamespace(
        add_mesh_simple=lambda name, *shape, **look: drawn.update({name: shape}),
        add_line_segments=lambda name, *shape: drawn.update({name: shape}),
        remove_by_name=drawn.pop,
    )
    callbacks: dict[str, Any] = {}

    def subscribe(kind: Any, topic: str, callback: Any, qos: Any, *, raw: bool) -> None:
        callbacks[topic] = callback

    ground = GroundScene(scene, SimpleNamespace(create_subscription=subscribe), silence=3.0)
    now = [100.0]
    monkeypatch.setattr("bridge.view.ground.time.monotonic", lambda: now[0])
    message = grid_map_message(0, np.zeros(2), 0.1, {"elevation": np.zeros((5, 5))}, "elevation")
    callbacks[topics.TERRAIN_MAP](serialize_message(message))
    corners = np.array([[0.0, 0.0, 0.1], [1.0, 0.0, 0.1], [0.0, 1.0, 0.1]])
    callbacks[topics.TERRAIN_PATCHES](serialize_message(patches_message(0, [(np.array([0.0, 0.0, 1.0]), corners)])))
    ground.show()
    assert len(drawn[MESH][0]) == 25 and drawn[PATCHES][0].shape == (3, 2, 3)
    now[0] += 2.0
    ground.show()
    assert set(drawn) == {MESH, PATCHES}
    now[0] += 2.0
    assert ground.show() == "" and not drawn
    message.layers = ["slope"]
    callbacks[topics.TERRAIN_MAP](serialize_message(message))
    assert "no 'elevation' among slope" in ground.show() and not drawn
