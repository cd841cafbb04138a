"""Controls and live plots of the page."""

import html
import math
import time
from collections import deque
from collections.abc import Callable, Collection, Sequence
from typing import Any

import numpy as np

from bridge.ros.operator import MODE_SERVICES, Operator
from bridge.view.listener import Snapshot, ViewConfig, Words
from controllers.safety.supervisor import ACTIVE_MODES
from models.heading import heading
from models.robot_model import RobotModel
from models.types import Vector, Velocity
from planners.gait.config import VelocityConfig

#: Directions of pushes relative to the heading of the robot [deg]
DIRECTIONS = {"from the left": -90.0, "from the right": 90.0, "from behind": 0.0, "from the front": 180.0}
PUSH_STEP, PUSH_FIRST = 5.0, 100.0  #: Step and initial value of the slider for pushes [N]
ANSWER_MAX = 160  #: Maximum number of displayed characters of an answer [-]
_GOOD, _BAD = "#2b8a3e", "#c92a2a"


class Controls:
    """Side bar of the page in viser's gui; ``words`` are the text commands with a button."""

    def __init__(
        self, gui: Any, operator: Operator, config: ViewConfig, words: Sequence[str], limits: VelocityConfig
    ) -> None:
        self._operator, self._yaw = operator, 0.0
        self._status = gui.add_html("waiting for the robot")
        self._follow = gui.add_checkbox("follow the robot", initial_value=True)
        self._answer = gui.add_markdown("")
        for name in MODE_SERVICES:
            button = gui.add_button(name, color="red" if name == "E-STOP" else None)
            button.on_click(self._call(name))
        gui.add_button_group("say", words).on_click(self._on_word)
        self.sticks = Sticks(gui, limits, config.drive_idle, self.report)
        with gui.add_folder("push, in simulation"):
            most = config.push_force_max
            force = gui.add_slider("force [N]", 0.0, most, PUSH_STEP, min(PUSH_FIRST, most))
            direction = gui.add_dropdown("direction", tuple(DIRECTIONS))
            gui.add_button("push").on_click(
                lambda _: operator.post(
                    lambda: operator.push(force_from(force.value, DIRECTIONS[direction.value], self._yaw))
                )
            )

    @property
    def follow(self) -> bool:
        """Whether the camera follows the robot."""
        return bool(self._follow.value)

    def report(self, text: str) -> None:
        """Show the newest answer."""
        self._answer.content = f"`{text[:ANSWER_MAX]}`"

    def show(self, snapshot: Snapshot | None, words: Words) -> None:
        """Show mode, state, faults with their reasons, and the next action."""
        if snapshot is not None:
            self._yaw = heading(*snapshot.q[3:7])
        margin = math.nan if snapshot is None else snapshot.margin
        balancing = words.mode in {mode.value for mode in ACTIVE_MODES}
        rows = [
            ("mode", words.mode or "unknown"),
            ("drivers", words.drivers or "unknown"),
            ("gait", words.phase or "unknown" if balancing else "none"),
            ("in command", words.commander or "none"),
            ("capture margin", "-" if math.isnan(margin) else f"{100 * margin:.1f} cm"),
            ("real-time factor", "unknown" if math.isnan(words.factor) else f"{words.factor:.2f}"),
            ("time", "unknown" if snapshot is None else f"{snapshot.t:.1f} s"),
            *words.start,
            ("next", words.next),
        ]
        lines = [f"<b>{words.waiting}</b>"] if words.waiting else []
        lines += [f"<b>{name}</b>: {html.escape(value)}" for name, value in rows]
        lines += [
            f'<span style="color:{_BAD}"><b>{html.escape(node)}</b>: {html.escape(text)}</span>'
            for node, text in words.faults
        ]
        edge = _BAD if words.faults else _GOOD
        self._status.content = (
            f'<div style="border-left:6px solid {edge};padding:4px 8px;margin:4px;font-size:13px">'
            + "<br>".join(lines)
            + "</div>"
        )

    def _on_word(self, event: Any) -> None:
        word = str(event.target.value)
        self._operator.post(lambda: self._operator.say(word))

    def _call(self, name: str) -> Callable[[object], None]:
        return lambda event: self._operator.post(lambda: self._operator.call(name))


def force_from(size: float, direction: float, yaw: float) -> Vector:
    """Push in W (3,) [N] of a size [N], at an angle to the robot's heading [deg]; the heading is ``yaw`` in W [rad]."""
    angle = yaw + math.radians(direction)
    return size * np.array([math.cos(angle), math.sin(angle), 0.0])


STICK_STEP = 0.05  #: Step of the velocity sticks [m/s], [rad/s]


