"""The map of a push test: impulse against the direction of the push, beside its bounds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from matplotlib.projections.polar import PolarAxes

from benchmarks.harness import Case, Report
from benchmarks.push_directions import direction_name
from bridge.plots import new_figure

RINGS = (0.25, 0.5)
"""Between two rings of the map; the wider where there would be many [m/s]."""

MOST_RINGS = 4
"""Rings that a map is readable with."""

Line = tuple[str, str, dict[str, Any]]
"""Key of a case [m/s], label, and style of a closed line of the map."""

Circle = tuple[str, float, dict[str, Any]]
"""Label, value [m/s] and style of what holds for all directions."""


@dataclass(frozen=True, slots=True)
class PushMap:
    """What a map shows.

    Attributes:
        cases: With ``angle`` [rad], ``mass`` [kg] and the keys of the lines; the smallest of each angle counts.
        lines: What is drawn; the last of them is what was taken, and is filled.
        circles: What holds for all directions.
        title: What the robot does meanwhile.
    """

    cases: Sequence[Case]
    lines: Sequence[Line]
    circles: Sequence[Circle]
    title: str


def draw_rings(axes: PolarAxes, shown: PushMap) -> None:
    """Draw impulse over mass [m/s] by direction, forward up; the rings say the impulse [N.s] too."""
    angles = sorted({case["angle"] for case in shown.cases})
    axes.set_theta_zero_location("N")  # forward is up
    for key, label, style in shown.lines:
        values = [min(case[key] for case in shown.cases if case["angle"] == angle) for angle in angles]
        ring = [*angles, angles[0]], [*values, values[0]]
        axes.plot(*ring, label=label, **style)
    axes.fill(*ring, color=style["color"], alpha=0.15)
    around = [2.0 * math.pi * k / 180 for k in range(181)]
    for label, value, style in shown.circles:
        axes.plot(around, [value] * len(around), linewidth=1.2, label=f"{label}: {value:g} m/s", **style)
    reach = 1.05 * max(axes.dataLim.y1, *(value for _, value, _ in shown.circles), RINGS[-1])
    step = next((ring for ring in RINGS if reach / ring <= MOST_RINGS), RINGS[-1])
    mass = shown.cases[0]["mass"]
    ticks = [step * (k + 1) for k in range(int(0.97 * reach / step))]  # none on the rim
    axes.set_ylim(0.0, reach)
    axes.set_yticks(ticks, [f"{tick:.2g} m/s\n{tick * mass:.0f} N.s" for tick in ticks], fontsize=7)
    for text in axes.get_yticklabels():
        text.set_bbox({"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 0.5})
    axes.set_rlabel_position(180.0 / len(angles))  # between two directions
    axes.set_xticks(angles, [direction_name(angle) for angle in angles], fontsize=9)


def draw_map(report: Report, shown: PushMap, remarks: Sequence[str], file: Path) -> Path:
    """Draw a map with remarks.

    Args:
        report: Whose map it is.
        shown: What is drawn.
        remarks: Lines below the map, in columns.
        file: Where it goes.

    Returns:
        The file.
    """
    figure = new_figure(9.5, 7.0 + 0.14 * len(remarks))
    grid = figure.add_gridspec(2, 2, height_ratios=[7.0, 0.14 * len(remarks)], width_ratios=[7.0, 2.5])
    axes = cast(PolarAxes, figure.add_subplot(grid[0, 0], projection="polar"))
    draw_rings(axes, shown)
    axes.tick_params(axis="x", pad=12)
    figure.suptitle(
        f"{report.who}, {shown.title}, seeds: {report.seeds}. "
        f"Impulse of a push at the pelvis over mass ({shown.cases[0]['mass']:.1f} kg), by direction",
        fontsize=10,
    )
    figure.legend(*axes.get_legend_handles_labels(), loc="upper right", bbox_to_anchor=(0.995, 0.94), fontsize=8)
    below = figure.add_subplot(grid[1, :])
    below.axis("off")
    below.text(0.0, 1.0, "\n".join(remarks), family="monospace", fontsize=7, va="top", transform=below.transAxes)
    figure.savefig(file, dpi=110)
    return file
