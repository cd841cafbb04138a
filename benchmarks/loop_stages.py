"""Where the time of a closed loop goes: names of its figures, and their picture."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib import colormaps
from matplotlib.axes import Axes

from benchmarks.harness import Report
from benchmarks.loop_timing import STAGES

SCENARIOS = ("stand", "walk")
"""What the robot does, in this order."""


def stage_figure(stage: str, scenario: str) -> str:
    """Name of the figure of a stage: mean over the ticks [us]."""
    return f"{stage}_{scenario}_us_mean"


def draw_stages(axes: Axes, reports: Sequence[Report]) -> None:
    """Draw the stages of a tick on top of each other, a bar a robot and scenario, with the physics alone as a line."""
    bars = [(report, scenario) for report in reports for scenario in SCENARIOS]
    places = range(len(bars))
    bottoms = [0.0] * len(bars)
    for stage, colour in zip(STAGES, colormaps["tab10"].colors, strict=False):  # type: ignore[attr-defined]
        heights = [report.figures[stage_figure(stage, scenario)] for report, scenario in bars]
        axes.bar(places, heights, bottom=bottoms, color=colour, label=stage.replace("_", " "))
        bottoms = [bottom + height for bottom, height in zip(bottoms, heights, strict=True)]
    for place, (report, scenario) in zip(places, bars, strict=True):
        bare = report.figures[f"bare_physics_{scenario}_us"]
        axes.plot([place - 0.4, place + 0.4], [bare, bare], "k--", linewidth=0.8)
    axes.set_xticks(places, [f"{report.robot}\n{scenario}" for report, scenario in bars], fontsize=8)
    axes.set_ylabel("mean of a tick [us]; dashed: MuJoCo alone")
    axes.legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.0), reverse=True)  # from top to bottom, as drawn
