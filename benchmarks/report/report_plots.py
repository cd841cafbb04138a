"""Pictures of speeds, costs, errors and delays, of all robots in one."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.core.harness import Case
from benchmarks.faults.fault_rows import config as fault_config
from benchmarks.report.report_style import BOUND, Reports, draw_dots, look, robots_of
from benchmarks.stability.estimate import WALK, drift
from benchmarks.stability.estimate_runs import estimate_config
from benchmarks.stability.walk_cases import walk_config
from bridge.plots import new_figure

#: Parts of a velocity, in the robot's frame, and their units
AXES_OF_WALKING = (("forward", "m/s"), ("left", "m/s"), ("turn to the left", "rad/s"))
MILLI, PERCENT = 1e3, 1e2


def _walks(reports: Reports) -> dict[str, list[Case]]:
    """Walks at one velocity, by robot; empty when there is none."""
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
        axes.set(xlabel=f"commanded {name} [{unit}]", ylabel=f"walked, mean [{unit}]")
        axes.grid(alpha=0.3)
    figure.axes[0].legend(fontsize=8)
    figure.suptitle(f"Walks of {walk_config().duration:.0f} s at a commanded velocity: {', '.join(walks)}", fontsize=11)
    return figure


def draw_cost(reports: Reports) -> Figure | None:
    """Cost of transport of every walk at one velocity that moves the robot: work of the joints over weight and way."""
    walks = _walks(reports)
    names = list(dict.fromkeys(case["scenario"] for cases in walks.values() for case in cases))
    costs = {
        robot: {
            name: [case["cost_of_transport"] for case in cases if case["scenario"] == name and _moves(case)]
            for name in names
        }
        for robot, cases in walks.items()
    }
    figure = _dots(
        reports, costs, "cost of transport [-]", f"Cost of transport, by commanded velocity: {', '.join(walks)}"
    )
    if figure is not None:
        labels = [_commands(name, walks) for name in names]
        figure.axes[0].set_xticks(range(len(names)), labels, fontsize=9)
    return figure


def _moves(case: Case) -> bool:
    return bool(np.isfinite(np.asarray(case["cost_of_transport"], dtype=float)))


def _commands(name: str, walks: dict[str, list[Case]]) -> str:
    """Name of a walk, and the commanded speed of each robot."""
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
    limits, figure = estimate_config(), new_figure(9.0, 6.0)
    parts = (
        ("velocity_rmse", "velocity, RMS [mm/s]", MILLI, limits.velocity_rmse_max, limits.walk_velocity_rmse_max),
        ("tilt_rmse_deg", "roll and pitch, RMS [deg]", 1.0, limits.tilt_rmse_max, None),
        ("height_rmse", "height, RMS [mm]", MILLI, limits.height_rmse_max, None),
    )
    *panels, last = figure.subplots(2, 2).ravel()
    of = {robot: reports["estimate", robot].cases for robot in robots}
    names = list(dict.fromkeys(case["scenario"] for cases in of.values() for case in cases))
    for axes, (key, label, unit, bound, walking) in zip(panels, parts, strict=True):
        values = {
            robot: {name: [unit * case[key] for case in cases if case["scenario"] == name] for name in names}
            for robot, cases in of.items()
        }
        draw_dots(axes, reports, values, label)
        for place, name in enumerate(names):
            _draw_bound(axes, place, walking if name == WALK else bound, unit)
    drifts = {
        robot: {WALK: [PERCENT * drift(case) for case in cases if case["scenario"] == WALK]}
        for robot, cases in of.items()
    }
    draw_dots(last, reports, drifts, "drift of the position [% of the way]")
    _draw_bound(last, 0, limits.drift_max, PERCENT)
    for axes in (*panels, last):
        axes.plot([], [], label="bound", **BOUND)
        axes.set_ylim(0.0, 1.08 * axes.dataLim.y1)
    panels[0].legend(fontsize=8, loc="upper left")
    figure.suptitle(f"Error of the state estimate, by what the robot does: {', '.join(robots)}", fontsize=11)
    return figure


def _draw_bound(axes: Axes, place: int, bound: float | None, unit: float) -> None:
    if bound is not None:
        axes.plot([place - 0.35, place + 0.35], [unit * bound] * 2, **BOUND)


def draw_delays(reports: Reports) -> Figure | None:
    """Delay of all joint states that the robot rides through, found by bisection, with the bound."""
    margins = fault_config().margins
    found = {
        robot: {
            name: [MILLI * case["margin"] for case in reports["faults", robot].cases if case["row"] == name]
            for name in margins
        }
        for robot in robots_of(reports, "faults")
    }
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