class DeadMan:
    """Dead man's switch: the operator is present if the browser is connected and moved a stick within ``idle`` [s]."""

    def __init__(self, idle: float) -> None:
        self._idle = idle
        self._browser: int | None = None
        self._touched = 0.0

    def touch(self, browser: int, now: float) -> None:
        """Record that a browser has moved a stick at a time [s]."""
        self._browser, self._touched = browser, now

    def present(self, browsers: Collection[int], now: float) -> bool:
        """Whether the operator is present at a time [s], given the connected browsers."""
        return self._browser in browsers and now - self._touched <= self._idle


class Sticks:
    """Three velocity sliders and a check box; without a touch for ``idle`` [s] they are reset, which is reported."""

    def __init__(self, gui: Any, limits: VelocityConfig, idle: float, report: Callable[[str], object]) -> None:
        self._dead_man, self._report, self._idle = DeadMan(idle), report, idle
        with gui.add_folder("velocity"):
            hint = f"Publish the sticks' velocity, for {idle:g} s after the last touch."
            self._drive = gui.add_checkbox("drive", initial_value=False, hint=hint)
            self._sliders = [
                gui.add_slider(f"{axis} [{unit}]", round(low, 2), round(high, 2), STICK_STEP, 0.0)
                for (axis, (low, high)), unit in zip(limits.ranges.items(), ("m/s", "m/s", "rad/s"), strict=True)
            ]
            gui.add_button("sticks to zero").on_click(lambda _: self._zero())
        for handle in (self._drive, *self._sliders):
            handle.on_update(self._on_touch)

    def velocity(self, browsers: Collection[int]) -> Velocity | None:
        """Forward [m/s], left [m/s], turn [rad/s]; None if the box is off, or without an active browser."""
        if not self._drive.value:
            return None
        if not self._dead_man.present(browsers, time.monotonic()):
            self._drive.value = False
            self._zero()
            self._report(f"sticks released: not moved for {self._idle:g} s, or the browser disconnected")
            return None
        forward, left, turn = (float(slider.value) for slider in self._sliders)
        return forward, left, turn

    def _on_touch(self, event: Any) -> None:
        if event.client_id is not None:  # from a browser, not from this program
            self._dead_man.touch(event.client_id, time.monotonic())

    def _zero(self) -> None:
        for slider in self._sliders:
            slider.value = 0.0


#: Colours of the lines of a plot, in order
COLORS = ("#3070d0", "#d05030", "#30a050", "#a040b0", "#c09020", "#606060", "#20a0a0", "#d060a0")


class LivePlots:
    """Stores and plots the last seconds, in the plot folder of the gui."""

    def __init__(self, gui: Any, model: RobotModel, config: ViewConfig) -> None:
        self._model, self._config = model, config
        length = max(int(config.plot_window * config.plot_rate), 2)
        self._rows: deque[tuple[float, ...]] = deque(maxlen=length)
        self._shares: deque[Any] = deque(maxlen=length)
        self._timing = _plot(gui, "tick [us]: blue median, red 99 %", ("median", "99 %"))
        self._margin = _plot(gui, "capture margin, walking [m]", ("margin",))
        self._torques = _plot(gui, "torque over its limit [-]", tuple(f"joint {i}" for i in range(config.torques)))
        self._names = gui.add_markdown("")

    def add(self, snapshot: Snapshot, words: Words) -> None:
        """Add a snapshot and redraw."""
        if self._rows and snapshot.t <= self._rows[-1][0]:
            if snapshot.t == self._rows[-1][0]:  # no new data
                return
            self._rows.clear()  # the simulation was reset
            self._shares.clear()
        self._rows.append((snapshot.t, words.tick_median, words.tick_tail, snapshot.margin))
        self._shares.append(snapshot.tau / self._model.tau_max)
        if len(self._rows) < 2:
            return
        t, median, tail, margin = np.array(self._rows).T
        shares = np.array(self._shares)  # (n, nj)
        busiest = np.argsort(-np.abs(shares).max(axis=0))[: self._config.torques]
        self._timing.data = (t, median, tail)
        self._margin.data = (t, margin)
        self._torques.data = (t, *(np.ascontiguousarray(shares[:, joint]) for joint in busiest))
        self._names.content = "  \n".join(
            f'<span style="color:{COLORS[i % len(COLORS)]}">■</span> {self._model.joint_names[joint]}'
            for i, joint in enumerate(busiest)
        )


def _plot(gui: Any, title: str, labels: tuple[str, ...]) -> Any:
    lines = [{"label": label, "stroke": COLORS[i % len(COLORS)], "width": 1.5} for i, label in enumerate(labels)]
    empty = tuple(np.zeros(2) for _ in range(1 + len(labels)))
    return gui.add_uplot(
        empty,
        ({"label": "t [s]"}, *lines),
        title=title,
        scales={"x": {"time": False}},
        legend={"show": False},
        aspect=2.2,
    )
