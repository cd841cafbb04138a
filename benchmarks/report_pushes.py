"""The push maps of a report: standing and walking, of all robots in one picture."""

from __future__ import annotations

import math
from typing import cast

from matplotlib.figure import Figure
from matplotlib.projections.polar import PolarAxes

from benchmarks import push, push_map
from benchmarks.push_plot import draw_rings
from benchmarks.report_style import Reports
from bridge.plots import new_figure

PUSHES = ("push", "push_step", "push_walk")
"""Benchmarks that look for the largest push."""

DOING = dict(zip(PUSHES, ("standing, no step", "standing, steps", "walking"), strict=True))
"""What the robot does while it is pushed."""

COLUMNS = 2
"""Maps beside each other."""


def draw_push_maps(reports: Reports) -> Figure | None:
    """Largest push of 0.1 s at the pelvis that is taken, as impulse over mass, by direction, beside its bounds."""
    found = [(bench, robot) for bench in PUSHES for known, robot in reports if known == bench]
    if not found:
        return None
    rows = math.ceil(len(found) / COLUMNS)
    figure = new_figure(9.0, 5.6 * rows)
    figure.set_layout_engine("constrained", h_pad=0.15)
    for place, (bench, robot) in enumerate(found, start=1):
        report = reports[bench, robot]
        shown = (push if bench == "push" else push_map).push_map(report)
        axes = cast(PolarAxes, figure.add_subplot(rows, COLUMNS, place, projection="polar"))
        draw_rings(axes, shown)
        axes.set_title(f"{robot}, {shown.cases[0]['mass']:.1f} kg, seeds: {report.seeds}\n{shown.title}", fontsize=10)
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), fontsize=8, ncols=2)
    figure.suptitle("Largest push at the pelvis that is taken, impulse over mass [m/s], by direction", fontsize=11)
    return figure
