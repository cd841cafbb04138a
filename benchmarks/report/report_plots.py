"""Plots of speeds, costs, errors, delays and times, with all robots in one plot."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator, StrMethodFormatter
from PIL import Image

from benchmarks.core.benchmark import catalogue
from benchmarks.core.harness import Case, Report
from benchmarks.core.timed_run import QUANTILES, percentiles_of
from benchmarks.faults.faults import config as fault_config
from benchmarks.speed.loop import draw_stages
from benchmarks.stability.estimate import WALK, drift
from benchmarks.stability.walk_cases import walk_config
from bridge.analysis.plots import new_figure
from models.types import Vector

Reports = Mapping[tuple[str, str], Report]  # reports by bench and robot

LOOKS = (("#0072b2", "o"), ("#d55e00", "s"), ("#009e73", "^"), ("#cc79a7", "D"), ("#56b4e9", "v"))
"""Colour and marker of each robot, from the palette of Okabe and Ito for colour-blind readers."""

MAP = "cividis"  # colour map that is monotonic in lightness
BOUND: dict[str, Any] = {"color": "k", "linewidth": 1.0, "linestyle": "--"}  # line style of a bound
DPI = 110  # resolution of a plot: 9 inches fill the width of a documentation page
PALETTE = 255  # colours in a file: no visible difference for lines and text, a third of the size


def robots_of(reports: Reports, *benches: str) -> list[str]:
    """Return the robots measured by these benchmarks, or by any if none is given."""
    return list(dict.fromkeys(robot for bench, robot in reports if not benches or bench in benches))


def look(reports: Reports, robot: str) -> tuple[str, str]:
    """Return colour and marker of a robot, the same in every plot."""
    return LOOKS[robots_of(reports).index(robot) % len(LOOKS)]


def colour(reports: Reports, robot: str) -> str:
    """Return the colour of ``look``."""
    return look(reports, robot)[0]


def draw_dots(axes: Axes, reports: Reports, values: Mapping[str, Mapping[str, Sequence[float]]], label: str) -> None:
    """Draw one marker per case, by robot and scenario; ``label`` includes the unit."""
    names = list(dict.fromkeys(name for of in values.values() for name in of))
    for k, (robot, of) in enumerate(values.items()):
        offset = 0.16 * (k - 0.5 * (len(values) - 1))
        places = [names.index(name) + offset for name, dots in of.items() for _ in dots]
        dots = [dot for dots in of.values() for dot in dots]
        shade, mark = look(reports, robot)
        axes.plot(places, dots, mark, color=shade, markersize=5, alpha=0.7, label=robot)
    axes.set_xticks(range(len(names)), [name.replace("_", " ") for name in names], fontsize=9)
    axes.set_xlim(-0.5, len(names) - 0.5)
    axes.set_ylabel(label)
    axes.grid(axis="y", alpha=0.3)


def save(figure: Figure, file: Path) -> Path:
    """Write a plot with a reduced palette; returns the file."""
    figure.set_dpi(DPI)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    picture.quantize(PALETTE, dither=Image.Dither.NONE).save(file, optimize=True)
    return file


#: Components of a velocity in the robot's frame, and their units
AXES_OF_WALKING = (("forward", "m/s"), ("left", "m/s"), ("turn to the left", "rad/s"))
MILLI, PERCENT = 1e3, 1e2


def _by_scenario(
    of: Mapping[str, list[Case]], names: Iterable[str], value: Callable[[Case], float], key: str = "scenario"
) -> dict[str, dict[str, list[float]]]:
    return {
        robot: {name: [value(case) for case in cases if case[key] == name] for name in names}
        for robot, cases in of.items()
    }


def _walks(reports: Reports) -> dict[str, list[Case]]:
    """Return the walks at constant velocity by robot; empty if there are none."""
    found = {robot: reports["walk", robot].cases for robot in robots_of(reports, "walk")}
    steady = {robot: [case for case in cases if case["kind"] == "steady"] for robot, cases in found.items()}
    return steady if any(steady.values()) else {}


def draw_speeds(reports: Reports) -> Figure | None:
    """Mean velocity against the commanded one, a mark for every walk at one velocity; a cross is one that fell.

    Grey is what the mean over the seeds may be off.
    """
    walks = _walks(reports)
    if not walks:
        return None
    figure, off = new_figure(9.0, 3.6), walk_config().speed_error_limit
    for part, (axes, (name, unit)) in enumerate(zip(figure.subplots(1, 3), AXES_OF_WALKING, strict=True)):
        for robot, cases in walks.items():
            shade, mark = look(reports, robot)
            points = [(case["command"][part], case["velocity"][part], case["fell"]) for case in cases]
            for fell, marker in ((False, mark), (True, "x")):
                chosen = [point for point in points if point[2] == fell]
                shown = [[x for x, _, _ in chosen], [y for _, y, _ in chosen]]
                label = f"{robot}, fell" if fell else robot
                axes.plot(*shown, marker, color=shade, markersize=5, alpha=0.8, label=label if chosen else None)
        low, high = axes.dataLim.intervalx
        ends = np.array([low - 0.1, high + 0.1])
        axes.plot(ends, ends, color="0.5", linewidth=0.8, zorder=0, label="as commanded")
        axes.fill_between(ends, (1.0 - off) * ends, (1.0 + off) * ends, color="0.9", zorder=-1, linewidth=0.0)
        axes.set(xlabel=f"commanded {name}\n[{unit}]", ylabel=f"walked, mean [{unit}]")
        axes.grid(alpha=0.3)
    figure.axes[0].legend(fontsize=8)
    figure.suptitle(f"Walks of {walk_config().duration:.0f} s at a commanded velocity: {', '.join(walks)}", fontsize=11)
    return figure


def draw_cost(reports: Reports) -> Figure | None:
    """Cost of transport of every walk at one velocity that moves the robot: work of the joints over weight and way."""
    walks = _walks(reports)
    names = list(dict.fromkeys(case["scenario"] for cases in walks.values() for case in cases))
    costed = {
        robot: [case for case in cases if np.isfinite(np.asarray(case["cost_of_transport"], dtype=float))]
        for robot, cases in walks.items()
    }
    costs = _by_scenario(costed, names, lambda case: case["cost_of_transport"])
    figure = _dots(
        reports, costs, "cost of transport [-]", f"Cost of transport, by commanded velocity: {', '.join(walks)}"
    )
    if figure is not None:
        labels = [_commands(name, walks) for name in names]
        figure.axes[0].set_xticks(range(len(names)), labels, fontsize=9)
    return figure


def _commands(name: str, walks: dict[str, list[Case]]) -> str:
    lines = [name]
    for robot, cases in walks.items():
        command = next((case["command"] for case in cases if case["scenario"] == name), (0.0, 0.0, 0.0))
        part = int(np.argmax(np.abs(command)))
        if command[part]:
            lines.append(f"{robot} {abs(command[part]):g} {AXES_OF_WALKING[part][1]}")
    return "\n".join(lines)


def draw_estimator(reports: Reports) -> Figure | None:
    """Errors of the estimator against the truth, a mark a run, with the bound of what has one.

    Drift is the growth of the position's error over the way walked.
    """
    robots = robots_of(reports, "estimate")
    if not robots:
        return None
    limits, figure = catalogue()["estimate"].info.most, new_figure(9.0, 6.0)
    parts = (
        ("velocity_rmse", "velocity, RMS [mm/s]", MILLI, limits["velocity_rmse"], limits["velocity_rmse_walk"]),
        ("tilt_rmse_deg", "roll and pitch, RMS [deg]", 1.0, limits["tilt_rmse_deg"], None),
        ("height_rmse", "height, RMS [mm]", MILLI, limits["height_rmse"], None),
    )
    *panels, last = figure.subplots(2, 2).ravel()
    of = {robot: reports["estimate", robot].cases for robot in robots}
    names = list(dict.fromkeys(case["scenario"] for cases in of.values() for case in cases))
    for axes, (key, label, unit, bound, walking) in zip(panels, parts, strict=True):
        values = _by_scenario(of, names, lambda case: unit * case[key])  # noqa: B023  # called at once
        draw_dots(axes, reports, values, label)
        for place, name in enumerate(names):
            _draw_bound(axes, place, walking if name == WALK else bound, unit)
    drifts = _by_scenario(of, [WALK], lambda case: PERCENT * drift(case))
    draw_dots(last, reports, drifts, "drift of the position [% of the way]")
    _draw_bound(last, 0, limits["drift"], PERCENT)
    for axes in (*panels, last):
        axes.plot([], [], label="bound", **BOUND)
        axes.set_ylim(0.0, 1.08 * axes.dataLim.y1)
    panels[0].legend(fontsize=8, loc="upper left")
    figure.suptitle(f"Error of the state estimate, by task of the robot: {', '.join(robots)}", fontsize=11)
    return figure


def _draw_bound(axes: Axes, place: int, bound: float | None, unit: float) -> None:
    if bound is not None:
        axes.plot([place - 0.35, place + 0.35], [unit * bound] * 2, **BOUND)


def draw_delays(reports: Reports) -> Figure | None:
    """Delay of all joint states that the robot rides through, found by bisection, with the bound."""
    margins = fault_config().margins
    of = {robot: reports["faults", robot].cases for robot in robots_of(reports, "faults")}
    found = _by_scenario(of, margins, lambda case: MILLI * case["margin"], "row")
    figure = _dots(reports, found, "delay [ms]", f"Delay margin, all joint states late for good: {', '.join(found)}")
    if figure is not None:
        axes = figure.axes[0]
        for place, margin in enumerate(margins.values()):
            _draw_bound(axes, place, margin.required, MILLI)
        axes.plot([], [], label="required", **BOUND)
        axes.set_xticks(range(len(margins)), ["walking" if margin.walk else "standing" for margin in margins.values()])
        axes.legend(fontsize=8)
    return figure


def _dots(reports: Reports, values: dict[str, dict[str, list[float]]], label: str, title: str) -> Figure | None:
    if not any(any(of.values()) for of in values.values()):
        return None
    figure = new_figure(7.0, 3.8)
    axes = figure.add_subplot()
    draw_dots(axes, reports, values, label)
    axes.set_ylim(0.0, 1.15 * axes.dataLim.y1)
    axes.set_title(title, fontsize=11)
    axes.legend(fontsize=8)
    return figure


#: Curves of a whole-body tick: key of the quantiles, name of the figures, line style, label
SUBJECTS = (
    ("tick", "tick_us_{}", "-", ""),
    ("pinocchio_calls", "pinocchio_calls_us_{}", ":", ", bare Pinocchio calls"),
)
#: Benchmark, title and curves of the panels from quantiles
TIMED = (
    ("tick", "whole-body tick, standing, waving, pushed", SUBJECTS),
    ("gait", "whole-body tick, single support, walking", SUBJECTS),
    ("loop", "tick of the whole closed loop, walking", (("tick_walk", "tick_walk_us_{}", "-", ""),)),
)
#: Curves of the latency over ROS 2: key of the spreads, name of the figures, line style, label
WAYS = (("latency", "{}_us", "-", ""), ("floor", "floor_{}_us", ":", ", ping-pong floor"))
USUAL = "idle"  # latency scenario that is drawn, because it has bounds
BINS = 60  # number of bins of a histogram, equal on a logarithmic axis
SHOWN = 99.9  # percentile at the end of a histogram; the legend has the largest sample [%]

#: Labels of a logarithmic axis [us]
MARKS = (20, 30, 50, 70, 100, 150, 200, 300, 500, 700, 1000, 1500, 2000, 3000, 5000, 10000)
Part = tuple[Vector, str, str, str]  # value at each of ``QUANTILES`` (k,) [us], colour, style, label


def draw_times(reports: Reports) -> Figure | None:
    """Histograms of the whole-body tick and of the way from the sensors to the command, beside what cannot be beaten.

    An axis ends at the 99.9th percentile; median and 99th percentile as in the figures, and the largest sample of all,
    stand in the legend.
    """
    panels: list[tuple[str, Callable[[], list[Part]]]] = [
        (title, partial(_ticks, reports, bench, subjects))
        for bench, title, subjects in TIMED
        if robots_of(reports, bench)
    ]
    if any(_idle(reports, robot) for robot in robots_of(reports, "latency")):
        panels.append(("sensors to command over ROS 2, standing", lambda: _latencies(reports)))
    if not panels:
        return None
    figure = new_figure(9.0, 2.9 * len(panels))
    for axes, (title, parts) in zip(figure.subplots(len(panels), 1, squeeze=False)[:, 0], panels, strict=True):
        _draw(axes, parts())
        axes.set_title(title, fontsize=10)
    return figure


def draw_loop(reports: Reports) -> Figure | None:
    """Where a tick of the whole closed loop goes, standing and walking; dashed: MuJoCo's step alone."""
    robots = robots_of(reports, "loop")
    if not robots:
        return None
    figure = new_figure(5.0 + 2.0 * len(robots), 4.0)
    draw_stages(figure.add_subplot(), [reports["loop", robot] for robot in robots])
    return figure


