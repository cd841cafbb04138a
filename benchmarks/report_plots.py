"""Pictures of speeds, costs, times, errors and delays, of all robots in one."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.estimate_runs import settings
from benchmarks.fault_rows import config as fault_config
from benchmarks.report_survival import Reports, colour, robots_of
from benchmarks.spread import percentiles_of, spread_of
from benchmarks.timed_run import QUANTILES
from bridge.plots import new_figure
from models.types import Vector

AXES_OF_WALKING = (("forward", "m/s"), ("left", "m/s"), ("turn", "rad/s"))
"""Parts of a velocity, in the robot's frame, and their units."""

TIMED = (("tick", "tick", "whole-body tick, standing"), ("gait", "tick", "whole-body tick, single support"))
"""Bench, subject among its quantiles, and what it is, for what is timed in microseconds by quantiles."""

MILLI = 1e3


def draw_speeds(reports: Reports) -> Figure | None:
    """Mean velocity against the commanded one, of every walk at one velocity."""
    walks = {robot: [c for c in reports["walk", robot].cases if c["kind"] == "steady"] for robot in _walkers(reports)}
    if not any(walks.values()):
        return None
    figure = new_figure(12.0, 4.0)
    for part, (axes, (name, unit)) in enumerate(zip(figure.subplots(1, 3), AXES_OF_WALKING, strict=True)):
        for robot, cases in walks.items():
            points = [(case["command"][part], case["velocity"][part], case["fell"]) for case in cases]
            for fell, marker in ((False, "o"), (True, "x")):
                chosen = [point for point in points if point[2] == fell]
                shown = [[x for x, _, _ in chosen], [y for _, y, _ in chosen]]
                label = f"{robot}, fell" if fell else robot
                axes.plot(*shown, marker, color=colour(reports, robot), markersize=4, label=label if chosen else None)
        low, high = axes.dataLim.intervalx
        ends = [low - 0.05, high + 0.05]
        axes.plot(ends, ends, color="0.6", linewidth=0.8, zorder=0)
        axes.set_xlabel(f"commanded {name} [{unit}]")
        axes.set_ylabel(f"walked, mean [{unit}]")
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    return figure


def draw_cost(reports: Reports) -> Figure | None:
    """Cost of transport of every walk at one velocity that moves the robot: work of the joints over weight and way."""
    walks = {robot: [c for c in reports["walk", robot].cases if c["kind"] == "steady"] for robot in _walkers(reports)}
    costs = {
        robot: {
            name: [case["cost_of_transport"] for case in cases if case["scenario"] == name and _moves(case)]
            for name in dict.fromkeys(case["scenario"] for case in cases)
        }
        for robot, cases in walks.items()
    }
    return _dots(reports, costs, "cost of transport [-]")


def _moves(case: dict[str, object]) -> bool:
    return bool(np.isfinite(np.asarray(case["cost_of_transport"], dtype=float)))


def _walkers(reports: Reports) -> list[str]:
    return robots_of(reports, "walk")


def draw_estimator(reports: Reports) -> Figure | None:
    """Errors of the estimator by scenario, one dot a run, with the bound where there is one for all but the walk."""
    robots = robots_of(reports, "estimate")
    if not robots:
        return None
    limits = settings()
    parts = (
        ("velocity_rmse", "velocity, RMS [m/s]", limits.velocity_rmse_max),
        ("tilt_rmse_deg", "roll and pitch, RMS [deg]", limits.tilt_rmse_max),
        ("height_rmse", "height, RMS [m]", limits.height_rmse_max),
    )
    figure = new_figure(13.0, 4.0)
    for axes, (key, label, limit) in zip(figure.subplots(1, 3), parts, strict=True):
        values = {
            robot: {
                name: [case[key] for case in reports["estimate", robot].cases if case["scenario"] == name]
                for name in dict.fromkeys(case["scenario"] for case in reports["estimate", robot].cases)
            }
            for robot in robots
        }
        _draw_dots(axes, reports, values, label)
        axes.axhline(limit, color="k", linewidth=0.8, linestyle="--", label="bound but for the walk")
        axes.set_ylim(bottom=0.0)
        axes.legend(fontsize=7)
    return figure


