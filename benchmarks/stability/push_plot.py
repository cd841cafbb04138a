"""Modes and directions of a push, and the map of impulse by direction beside its bounds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, cast

from matplotlib.projections.polar import PolarAxes

from benchmarks.core.benchmark import saved
from benchmarks.core.harness import Case, Report, chosen
from bridge.plots import new_figure


class PushMode(StrEnum):
    """What a robot that is pushed does meanwhile."""

    STAND = "stand"  # keeps its feet where they are
    CATCH = "catch"  # stands in mode 'stand' and may step
    STEP = "step"  # stands in mode 'walk' and may step
    WALK = "walk"


_NAMES = ("forward", "forward-left", "left", "back-left", "backward", "back-right", "right", "forward-right")


def direction_name(angle: float) -> str:
    """What a heading relative to the robot's [rad] is called: a word where there is one, degrees otherwise."""
    eighth = angle / (0.25 * math.pi)
    if abs(eighth - round(eighth)) < 1e-6:  # 1e-6: rounding
        return _NAMES[round(eighth) % len(_NAMES)]
    return f"{math.degrees(angle):.0f} deg"


def angles(bench: str, count: int, names: Sequence[str] = ()) -> list[float]:
    """Evenly spread headings [rad], the first forward, or those chosen; ``ConfigError`` lists the known names."""
    known = {direction_name(angle): angle for angle in (2.0 * math.pi * k / count for k in range(count))}
    selected = chosen(bench, names, list(known))
    return [angle for name, angle in known.items() if name in selected]


RINGS = (0.25, 0.5)  # between two rings of the map; the wider where there would be many [m/s]
MOST_RINGS = 4  # rings that a map is readable with
Line = tuple[str, str, dict[str, Any]]  # key of a case [m/s], label, and style of a closed line of the map
Circle = tuple[str, float, dict[str, Any]]  # label, value [m/s] and style of what holds for all directions


@dataclass(frozen=True, slots=True)
class PushMap:
    """What a map shows."""

    #: With ``angle`` [rad], ``mass`` [kg] and the keys of the lines; the smallest of each angle counts
    cases: Sequence[Case]
    lines: Sequence[Line]  #: The last is the push taken, and is filled
    circles: Sequence[Circle]  #: Values for all directions
    title: str  #: What the robot does meanwhile


def draw_rings(axes: PolarAxes, shown: PushMap) -> None:
    """Draw impulse over mass [m/s] by direction, forward up; the rings show the impulse [N.s] too."""
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
    """Draw a map with lines of remarks below, and return its file."""
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
    return saved(figure, file)
