"""Live plots of the page: torques, timing, margin."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from bridge.view.config import ViewConfig
from bridge.view.listener import Snapshot, Words
from models.robot_model import RobotModel

COLORS = ("#3070d0", "#d05030", "#30a050", "#a040b0", "#c09020", "#606060", "#20a0a0", "#d060a0")
"""Lines of a plot, in turn."""


class LivePlots:
    """Stores the last seconds and draws them, in the gui folder of the plots."""

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
        if self._rows and snapshot.t < self._rows[-1][0]:  # the simulation was reset
            self._rows.clear()
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