def draw_times(reports: Reports) -> Figure | None:
    """Histograms of the whole-body tick and of the way from the sensors to the command."""
    panels: list[tuple[str, Callable[[Axes], None]]] = []
    for bench, subject, title in TIMED:
        if robots_of(reports, bench):
            panels.append((f"{title} [us]", partial(_draw_ticks, reports=reports, bench=bench, subject=subject)))
    cases = [case for robot in robots_of(reports, "latency") for case in reports["latency", robot].cases]
    if any(spread_of(case, "latency") for case in cases):
        panels.append(("sensors to command over ROS 2 [us]", lambda axes: _draw_latencies(axes, reports)))
    if not panels:
        return None
    figure = new_figure(5.0 * len(panels), 4.0)
    for axes, (label, draw) in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        draw(axes)
        axes.set_xscale("log")
        axes.set_xlabel(label)
        axes.set_ylabel("share of the samples per bin [-]")
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    return figure


def _draw_ticks(axes: Axes, reports: Reports, bench: str, subject: str) -> None:
    for robot in robots_of(reports, bench):
        values = np.median([case["quantiles"][subject] for case in reports[bench, robot].cases], axis=0)
        _draw_histogram(axes, values, color=colour(reports, robot), label=robot)


def _draw_latencies(axes: Axes, reports: Reports) -> None:
    for robot in robots_of(reports, "latency"):
        for name, style, label in (("latency", "-", robot), ("floor", ":", f"{robot}, ping-pong floor")):
            spreads = [spread_of(case, name) for case in reports["latency", robot].cases]
            held = [each for each in spreads if each is not None]
            if held:
                values = percentiles_of(held)
                _draw_histogram(axes, values, color=colour(reports, robot), linestyle=style, label=label)


def _draw_histogram(axes: Axes, values: Vector, **style: Any) -> None:
    """A histogram from the values at ``QUANTILES``: between two of them lies a known share, evenly spread."""
    edges = _log_edges(values[0], values[-1])
    axes.stairs(np.diff(np.interp(edges, values, np.array(QUANTILES) / 100.0)), edges, **style)


def _log_edges(low: float, high: float) -> np.ndarray:
    return np.geomspace(max(low, 1.0), max(high, 1.001 * max(low, 1.0)), 60)  # 1: no sample is below a microsecond


def draw_delays(reports: Reports) -> Figure | None:
    """Delay of all joint states that the robot rides through, with the bound."""
    margins = fault_config().margins
    found = {
        robot: {
            name: [MILLI * case["margin"] for case in reports["faults", robot].cases if case["row"] == name]
            for name in margins
        }
        for robot in robots_of(reports, "faults")
    }
    if not any(any(values) for of in found.values() for values in of.values()):
        return None
    figure = _dots(reports, found, "delay margin [ms]")
    if figure is not None:
        for place, margin in enumerate(margins.values()):
            ends = [place - 0.3, place + 0.3]
            figure.axes[0].plot(ends, [MILLI * margin.required] * 2, "k--", linewidth=0.8)
    return figure


def _dots(reports: Reports, values: dict[str, dict[str, list[float]]], label: str) -> Figure | None:
    if not any(any(of.values()) for of in values.values()):
        return None
    figure = new_figure(8.0, 4.0)
    axes = figure.add_subplot()
    _draw_dots(axes, reports, values, label)
    axes.set_ylim(bottom=0.0)
    axes.legend(fontsize=8)
    return figure


def _draw_dots(axes: Axes, reports: Reports, values: dict[str, dict[str, list[float]]], label: str) -> None:
    """One dot a case, by scenario and robot."""
    names = list(dict.fromkeys(name for of in values.values() for name in of))
    for k, (robot, of) in enumerate(values.items()):
        offset = 0.16 * (k - 0.5 * (len(values) - 1))
        places = [names.index(name) + offset for name, dots in of.items() for _ in dots]
        dots = [dot for dots in of.values() for dot in dots]
        axes.plot(places, dots, "o", color=colour(reports, robot), markersize=4, alpha=0.7, label=robot)
    axes.set_xticks(range(len(names)), [name.replace("_", " ") for name in names], fontsize=8)
    axes.set_xlim(-0.5, len(names) - 0.5)
    axes.set_ylabel(label)
    axes.grid(axis="y", alpha=0.3)
