"""Pictures of the walking benchmark: speed, cost, top speed, and how the fastest failed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import Case, Report
from benchmarks.walk_config import robot_walk, walk_config
from bridge.plots import new_figure

_WALKED, _FELL = "#1b6ca8", "#c0392b"


def plot(report: Report, folder: Path) -> list[Path]:
    """Draw what there is: walks at a constant velocity, top speeds, and one fall.

    Args:
        report: What ``run`` found.
        folder: Where the pictures go.

    Returns:
        The files written.
    """
    files = []
    walked = [case for case in report.cases if case["kind"] == "steady"]
    top = [case for case in report.cases if case["kind"] == "top"]
    if walked or top:
        figure = new_figure(11.0, 3.5)
        _draw_scenarios(figure.add_subplot(1, 3, 1), walked, "speed_error", "mean velocity off the command [-]")
        _draw_scenarios(figure.add_subplot(1, 3, 2), walked, "cost_of_transport", "cost of transport [-]")
        figure.axes[0].axhline(walk_config().speed_error_limit, color="k", linewidth=0.8, linestyle="--")
        axes = figure.add_subplot(1, 3, 3)
        axes.plot([case["seed"] for case in top], [case["top_speed"] for case in top], "o", color=_WALKED)
        axes.axhline(robot_walk(report.robot).required_top_speed, color="k", linewidth=0.8, linestyle="--")
        axes.set_xlabel("seed")
        axes.set_ylabel("top speed held [m/s]")
        axes.set_ylim(bottom=0.0)
        files.append(folder / f"walk-{report.robot}.png")
        figure.savefig(files[-1], dpi=110)
    fallen = limiting(report.cases)
    if fallen is not None:
        files.append(folder / f"walk-{report.robot}-fall.png")
        _draw_fall(fallen, files[-1])
    return files


def limiting(cases: list[Case]) -> Case | None:
    """The fall to show: one of a scenario that must not fall before one of a top speed; None when nobody fell."""
    traced = [case for case in cases if case.get("trace")]
    return min(traced, key=lambda case: case["kind"] == "top", default=None)


def _draw_scenarios(axes: Any, cases: list[Case], score: str, label: str) -> None:
    """One dot a walk, by scenario."""
    names = list(dict.fromkeys(case["scenario"] for case in cases))
    for fell, colour in ((False, _WALKED), (True, _FELL)):
        chosen = [case for case in cases if case["fell"] == fell]
        places = [names.index(case["scenario"]) for case in chosen]
        axes.plot(places, [case[score] for case in chosen], "o", color=colour, label="fell" if fell else "walked")
    axes.set_xticks(range(len(names)), names, fontsize=8)
    axes.set_ylabel(label)
    axes.set_ylim(bottom=0.0)
    axes.legend(fontsize=8)


def _draw_fall(case: Case, file: Path) -> None:
    """Signals of the last seconds before a fall."""
    trace = {name: np.array(values) for name, values in case["trace"].items()}
    t = trace["t"]
    figure = new_figure(9.0, 8.0)
    panels = (
        ("ahead of the base [m]", {"DCM": trace["dcm_ahead"], "CMP commanded": trace["cmp_ahead"]}),
        ("left of the base [m]", {"DCM": trace["dcm_left"], "CMP commanded": trace["cmp_left"]}),
        ("force / weight [-]", {"left foot": trace["load_left"], "right foot": trace["load_right"]}),
        ("[rad], [-]", {"yaw": trace["yaw"], "torque of the joint nearest its limit": trace["torque_share"]}),
    )
    for i, (label, lines) in enumerate(panels):
        axes = figure.add_subplot(4, 1, i + 1)
        for name, values in lines.items():
            axes.plot(t, values, label=name, linewidth=1.0)
        axes.set_ylabel(label, fontsize=8)
        axes.legend(fontsize=7, loc="upper left")
    figure.axes[0].set_title(f"{case['scenario']}, seed {case['seed']}: {case['reason']}", fontsize=9)
    figure.axes[-1].set_xlabel("t [s]")
    figure.savefig(file, dpi=110)
