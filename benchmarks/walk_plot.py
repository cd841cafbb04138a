"""Pictures of the walking benchmark: speed, cost, top speed, and how the walks that failed did so."""

from __future__ import annotations

from pathlib import Path

from matplotlib.axes import Axes

from benchmarks.fall_plot import FAILED, PASSED, draw_failures
from benchmarks.harness import Case, Report
from benchmarks.walk_config import robot_walk, walk_config
from bridge.plots import new_figure


def plot(report: Report, folder: Path) -> list[Path]:
    """Draw what there is: walks at a constant velocity, top speeds, and the first failure of each scenario.

    Args:
        report: What ``run`` found.
        folder: Where the pictures go.

    Returns:
        The files written.
    """
    files = []
    walked = [case for case in report.cases if case["kind"] == "steady"]
    top = [case for case in report.cases if case["kind"] == "top"]
    panels = 2 * bool(walked) + bool(top)
    if panels:
        figure = new_figure(1.0 + 4.0 * panels, 4.0)
        axes = [figure.add_subplot(1, panels, i + 1) for i in range(panels)]
        if walked:
            _draw_scenarios(axes[0], walked, "speed_error", "|mean velocity - command| / |command| [-]")
            _draw_limit(axes[0], walk_config().speed_error_limit, "allowed of the mean")
            _draw_scenarios(axes[1], walked, "cost_of_transport", "cost of transport [-]")
        if top:
            axes[-1].plot([case["seed"] for case in top], [case["top_speed"] for case in top], "o", color=PASSED)
            _draw_limit(axes[-1], robot_walk(report.robot).required_top_speed, "required")
            axes[-1].set_xticks(sorted({case["seed"] for case in top}))
            axes[-1].set_xlabel("seed")
            axes[-1].set_ylabel("top speed held [m/s]")
        for one in axes:
            one.set_ylim(0.0, 1.25 * one.dataLim.y1 or 1.0)  # room for the legend above the data
            one.legend(loc="upper right", fontsize=8, ncols=3)
        figure.suptitle(f"walk, {report.who}, seeds: {report.seeds}", fontsize=10)
        files.append(folder / f"walk-{report.robot}.png")
        figure.savefig(files[-1], dpi=110)
    return files + draw_failures(report, folder)


def _draw_limit(axes: Axes, value: float, name: str) -> None:
    axes.axhline(value, color="k", linewidth=0.8, linestyle="--", label=name)


def _draw_scenarios(axes: Axes, cases: list[Case], score: str, label: str) -> None:
    """One dot a walk, by scenario."""
    names = list(dict.fromkeys(case["scenario"] for case in cases))
    for fell, colour in ((False, PASSED), (True, FAILED)):
        chosen = [case for case in cases if case["fell"] == fell]
        places = [names.index(case["scenario"]) for case in chosen]
        if chosen:
            axes.plot(places, [case[score] for case in chosen], "o", color=colour, label="fell" if fell else "walked")
    axes.set_xticks(range(len(names)), names, fontsize=8)
    axes.set_xlim(-0.5, len(names) - 0.5)
    axes.set_ylabel(label)
