"""Meshes, balance and footsteps of the robot in a viser scene."""

import json
import warnings
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import trimesh

from bridge.analysis.stability import LOADED_FRACTION, Balance, balance, support_polygon
from bridge.view.listener import Snapshot, ViewConfig
from models.constants import GRAVITY
from models.heading import heading, turned
from models.robot_model import RobotModel
from models.types import Matrix, Vector
from models.urdf import data_folder
from planners.gait.footsteps import Foothold

WORLD = "/world"  #: Scene frame of ``odom``; it moves under the robot when the camera follows


class RobotScene:
    """Scene frames of the joints with the meshes of their bodies; ``missing`` lists meshes that cannot be read."""

    def __init__(self, scene: Any, model: RobotModel) -> None:
        self._model, self._data = model, model.data()
        self.missing: list[str] = []
        self.frames = {
            joint: scene.add_frame(f"{WORLD}/robot/{model.pin.names[joint]}", show_axes=False)
            for joint in range(1, model.pin.njoints)
        }
        for shape in _visuals(model):
            if shape.parentJoint not in self.frames:
                continue
            mesh = _mesh_of(shape)
            if mesh is None:
                self.missing.append(shape.name)
                continue
            color = tuple(int(255 * channel) for channel in shape.meshColor[:3])
            scene.add_mesh_simple(
                f"{WORLD}/robot/{model.pin.names[shape.parentJoint]}/{shape.name}",
                np.asarray(mesh.vertices, dtype=np.float32) * np.asarray(shape.meshScale, dtype=np.float32),
                np.asarray(mesh.faces, dtype=np.uint32),
                color=color,
                flat_shading=True,
                wxyz=_wxyz(shape.placement.rotation),
                position=shape.placement.translation,
            )

    def show(self, q: Vector) -> None:
        """Move the robot to a configuration (nq,)."""
        pin.forwardKinematics(self._model.pin, self._data, q)
        for joint, frame in self.frames.items():
            placement = self._data.oMi[joint]
            frame.position, frame.wxyz = placement.translation.copy(), _wxyz(placement.rotation)


def _visuals(model: RobotModel) -> list[Any]:
    folders = [data_folder().parent, model.urdf.parent, *model.urdf.parent.parents[:2]]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # Pinocchio warns about repeated folders
        return list(
            pin.buildGeomFromUrdf(
                model.pin, str(model.urdf), pin.GeometryType.VISUAL, [str(path) for path in folders]
            ).geometryObjects
        )


def _mesh_of(shape: Any) -> Any:
    """Unscaled triangles of a visual shape (trimesh); None if they cannot be read."""
    if Path(shape.meshPath).is_file():
        try:
            return trimesh.load(shape.meshPath, force="mesh")
        except Exception:  # trimesh raises many types, also without a decoder
            return None
    geometry = shape.geometry
    if isinstance(geometry, coal.Box):
        return trimesh.creation.box(extents=2.0 * geometry.halfSide)
    if isinstance(geometry, coal.Sphere):
        return trimesh.creation.icosphere(subdivisions=2, radius=geometry.radius)
    if isinstance(geometry, coal.Cylinder):
        return trimesh.creation.cylinder(radius=geometry.radius, height=2.0 * geometry.halfLength, sections=24)
    if isinstance(geometry, coal.Capsule):
        return trimesh.creation.capsule(radius=geometry.radius, height=2.0 * geometry.halfLength, count=(16, 16))
    return None


def _wxyz(rotation: Any) -> Vector:
    """Quaternion w, x, y, z of a rotation matrix, in viser's order."""
    return np.roll(pin.Quaternion(rotation).coeffs(), 1)


#: Colour of each object: red, green and blue [0..255]
COLORS = {
    "com": (40, 90, 220),
    "dcm": (220, 60, 40),
    "zmp": (40, 160, 70),
    "force": (40, 160, 70),
    "push": (230, 120, 20),
    "polygon": (40, 160, 70),
    "left": (60, 120, 220),
    "right": (220, 120, 60),
}
GREY = (50, 50, 60)  #: Colour of the robot when drawn as lines
DOT, BONE, THIN = 8, 6, 2  #: Line widths of the balls, of the robot and of other objects [px]
RADIUS = 0.02  #: Radius of the balls at CoM, DCM and ZMP [m]
LIFT = 0.003  #: Height of lines above the floor [m]


