"""The map of a push test: impulse against the direction of the push, beside its bounds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

from matplotlib.projections.polar import PolarAxes

from benchmarks.harness import Report
from benchmarks.push_directions import direction_name
from bridge.plots import new_figure

RING = 0.5
"""Between two rings of the map [m/s]."""

Line = tuple[str, str, dict[str, Any]]
"""Key of a case [m/s], label, and style of a closed line of the map."""


def draw_map(
    report: Report, lines: Sequence[Line], circles: Sequence[tuple[str, float, str]], remarks: Sequence[str], file: Path
) -> Path:
    """Draw impulse over mass [m/s] in a polar plot, forward up; the rings say the impulse [N.s] too.

    Args:
        report: Of cases with ``angle`` [rad], ``mass`` [kg] and the keys of the lines; the smallest of each angle
            counts.
        lines: What is drawn; the last of them is what was taken, and is filled.
        circles: Label, value [m/s] and colour of what holds for all directions.
        remarks: Lines below the map, in columns.
        file: Where it goes.

    Returns:
        The file.
    """
    angles = sorted({case["angle"] for case in report.cases})
    figure = new_figure(9.5, 7.0 + 0.14 * len(remarks))
    grid = figure.add_gridspec(2, 2, height_ratios=[7.0, 0.14 * len(remarks)], width_ratios=[7.0, 2.5])
    polar = figure.add_subplot(grid[0, 0], projection="polar", theta_offset=0.5 * math.pi)  # forward is up
    axes = cast(PolarAxes, polar)
    for key, label, style in lines:
        values = [min(case[key] for case in report.cases if case["angle"] == angle) for angle in angles]
        ring = [*angles, angles[0]], [*values, values[0]]
        axes.plot(*ring, label=label, **style)
    axes.fill(*ring, color=style["color"], alpha=0.15)
    around = [2.0 * math.pi * k / 180 for k in range(181)]
    for label, value, colour in circles:
        axes.plot(around, [value] * len(around), color=colour, linewidth=1.2, label=f"{label}: {value:g} m/s")
    reach = 1.05 * max(axes.dataLim.y1, *(value for _, value, _ in circles), RING)
    mass = report.cases[0]["mass"]
    ticks = [RING * (k + 1) for k in range(int(reach / RING))]
    axes.set_ylim(0.0, reach)
    axes.set_yticks(ticks, [f"{tick:.1f} m/s\n{tick * mass:.0f} N.s" for tick in ticks], fontsize=7)
    for text in axes.get_yticklabels():
        text.set_bbox({"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 0.5})
    axes.set_rlabel_position(22.5)  # between two directions
    axes.set_xticks(angles, [direction_name(angle) for angle in angles], fontsize=9)
    axes.tick_params(axis="x", pad=12)
    figure.suptitle(
        f"{report.who}, {report.bench.replace('_', ', ')}, seeds: {report.seeds}. "
        f"Impulse of a push at the pelvis over mass ({mass:.1f} kg), by direction",
        fontsize=10,
    )
    figure.legend(*axes.get_legend_handles_labels(), loc="upper right", bbox_to_anchor=(0.995, 0.94), fontsize=8)
    below = figure.add_subplot(grid[1, :])
    below.axis("off")
    below.text(0.0, 1.0, "\n".join(remarks), family="monospace", fontsize=7, va="top", transform=below.transAxes)
    figure.savefig(file, dpi=110)
    return file
