"""CoM, DCM, ZMP, forces, support polygon and footsteps in a viser scene."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from bridge.stability import LOADED_FRACTION, Balance, balance
from bridge.support_polygon import support_polygon
from bridge.view.config import ViewConfig
from bridge.view.listener import Snapshot
from bridge.view.robot_scene import WORLD
from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.types import Matrix, Vector
from planners.gait.footsteps import Foothold

#: Colour of each thing, red, green and blue [0..255]
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
RADIUS = 0.02  #: Of the balls at CoM, DCM and ZMP [m]
LIFT = 0.003  #: Height of lines above the floor [m]


class BalanceScene:
    """Markers of the balance of the robot in a viser scene; ``balls`` are at CoM, DCM and ZMP."""

    def __init__(self, scene: Any, model: RobotModel, config: ViewConfig) -> None:
        self._scene, self._model, self._config, self._data = scene, model, config, model.data()
        self.balls = {
            name: scene.add_icosphere(f"{WORLD}/balance/{name}", radius=RADIUS, color=COLORS[name], subdivisions=2)
            for name in ("com", "dcm", "zmp")
        }
        self._corners = [foot.corners for foot in model.feet]

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
        """Ground reactions at the soles, and the estimated push at the CoM."""
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
        lines = _closed(np.column_stack([polygon, np.full(len(polygon), floor + LIFT)]))
        self._draw(f"{WORLD}/balance/polygon", len(lines) > 0, self._scene.add_line_segments, lines, COLORS["polygon"])

    def _show_footsteps(self, snapshot: Snapshot, floor: float) -> None:
        for side, name in enumerate(("left", "right")):
            holds = [hold for foot, hold in snapshot.footsteps if foot == side]
            lines = [_closed(outline(hold, self._corners[side], floor + LIFT)) for hold in holds]
            drawn = np.concatenate(lines) if lines else np.empty((0, 2, 3))
            self._draw(f"{WORLD}/gait/{name}", len(drawn) > 0, self._scene.add_line_segments, drawn, COLORS[name])

    def _draw(self, name: str, there: bool, add: Any, points: Matrix, colors: Any) -> None:
        """Replace an object of changing size."""
        if there:
            add(name, points.astype(np.float32), colors)
        else:
            self._scene.remove_by_name(name)


def outline(hold: Foothold, corners: Matrix, height: float) -> Matrix:
    """Corners of a sole at a foothold, in W (4, 3) [m], from those in its frame (4, 3) [m] and the floor height [m]."""
    c, s = math.cos(hold.yaw), math.sin(hold.yaw)
    turned = corners[:, :2] @ np.array([[c, s], [-s, c]])
    return np.column_stack([turned + np.array([hold.x, hold.y]), np.full(len(corners), height)])


def _closed(points: Matrix) -> Matrix:
    """Closed line segments through points (n, 3): (n, 2, 3)."""
    return np.stack([points, np.roll(points, -1, axis=0)], axis=1)