def _ticks(reports: Reports, bench: str, subjects: Sequence[tuple[str, str, str, str]]) -> list[Part]:
    """Return the quantiles of each subject, as median over the seeds."""
    return [
        (
            np.median([case["quantiles"][subject] for case in reports[bench, robot].cases], axis=0),
            colour(reports, robot),
            style,
            _label(reports[bench, robot], f"{robot}{label}", name),
        )
        for robot in robots_of(reports, bench)
        for subject, name, style, label in subjects
        if all(subject in case["quantiles"] for case in reports[bench, robot].cases)
    ]


def _idle(reports: Reports, robot: str) -> list[Case]:
    return [case for case in reports["latency", robot].cases if case["scenario"] == USUAL and "spreads" in case]


def _latencies(reports: Reports) -> list[Part]:
    return [
        (
            percentiles_of([case["spreads"][key] for case in cases]),
            colour(reports, robot),
            style,
            _label(reports["latency", robot], f"{robot}{label}", name),
        )
        for robot in robots_of(reports, "latency")
        if (cases := _idle(reports, robot))
        for key, name, style, label in WAYS
    ]


def _label(report: Report, label: str, name: str) -> str:
    p50, p99 = (report.figures.get(name.format(part), math.nan) for part in ("p50", "p99"))
    return f"{label}: p50 {p50:.0f}, p99 {p99:.0f}"


def _draw(axes: Axes, parts: list[Part]) -> None:
    """Draw histograms with common bins from quantiles, with linear interpolation between quantiles."""
    shares = np.array(QUANTILES)
    low = min(values[0] for values, *_ in parts)
    high = max(values[shares == SHOWN][0] for values, *_ in parts)
    edges = np.geomspace(max(low, 1.0), max(high, 1.001 * max(low, 1.0)), BINS + 1)  # 1: no time is below a microsecond
    for values, shade, style, label in parts:
        held = 100.0 * np.diff(np.interp(edges, values, shares / 100.0))
        axes.stairs(
            held, edges, color=shade, linestyle=style, label=f"{label}, largest {values[-1]:.0f} us", linewidth=1.3
        )
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(FixedLocator([mark for mark in MARKS if edges[0] <= mark <= edges[-1]]))
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:.0f}"))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xlim(edges[0], edges[-1])
    axes.set(xlabel="time [us]", ylabel="samples per bin [%]")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