class BalanceScene:
    """Markers of the balance of the robot in a viser scene; ``balls`` mark CoM, DCM and ZMP."""

    def __init__(self, scene: Any, model: RobotModel, config: ViewConfig) -> None:
        self._scene, self._model, self._config, self._data = scene, model, config, model.data()
        self.balls = {
            name: scene.add_icosphere(f"{WORLD}/balance/{name}", radius=RADIUS, color=COLORS[name], subdivisions=2)
            for name in ("com", "dcm", "zmp")
        }
        self._corners = [foot.corners for foot in model.feet]
        self._lines: dict[str, tuple[Matrix, Any]] = {}  # drawn lines (n, 2, 3) and colours, by name

    def show(self, snapshot: Snapshot) -> Balance:
        """Draw a snapshot; returns its balance."""
        state = balance(self._model, self._data, snapshot.q, snapshot.v, snapshot.wrenches)
        floor = float(state.soles[:, 2].min())
        self.balls["com"].position = state.com
        self.balls["dcm"].position = (*state.dcm, floor + LIFT)
        in_flight = bool(np.isnan(state.cop).any())
        self.balls["zmp"].visible = not in_flight
        if not in_flight:
            self.balls["zmp"].position = (*state.cop, floor + LIFT)
        self._show_forces(snapshot, state)
        self._show_polygon(snapshot, state, floor)
        self._show_footsteps(snapshot, floor)
        return state

    def _show_forces(self, snapshot: Snapshot, state: Balance) -> None:
        arrows: list[Any] = []
        colors: list[Any] = []
        for foot, wrench in zip(self._model.feet, snapshot.wrenches, strict=True):
            placement = self._data.oMf[foot.frame_id]
            self._append(arrows, colors, placement.translation, placement.rotation @ wrench[:3], COLORS["force"])
        self._append(arrows, colors, state.com, snapshot.push[:3], COLORS["push"])
        self._draw(
            f"{WORLD}/balance/forces",
            bool(arrows),
            self._scene.add_arrows,
            np.array(arrows),
            np.array(colors, dtype=np.uint8),
        )

    def _append(self, arrows: list[Any], colors: list[Any], start: Vector, force: Vector, color: Any) -> None:
        if np.linalg.norm(force) >= self._config.force_least:
            arrows.append([start, start + self._config.force_scale * force])
            colors.append(color)

    def _show_polygon(self, snapshot: Snapshot, state: Balance, floor: float) -> None:
        loaded = snapshot.wrenches[:, 2] > LOADED_FRACTION * self._model.mass * GRAVITY
        polygon = support_polygon(tuple(state.corners[loaded])) if loaded.any() else np.empty((0, 2))
        lines = closed(np.column_stack([polygon, np.full(len(polygon), floor + LIFT)]))
        self._draw(f"{WORLD}/balance/polygon", len(lines) > 0, self._scene.add_line_segments, lines, COLORS["polygon"])

    def _show_footsteps(self, snapshot: Snapshot, floor: float) -> None:
        for side, name in enumerate(("left", "right")):
            holds = [hold for foot, hold in snapshot.footsteps if foot == side]
            lines = [closed(outline(hold, self._corners[side], floor + LIFT)) for hold in holds]
            drawn = np.concatenate(lines) if lines else np.empty((0, 2, 3))
            self._draw(f"{WORLD}/gait/{name}", len(drawn) > 0, self._scene.add_line_segments, drawn, COLORS[name])

    def _draw(self, name: str, there: bool, add: Any, points: Matrix, colors: Any) -> None:
        """Replace an object of variable size, or remove it."""
        if there:
            add(name, points.astype(np.float32), colors)
            self._lines[name] = points, colors
        else:
            self._scene.remove_by_name(name)
            self._lines.pop(name, None)

    def flat(self, robot: RobotScene, snapshot: Snapshot, state: Balance) -> str:
        """The same scene as an HTML element of lines for ``page.js``: ends in W, width [px], colour."""
        parents, frames = self._model.pin.parents, robot.frames
        links = [[frames[parents[i]].position, frames[i].position] for i in frames if parents[i] in frames]
        bones = np.concatenate([links, *map(closed, state.corners)])
        dots = [(np.array([[ball.position] * 2]), ball.color, DOT) for ball in self.balls.values() if ball.visible]
        thin = [(points, colors, THIN) for points, colors in self._lines.values()]
        lines = [
            [*ends.ravel().round(3).tolist(), width, *map(int, color)]
            for points, colors, width in [(bones, GREY, BONE), *thin, *dots]
            for ends, color in zip(points, np.broadcast_to(colors, (len(points), 3)), strict=True)
        ]
        base = [*snapshot.q[:2], state.soles[:, 2].min()]
        drawn = json.dumps({"base": base, "yaw": heading(*snapshot.q[3:7]), "lines": lines})
        return f"<div class='poise-drawing' data-state='{drawn}'></div>"


def outline(hold: Foothold, corners: Matrix, height: float) -> Matrix:
    """Corners of a sole at a foothold in W (4, 3) [m], from corners in the sole frame (4, 3) [m] and a height [m]."""
    places = turned(corners[:, :2], hold.yaw) + np.array([hold.x, hold.y])
    return np.column_stack([places, np.full(len(corners), height)])


def closed(points: Matrix) -> Matrix:
    """Line segments of the closed polygon through points (n, 3): (n, 2, 3)."""
    return np.stack([points, np.roll(points, -1, axis=0)], axis=1)
