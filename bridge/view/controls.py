"""Buttons and sticks of the page, and what the robot says."""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from bridge.ros.operator import MODE_SERVICES, Operator
from bridge.view.config import ViewConfig
from bridge.view.snapshot import Snapshot, Words
from bridge.view.sticks import Sticks
from models.heading import heading
from models.types import Mode, Vector
from planners.gait.config import VelocityConfig

DIRECTIONS = {"from the left": -90.0, "from the right": 90.0, "from behind": 0.0, "from the front": 180.0}
"""Headings of pushes, from that of the robot [deg]."""

PUSH_STEP, PUSH_FIRST = 5.0, 100.0
"""Of the slider for pushes: its step, and where it starts [N]."""

ANSWER_MAX = 160
"""Characters of an answer that are shown [-]."""

_GOOD, _BAD = "#2b8a3e", "#c92a2a"


class Controls:
    """The page's side bar.

    Args:
        gui: viser's gui.
        operator: What the buttons do.
        config: Largest push.
        words: Text commands that get a button.
        limits: Of the velocity sticks.

    Attributes:
        sticks: For velocities.
    """

    def __init__(
        self, gui: Any, operator: Operator, config: ViewConfig, words: Sequence[str], limits: VelocityConfig
    ) -> None:
        self._operator, self._yaw = operator, 0.0
        self._status = gui.add_html("")
        self._follow = gui.add_checkbox("follow the robot", initial_value=True)
        self._answer = gui.add_markdown("")
        for name in MODE_SERVICES:
            button = gui.add_button(name, color="red" if name == "E-STOP" else None)
            button.on_click(self._calls(name))
        said = gui.add_button_group("say", words)
        said.on_click(self._says)
        self.sticks = Sticks(gui, limits, config.drive_idle, self.tell)
        with gui.add_folder("push, in simulation"):
            most = config.push_force_max
            force = gui.add_slider("force [N]", 0.0, most, PUSH_STEP, min(PUSH_FIRST, most))
            direction = gui.add_dropdown("direction", tuple(DIRECTIONS))
            gui.add_button("push").on_click(
                lambda _: operator.post(lambda: operator.push(self._force(force.value, DIRECTIONS[direction.value])))
            )

    @property
    def follow(self) -> bool:
        """Whether the robot is to stay in the middle of the picture."""
        return bool(self._follow.value)

    def tell(self, text: str) -> None:
        """Show the newest answer."""
        self._answer.content = f"`{text[:ANSWER_MAX]}`"

    def show(self, snapshot: Snapshot, words: Words) -> None:
        """Show mode, state and faults."""
        self._yaw = heading(*snapshot.q[3:7])
        good = words.mode in (Mode.STAND.value, Mode.WALK.value, Mode.MOTION.value) and not words.faults
        rows = [
            ("mode", words.mode or "unknown"),
            ("drivers", words.drivers or "unknown"),
            ("gait", words.phase or "unknown"),
            ("in command", words.commander or "nobody"),
            ("capture margin", "-" if math.isnan(snapshot.margin) else f"{100 * snapshot.margin:.1f} cm"),
            ("time", f"{snapshot.t:.1f} s"),
        ]
        lines = [f"<b>{name}</b>: {html.escape(value)}" for name, value in rows]
        lines += [
            f'<span style="color:{_BAD}"><b>{html.escape(node)}</b>: {html.escape(text)}</span>'
            for node, text in words.faults
        ]
        edge = _GOOD if good else _BAD
        self._status.content = (
            f'<div style="border-left:6px solid {edge};padding:4px 8px;margin:4px;font-size:13px">'
            + "<br>".join(lines)
            + "</div>"
        )

    def _force(self, size: float, direction: float) -> Vector:
        return force_from(size, direction, self._yaw)

    def _says(self, event: Any) -> None:
        word = str(event.target.value)
        self._operator.post(lambda: self._operator.say(word))

    def _calls(self, name: str) -> Callable[[object], None]:
        return lambda event: self._operator.post(lambda: self._operator.call(name))


def force_from(size: float, direction: float, yaw: float) -> Vector:
    """A push in W (3,) [N].

    Args:
        size: [N].
        direction: Heading of the push from that of the robot [deg].
        yaw: Heading of the robot in W [rad].
    """
    angle = yaw + math.radians(direction)
    return size * np.array([math.cos(angle), math.sin(angle), 0.0])
