"""Pictures of what is survived: shares with their intervals, curves over time and size, uneven ground."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.report_pushes import DOING, PUSHES
from benchmarks.report_style import MAP, Reports, colour, look, robots_of
from benchmarks.survival import lasting, shares
from benchmarks.terrain import TerrainConfig
from bridge.plots import new_figure
from models.config import default_config

POINTS = 200
"""Of a curve."""

BARS = 8
"""Intervals drawn on a curve."""


def draw_shares(reports: Reports) -> Figure | None:
    """Share of the trials that went as the benchmark asks, with Wilson's interval of 95 %."""
    found = shares(reports.values())
    if not found:
        return None
    names = list(dict.fromkeys(share.name for share in found))
    robots = robots_of(reports)
    figure = new_figure(9.0, 1.2 + 0.27 * len(names))
    axes = figure.add_subplot()
    for share in found:
        place = names.index(share.name) + 0.25 * (robots.index(share.robot) - 0.5 * (len(robots) - 1))
        given, low, high = share.survived / share.total, *share.interval
        shade, mark = look(reports, share.robot)
        axes.plot([low, high], [place, place], color=shade, linewidth=1.2, marker="|", markersize=5)
        axes.plot([given], [place], mark, color=shade, markersize=5)
    for robot in robots:
        shade, mark = look(reports, robot)
        axes.plot([], [], mark, color=shade, label=robot)
    totals = {name: sorted({share.total for share in found if share.name == name}) for name in names}
    labels = [f"{name.replace('_', ' ')} ({', '.join(map(str, totals[name]))})" for name in names]
    axes.set_yticks(range(len(names)), labels, fontsize=8)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_xlim(-0.02, 1.03)
    axes.set_xlabel("share survived [-]")
    axes.grid(axis="x", alpha=0.3)
    axes.legend(fontsize=8, loc="lower left")
    axes.set_title("Survived, with Wilson's interval of 95 %; in parentheses the trials of a robot", fontsize=10)
    return figure


def draw_curves(reports: Reports) -> Figure | None:
    """Share of blind walks that go on, over time; share of directions and seeds in which a push is taken, by its size.

    Bars are Wilson's intervals of 95 %, as if directions and conditions were drawn at random.
    """
    walked = robots_of(reports, "terrain")
    pushed = [key for bench in PUSHES for key in reports if key[0] == bench]
    panels = bool(walked) + bool(pushed)
    if not panels:
        return None
    figure = new_figure(4.5 * panels, 4.2)
    left, *rest = figure.subplots(1, panels, squeeze=False)[0]
    if walked:
        longest = max(case["time"] for robot in walked for case in reports["terrain", robot].cases)
        for place, robot in enumerate(walked):
            cases = reports["terrain", robot].cases
            ends = [case["time"] if case["fell"] else math.inf for case in cases]
            label = f"{robot}, {len(ends)} walks"
            _draw_curve(left, ends, (longest, place / len(walked)), label, colour(reports, robot), "-")
        left.set_xlabel("time on uneven ground [s]")
        left.set_ylabel("share still up [-]")
        left.set_title("blind walks, all conditions", fontsize=10)
    if pushed:
        axes = rest[0] if walked else left
        largest = 1.1 * max(case["dv"] for key in pushed for case in reports[key].cases)
        styles = dict(zip(PUSHES, ("-", "--", ":"), strict=True))
        for place, (bench, robot) in enumerate(pushed):
            sizes = [case["dv"] for case in reports[bench, robot].cases]
            label = f"{robot}, {DOING[bench]}, {len(sizes)}"
            reach = (largest, place / len(pushed))
            _draw_curve(axes, sizes, reach, label, colour(reports, robot), styles[bench])
        axes.set_xlabel("impulse over mass at the pelvis [m/s]")
        axes.set_ylabel("share that take it [-]")
        axes.set_title("pushes, by directions and seeds (how many)", fontsize=10)
    for axes in (left, *rest):
        axes.set_ylim(0.0, 1.03)
        axes.set_xlim(left=0.0)
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8, loc="lower left" if walked and axes is left else "upper right")
    return figure


def _draw_curve(
    axes: Axes, ends: Sequence[float], reach: tuple[float, float], label: str, shade: str, style: str
) -> None:
    """A curve up to ``reach[0]``, and its intervals at places that are ``reach[1]`` of their distance late [-]."""
    last, late = reach
    at = np.linspace(0.0, last, POINTS)
    axes.step(at, np.array(lasting(ends, at.tolist()))[:, 0], where="post", color=shade, linestyle=style, label=label)
    barred = (np.arange(BARS) + 0.25 + 0.5 * late) * last / BARS
    for x, (share, low, high) in zip(barred, lasting(ends, barred.tolist()), strict=True):
        axes.errorbar(x, share, [[share - low], [high - share]], color=shade, capsize=2, linewidth=0.8)


def draw_terrain(reports: Reports) -> Figure | None:
    """Blind walks that were survived, by ground and robot, of how many, and Wilson's interval of their share."""
    robots = robots_of(reports, "terrain")
    if not robots:
        return None
    found = {(share.name, share.robot): share for share in shares(reports["terrain", robot] for robot in robots)}
    names = list(dict.fromkeys(name for name, _ in found))
    values = np.full((len(robots), len(names)), np.nan)
    figure = new_figure(9.0, 1.6 + 0.6 * len(robots))
    axes = figure.add_subplot()
    for (name, robot), share in found.items():
        row, column = robots.index(robot), names.index(name)
        values[row, column] = share.survived / share.total
        text = f"{share.survived}/{share.total}\n{share.interval[0]:.2f} to {share.interval[1]:.2f}"
        shade = "black" if values[row, column] > 0.5 else "white"
        axes.text(column, row, text, ha="center", va="center", fontsize=8, color=shade)
    image = axes.imshow(values, vmin=0.0, vmax=1.0, cmap=MAP, aspect="auto")
    figure.colorbar(image, ax=axes, label="share [-]")
    given = default_config(TerrainConfig, "benchmarks", "terrain")
    labels = [_ground(name.removeprefix("terrain: "), given) for name in names]
    axes.set_xticks(range(len(names)), labels, fontsize=9)
    axes.set_yticks(range(len(robots)), robots)
    walk = f"{given.duration:.0f} s at {given.speed:g} m/s"
    axes.set_title(f"Blind walks of {walk} that were survived, {', '.join(robots)}", fontsize=11)
    return figure


def _ground(name: str, given: TerrainConfig) -> str:
    """A condition, and what differs in it."""
    condition = (given.conditions | given.goals).get(name)
    words = [name.replace("_", " ")]
    if condition is not None:
        words += [f"{condition.friction:g}"] if condition.friction is not None else []
        words += [f"{100.0 * condition.payload:g} %"] if condition.payload else []
        words += [f"+{1e3 * condition.delay:g} ms"] if condition.delay else []
    return "\n".join(words)
