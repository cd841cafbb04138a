"""Pictures of what is survived: shares with their intervals, curves over time and size, uneven ground."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.harness import Report
from benchmarks.survival import lasting, shares
from bridge.plots import new_figure

Reports = Mapping[tuple[str, str], Report]
"""Reports by bench and robot."""

POINTS = 200
"""Of a curve."""

PUSHES = ("push", "push_step", "push_walk")
"""Benchmarks that look for the largest push."""


def robots_of(reports: Reports, *benches: str) -> list[str]:
    """Robots that these benchmarks have measured, or any where none is named."""
    return list(dict.fromkeys(robot for bench, robot in reports if not benches or bench in benches))


def colour(reports: Reports, robot: str) -> str:
    """The same for a robot in every picture."""
    return f"C{robots_of(reports).index(robot)}"


def draw_shares(reports: Reports) -> Figure | None:
    """Share of trials that were survived, with Wilson's interval."""
    found = shares(reports.values())
    if not found:
        return None
    names = list(dict.fromkeys(share.name for share in found))
    robots = robots_of(reports)
    figure = new_figure(9.0, 1.0 + 0.27 * len(names))
    axes = figure.add_subplot()
    for share in found:
        place = names.index(share.name) + 0.25 * (robots.index(share.robot) - 0.5 * (len(robots) - 1))
        given, low, high = share.survived / share.total, *share.interval
        shade = colour(reports, share.robot)
        axes.plot([low, high], [place, place], color=shade, linewidth=1.0, marker="|", markersize=5)
        axes.plot([given], [place], "o", color=shade, markersize=4)
    for robot in robots:
        axes.plot([], [], "o", color=colour(reports, robot), label=robot)
    axes.set_yticks(range(len(names)), names, fontsize=7)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_xlim(-0.02, 1.02)
    axes.set_xlabel("share survived [-], Wilson's interval of 95 %")
    axes.grid(axis="x", alpha=0.3)
    axes.legend(fontsize=8, loc="lower left")
    return figure


def draw_curves(reports: Reports) -> Figure | None:
    """Share of walks on uneven ground that go on, over time; share of directions in which a push is taken, by size."""
    walked = robots_of(reports, "terrain")
    pushed = [key for key in reports if key[0] in PUSHES]
    panels = bool(walked) + bool(pushed)
    if not panels:
        return None
    figure = new_figure(6.0 * panels, 4.0)
    left, *rest = figure.subplots(1, panels, squeeze=False)[0]
    if walked:
        for robot in walked:
            cases = reports["terrain", robot].cases
            longest = max(case["time"] for case in cases)
            ends = [case["time"] if case["fell"] else math.inf for case in cases]
            label = f"{robot}, {len(ends)} walks"
            _draw_curve(left, ends, longest, label, colour(reports, robot), "-")
        left.set_xlabel("time on uneven ground, all conditions [s]")
        left.set_ylabel("share still up [-]")
    if pushed:
        axes = rest[0] if walked else left
        largest = max(case["dv"] for key in pushed for case in reports[key].cases)
        styles = dict(zip(PUSHES, (":", "--", "-"), strict=True))
        for bench, robot in pushed:
            sizes = [case["dv"] for case in reports[bench, robot].cases]
            label = f"{robot}, {bench.replace('_', ' ')}, {len(sizes)}"
            _draw_curve(axes, sizes, 1.1 * largest, label, colour(reports, robot), styles[bench])
        axes.set_xlabel("impulse over mass at the pelvis [m/s]")
        axes.set_ylabel("share of directions and seeds that take it [-]")
    for axes in (left, *rest):
        axes.set_ylim(0.0, 1.03)
        axes.set_xlim(left=0.0)
        axes.grid(alpha=0.3)
        axes.legend(fontsize=7, loc="lower left")
    return figure


def _draw_curve(axes: Axes, ends: Sequence[float], last: float, label: str, shade: str, style: str) -> None:
    at = np.linspace(0.0, last, POINTS)
    share, low, high = np.array(lasting(ends, at.tolist())).T
    axes.step(at, share, where="post", color=shade, linestyle=style, label=label)
    axes.fill_between(at, low, high, step="post", color=shade, alpha=0.12, linewidth=0.0)


def draw_terrain(reports: Reports) -> Figure | None:
    """Share of blind walks that were survived, by ground and robot."""
    robots = robots_of(reports, "terrain")
    if not robots:
        return None
    found = {(share.name, share.robot): share for share in shares(reports["terrain", robot] for robot in robots)}
    names = list(dict.fromkeys(name for name, _ in found))
    values = np.full((len(robots), len(names)), np.nan)
    figure = new_figure(2.0 + 0.9 * len(names), 1.4 + 0.5 * len(robots))
    axes = figure.add_subplot()
    for (name, robot), share in found.items():
        row, column = robots.index(robot), names.index(name)
        values[row, column] = share.survived / share.total
        axes.text(column, row, f"{share.survived}/{share.total}", ha="center", va="center", fontsize=9)
    image = axes.imshow(values, vmin=0.0, vmax=1.0, cmap="RdYlGn", aspect="auto", alpha=0.8)
    figure.colorbar(image, ax=axes, label="share [-]")
    labels = [name.removeprefix("terrain: ").replace("_", " ") for name in names]
    axes.set_xticks(range(len(names)), labels, fontsize=8, rotation=20)
    axes.set_yticks(range(len(robots)), robots)
    return figure
