"""Buttons and sticks of the page, and what the robot says."""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from bridge.ros.actions import MODE_SERVICES, Actions
from bridge.view.config import ViewConfig
from bridge.view.snapshot import Snapshot, Words
from models.types import Mode
from planners.gait.config import VelocityConfig

DIRECTIONS = {"from the left": -90.0, "from the right": 90.0, "from behind": 0.0, "from the front": 180.0}
"""Headings of pushes in W [deg]; the robot starts facing 0."""

STICK_STEP = 0.05
"""Of the velocity sticks [m/s], [rad/s]."""

_GOOD, _BAD = "#2b8a3e", "#c92a2a"


class Controls:
    """The page's side bar.

    Args:
        gui: viser's gui.
        actions: What the buttons do.
        config: Largest push.
        words: Text commands that get a button.
        limits: Of the velocity sticks.
    """

    def __init__(
        self, gui: Any, actions: Actions, config: ViewConfig, words: Sequence[str], limits: VelocityConfig
    ) -> None:
        self._actions = actions
        self._status = gui.add_html("")
        self._follow = gui.add_checkbox("follow the robot", initial_value=True)
        self._answer = gui.add_markdown("")
        for name in MODE_SERVICES:
            button = gui.add_button(name, color="red" if name == "E-STOP" else None)
            button.on_click(self._calls(name))
        said = gui.add_button_group("say", words)
        said.on_click(self._says)
        with gui.add_folder("velocity, in mode walk"):
            self._drive = gui.add_checkbox("drive", initial_value=False, hint="Publish the sticks' velocity.")
            ends = {
                "forward [m/s]": (-limits.backward, limits.forward),
                "left [m/s]": (-limits.lateral, limits.lateral),
                "turn [rad/s]": (-limits.turn, limits.turn),
            }
            self._sticks = [
                gui.add_slider(label, round(low, 2), round(high, 2), STICK_STEP, 0.0)
                for label, (low, high) in ends.items()
            ]
            gui.add_button("sticks to zero").on_click(lambda _: self._release())
        with gui.add_folder("push, in simulation"):
            force = gui.add_slider("force [N]", 0.0, config.push_force_max, 5.0, min(100.0, config.push_force_max))
            direction = gui.add_dropdown("direction", tuple(DIRECTIONS))
            gui.add_button("push").on_click(
                lambda _: actions.post(lambda: actions.push(_force(force.value, DIRECTIONS[direction.value])))
            )

    @property
    def follow(self) -> bool:
        """Whether the robot is to stay in the middle of the picture."""
        return bool(self._follow.value)

    def tell(self, text: str) -> None:
        """Show the newest answer."""
        self._answer.content = f"`{text[:160]}`"

    def drive(self, *, watched: bool) -> None:
        """Publish the sticks' velocity while somebody holds them; called at ``drive_rate``.

        Args:
            watched: Whether a browser is there: the sticks of a page that nobody looks at are let go.
        """
        if not watched and self._drive.value:
            self._drive.value = False
            self._release()
        forward, left, turn = (float(stick.value) for stick in self._sticks)
        self._actions.drive((forward, left, turn) if self._drive.value else None)

    def show(self, snapshot: Snapshot, words: Words) -> None:
        """Show mode, state and faults."""
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

    def _says(self, event: Any) -> None:
        word = str(event.target.value)
        self._actions.post(lambda: self._actions.say(word))

    def _calls(self, name: str) -> Callable[[object], None]:
        return lambda event: self._actions.post(lambda: self._actions.call(name))

    def _release(self) -> None:
        for stick in self._sticks:
            stick.value = 0.0


def _force(size: float, heading: float) -> Any:
    """Force of a size [N] in W along a heading [deg] (3,) [N]."""
    angle = math.radians(heading)
    return size * np.array([math.cos(angle), math.sin(angle), 0.0])
