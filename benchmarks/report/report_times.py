"""Histograms of the report: the whole-body tick and the way over ROS 2, each beside its floor."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator, StrMethodFormatter

from benchmarks.core.harness import Case, Report
from benchmarks.core.timed_run import QUANTILES, percentiles_of, spread_of
from benchmarks.report.report_style import Reports, colour, robots_of
from benchmarks.speed.loop_timing import draw_stages
from bridge.plots import new_figure
from models.types import Vector

#: Among the quantiles of a whole-body tick: key, figures, style, label
SUBJECTS = (
    ("tick", "tick_us_{}", "-", ""),
    ("pinocchio_calls", "pinocchio_calls_us_{}", ":", ", bare Pinocchio calls"),
)
#: Bench, what its tick is, and what is drawn of it, for what is kept by quantiles
TIMED = (
    ("tick", "whole-body tick, standing, waving, pushed", SUBJECTS),
    ("gait", "whole-body tick, single support, walking", SUBJECTS),
    ("loop", "tick of the whole closed loop, walking", (("tick_walk", "tick_walk_us_{}", "-", ""),)),
)
#: Of the way over ROS 2: key, figures, style, label
WAYS = (("latency", "{}_us", "-", ""), ("floor", "floor_{}_us", ":", ", ping-pong floor"))
USUAL = "idle"  # scenario of the latency that is drawn: the one that is held to bounds
BINS = 60  # of a histogram, evenly spread on a logarithmic axis
SHOWN = 99.9  # percentile where a histogram ends; the largest sample stands in the legend [%]

#: Where a logarithmic axis is labelled [us]
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
    """Medians over the seeds of what each subject took."""
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
    cases = [case for case in reports["latency", robot].cases if case.get("scenario", USUAL) == USUAL]
    return [case for case in cases if spread_of(case, "latency") is not None]


def _latencies(reports: Reports) -> list[Part]:
    return [
        (
            percentiles_of([held for case in cases if (held := spread_of(case, key)) is not None]),
            colour(reports, robot),
            style,
            _label(reports["latency", robot], f"{robot}{label}", name),
        )
        for robot in robots_of(reports, "latency")
        if (cases := _idle(reports, robot))
        for key, name, style, label in WAYS
    ]


def _label(report: Report, label: str, name: str) -> str:
    """Who it is, with median and tail as in the figures."""
    p50, p99 = (report.figures.get(name.format(part), math.nan) for part in ("p50", "p99"))
    return f"{label}: p50 {p50:.0f}, p99 {p99:.0f}"


def _draw(axes: Axes, parts: list[Part]) -> None:
    """Histograms with the same bins, from quantiles: between two of them lies a known share, evenly spread."""
    shares = np.array(QUANTILES)
    low = min(values[0] for values, *_ in parts)
    high = max(values[shares == SHOWN][0] for values, *_ in parts)
    edges = np.geomspace(max(low, 1.0), max(high, 1.001 * max(low, 1.0)), BINS + 1)  # 1: nothing is below a microsecond
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
