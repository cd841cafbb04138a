"""Signals before the end of a failed trial, as plain numbers (``last_moments``), and their plot (``draw_fall``)."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes

from benchmarks.core.benchmark import by_scenario, saved
from benchmarks.core.harness import Case, Report
from bridge.analysis.plots import COLOURS, new_figure
from bridge.analysis.stability import balance
from bridge.closed_loop import ClosedLoop
from bridge.loop.log import LoopLog
from models.constants import GRAVITY
from models.heading import heading, turned
from models.robot_model import RobotModel
from models.types import Matrix, Mode, SolveStatus, Vector

if TYPE_CHECKING:  # it needs ROS 2
    from bridge.hardware_loop import HardwareLoop

ROWS = 300  # maximum number of rows
AFTER = 0.1  # time after damping that is included [s]

#: Number of leg joints and of other joints with the smallest margins to torque and position limits
LEG_JOINTS, OTHER_JOINTS = 3, 2
SATURATED = 0.95  # share of the limit above which a torque counts as saturated [-]


def last_moments(loop: ClosedLoop | HardwareLoop, duration: float) -> Case:
    """Return ``moments_since`` for ``duration`` [s] before the robot was damped or before the end of the log."""
    return moments_since(loop, _end(loop.log) - duration)


def draw_distances(
    report: Report, folder: Path, label: str, draw_limits: Callable[[Axes], None] = lambda axes: None
) -> list[Path]:
    """Plot the distance of every case by scenario and outcome, and the first failures; returns the files.

    ``label`` is the label of the distance, ``draw_limits`` draws the required distance.
    """
    names = list(by_scenario(report.cases))
    first = min((case["seed"] for case in report.cases), default=0)
    figure = new_figure(3.5 + 0.9 * len(names), 3.6)
    axes = figure.add_subplot(1, 1, 1)
    for survived, colour, outcome in ((True, PASSED, "survived"), (False, FAILED, "did not survive")):
        shown = [case for case in report.cases if case["survived"] == survived]
        places = [
            names.index(case["scenario"]) + 0.3 * ((case["seed"] - first + 0.5) / report.seeds - 0.5) for case in shown
        ]
        axes.plot(places, [case["distance"] for case in shown], "o", markersize=4, color=colour, label=outcome)
    axes.set_xticks(range(len(names)), names, fontsize=8, rotation=20)
    axes.set_xlim(-0.5, len(names) - 0.5)
    draw_limits(axes)
    axes.set_ylabel(label)
    axes.set_ylim(bottom=0.0)
    axes.set_title(f"{report.bench}, {report.who}, seeds: {report.seeds}", fontsize=10)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8, frameon=False)
    return [saved(figure, folder / f"{report.bench}-{report.stem}.png"), *draw_failures(report, folder)]


def _end(log: LoopLog) -> float:
    """Return the time at which the robot was damped, or the last stamp [s]."""
    given_up = log.t[[mode is Mode.DAMP for mode in log.modes]]
    return float(given_up[0] if len(given_up) else log.t[-1])


def moments_since(loop: ClosedLoop | HardwareLoop, begin: float) -> Case:
    """Return the signals at the end of a robot's log; positions are relative to its CoM, along its heading.

    Estimates and commands of the laws are in a drifting frame, so they are relative to estimated CoM and heading. The
    first row is at ``begin`` [s], or when the robot was damped, if earlier. The last row is ``AFTER`` the damping.
    Returns lists of n rows: ``t`` [s]. Forward and left of the CoM [m]: ``dcm``, ``cop`` (null in flight), ``dcm_seen``
    and ``cmp`` (estimate and command of the law); for both feet ``soles_low`` and ``soles_high``, the limits of the
    sole corners, and ``aims``, the foothold of the swing foot (null otherwise). ``loads`` and ``planned_loads`` over
    the weight [-], ``heights`` of the lowest corner in W [m], ``tilts`` of the soles [deg], ``base_tilt`` to the front
    and to the left [deg], ``base_height`` over the lower sole [m], ``status`` of the QP, ``mode``. By name, for the
    joints closest to their limits: ``torques``, as shares of the limit [-], ``margins`` [deg]. ``events``: stamp, text.
    """
    log, model = loop.log, loop.robot
    end = _end(log)
    recent = np.flatnonzero((log.t >= min(begin, end)) & (log.t <= end + AFTER))
    rows = recent[:: -max(-(-len(recent) // ROWS), 1)][::-1]
    true, weight = _true_signals(model, log.true_q[rows], log.true_v[rows], log.wrenches[rows]), model.mass * GRAVITY
    yaws = [heading(*q[3:7]) for q in log.estimate_q[rows]]
    aims = np.full((len(rows), 2, 2), np.nan)
    for foot in range(2):
        swings = log.swing[rows] == foot
        aims[swings, foot] = log.footholds[rows][swings, 2 * foot : 2 * foot + 2]
    com, statuses, modes = log.com[rows, :2], log.statuses, log.modes
    acting = np.array([modes[row] is not Mode.DAMP for row in rows])  # later signals do not explain the failure
    acting |= not acting.any()  # unless there are no others
    names, joints = np.array(model.joint_names), log.true_q[rows, 7:]
    shares = np.abs(log.tau[rows]) / model.tau_max  # (n, nj)
    margins = np.degrees(np.minimum(joints - model.q_lower, model.q_upper - joints))  # (n, nj)
    strained = _first(model, -shares[acting].max(axis=0) - (shares[acting] > SATURATED).mean(axis=0))
    nearest = _first(model, margins[acting].min(axis=0))
    signals = {
        "t": log.t[rows],
        **true,
        "dcm_seen": _seen(log.dcm[rows], com, yaws),
        "cmp": _seen(log.zmp[rows], com, yaws),
        "aims": _seen(aims, com, yaws),
        "loads": log.wrenches[rows][:, [2, 8]] / weight,
        "planned_loads": log.planned_wrenches[rows][:, [2, 8]] / weight,
    }
    return {
        **{name: _rounded(values) for name, values in signals.items()},
        "status": [statuses[row].value for row in rows],
        "mode": [modes[row].value for row in rows],
        "torques": {names[i]: _rounded(shares[:, i]) for i in strained},
        "margins": {names[i]: _rounded(margins[:, i]) for i in nearest},
        "events": [[t, text] for t, text in loop.events if t >= log.t[rows[0]]],
    }


def _first(model: RobotModel, score: Vector) -> list[int]:
    """Return the joints with the smallest scores (nj,): leg joints, then others, whose arms swing hardest."""
    order = np.argsort(score, kind="stable").tolist()
    legs = {index - 6 for foot in model.feet for index in foot.joint_ids_v}
    return [i for i in order if i in legs][:LEG_JOINTS] + [i for i in order if i not in legs][:OTHER_JOINTS]


def _rounded(values: Matrix) -> Any:
    return values.round(4).tolist()


def _seen(points: Matrix, com: Matrix, yaws: Sequence[float]) -> Matrix:
    """Return points (n, ..., 2) relative to a CoM (n, 2), along a heading per row."""
    places = com.reshape(len(com), *[1] * (points.ndim - 2), 2)
    return np.array([turned(row, -yaw) for row, yaw in zip(points - places, yaws, strict=True)])


def _true_signals(model: RobotModel, q: Matrix, v: Matrix, wrenches: Matrix) -> dict[str, Matrix]:
    """Return the signals of ``moments_since`` from true state (n, nq), (n, nv) and wrenches (n, 12)."""
    data, rows = model.data(), []
    for i in range(len(q)):
        now, yaw = balance(model, data, q[i], v[i], wrenches[i].reshape(2, 6)), heading(*q[i, 3:7])
        com, heights, up = now.com[:2], now.corners[:, :, 2].min(axis=1), data.oMi[1].rotation[:, 2]
        seen = turned(now.corners[:, :, :2] - com, -yaw)  # (2, 4, 2)
        rows.append(
            {
                "dcm": turned(now.dcm - com, -yaw),
                "cop": turned(now.cop - com, -yaw),
                "soles_low": seen.min(axis=1),
                "soles_high": seen.max(axis=1),
                "heights": heights,
                "tilts": np.degrees(now.tilts),
                "base_tilt": np.degrees(np.arctan2(turned(up[:2], -yaw), up[2])),
                "base_height": q[i, 2] - heights.min(),
            }
        )
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


PASSED, FAILED, GOAL = "#1b6ca8", "#c0392b", "#2e8b57"
"""Colours of passed and failed trials and of goals in the plots of all benchmarks."""

_FEET = (("left", "#7b4fa3"), ("right", "#c98a1b"))
_MOST_LOAD = 3.0  # upper limit of the plotted loads, over the weight; larger loads are impacts [-]
_BORNE = 0.05  # share of the weight above which a sole is drawn as loaded [-]

_SIGNALS = (
    "t", "dcm", "cop", "dcm_seen", "cmp", "soles_low", "soles_high", "aims",
    "loads", "planned_loads", "heights", "tilts", "base_tilt", "base_height",
)  # fmt: skip
"""Signals of ``moments_since`` that are lists of numbers over time."""


def draw_failures(report: Report, folder: Path) -> list[Path]:
    """Plot the first failure of each scenario; failed cases have ``moments`` (``last_moments``) and a ``reason``."""
    first = {case["scenario"]: case for case in reversed(report.cases) if case.get("moments")}
    files = []
    for name in sorted(first):
        case = first[name]
        title = f"{report.bench}, {report.who}, {name}, seed {case['seed']}: {case['reason'] or 'did not fall'}"
        files.append(draw_fall(case["moments"], title, folder / f"{report.bench}-{report.stem}-{name}.png"))
    return files


def draw_fall(moments: Case, title: str, file: Path) -> Path:
    """Plot balance, feet, base, joint limits and QP of ``last_moments`` over time."""
    signals = {name: np.array(values, dtype=float) for name, values in moments.items() if name in _SIGNALS}
    figure = new_figure(15.0, 10.0)
    grid = figure.add_gridspec(5, 2, height_ratios=[1.7, 1.7, 1.0, 1.0, 1.0])
    left = [figure.add_subplot(grid[i, 0]) for i in range(5)]
    right = [figure.add_subplot(grid[i, 1]) for i in range(5)]
    for k, way in enumerate(("forward", "left")):
        _draw_balance(left[k], signals, k)
        left[k].set_ylabel(f"{way} of the CoM [m]", fontsize=8)
    _draw_feet(left[2], signals, "loads", "force / weight [-]")
    left[2].set_ylim(-0.1, min(float(signals["loads"].max()) + 0.1, _MOST_LOAD))
    _draw_feet(left[3], signals, "heights", "height of the sole\nin the world [m]")
    _draw_feet(left[4], signals, "tilts", "tilt of the sole [deg]")
    t = signals["t"]
    _draw_lines(right[0], t, moments["torques"], "torque / limit [-]")
    right[0].axhline(1.0, color="k", linewidth=0.7, linestyle=":", label="limit")
    right[0].set_ylim(0.0, 1.1)
    _draw_lines(right[1], t, moments["margins"], "joint to its nearest stop [deg]")
    right[1].axhline(0.0, color="k", linewidth=0.7, linestyle=":", label="stop")
    tilt = signals["base_tilt"]
    _draw_lines(right[2], t, {"to the front": tilt[:, 0], "to the left": tilt[:, 1]}, "tilt of the base [deg]")
    _draw_lines(right[3], t, {"base": signals["base_height"]}, "base over the\nlower sole [m]")
    _draw_status(right[4], t, moments)
    _finish(left, right, moments)
    events = [f"{i + 1}: {t:.2f} s {text}" for i, (t, text) in enumerate(moments["events"])]
    figure.suptitle("\n".join([title, *(textwrap.shorten(event, 160) for event in events)]), fontsize=9)
    figure.savefig(file, dpi=100)
    return file


def _draw_balance(axes: Axes, signals: Mapping[str, Matrix], k: int) -> None:
    t, low, high = signals["t"], signals["soles_low"], signals["soles_high"]
    for foot, (name, colour) in enumerate(_FEET):
        bears = signals["loads"][:, foot] > _BORNE
        edges = low[:, foot, k], high[:, foot, k]
        axes.fill_between(t, *edges, where=bears, color=colour, alpha=0.25, linewidth=0.0, label=f"{name} sole, loaded")
        for edge in edges:
            axes.plot(t, edge, color=colour, linewidth=0.5)
        axes.plot(t, signals["aims"][:, foot, k], color=colour, linestyle="--", label=f"{name} target foothold")
    axes.plot(t, signals["dcm"][:, k], color=COLOURS["DCM"], linewidth=1.6, label="DCM")
    axes.plot(t, signals["dcm_seen"][:, k], color=COLOURS["DCM"], linewidth=0.8, linestyle=":", label="DCM, estimated")
    axes.plot(t, signals["cop"][:, k], color=COLOURS["ZMP"], linewidth=1.4, label="CoP")
    axes.plot(t, signals["cmp"][:, k], color="0.2", linewidth=0.8, linestyle=":", label="CMP, commanded")
    # The range covers the soles; a DCM far outside is not useful.
    axes.set_ylim(float(low[:, :, k].min()) - 0.15, float(high[:, :, k].max()) + 0.15)


def _draw_feet(axes: Axes, signals: Mapping[str, Matrix], name: str, label: str) -> None:
    planned = signals.get(f"planned_{name}")
    for foot, (side, colour) in enumerate(_FEET):
        axes.plot(signals["t"], signals[name][:, foot], color=colour, linewidth=1.1, label=f"{side} foot")
        if planned is not None:
            axes.plot(signals["t"], planned[:, foot], color=colour, linewidth=0.8, linestyle=":", label="... planned")
    axes.set_ylabel(label, fontsize=8)


def _draw_lines(axes: Axes, t: Matrix, lines: Mapping[str, Any], label: str) -> None:
    """Draw signals by name; of joints, legs first, the others dashed."""
    for i, (name, values) in enumerate(lines.items()):
        style = "-" if i < LEG_JOINTS else "--"
        axes.plot(t, np.array(values, dtype=float), style, linewidth=1.1, label=name.removesuffix("_joint"))
    axes.set_ylabel(label, fontsize=8)


def _draw_status(axes: Axes, t: Matrix, moments: Case) -> None:
    levels = [status.value for status in reversed(SolveStatus)]
    axes.step(t, [levels.index(status) for status in moments["status"]], where="post", color="k", linewidth=1.0)
    axes.set_yticks(range(len(levels)), [level.replace("_", " ") for level in levels], fontsize=7)
    axes.set_ylim(-0.5, len(levels) - 0.5)
    axes.set_ylabel("QP solution", fontsize=8)
    modes = moments["mode"]
    for i in [i for i in range(len(modes)) if i == 0 or modes[i] != modes[i - 1]]:
        late = t[i] > 0.2 * t[0] + 0.8 * t[-1]  # no space to the right
        axes.text(t[i], -0.3, f" mode {modes[i]} ", fontsize=7, color="0.3", ha="right" if late else "left")


def _finish(left: list[Axes], right: list[Axes], moments: Case) -> None:
    for axes in (*left, *right):
        for t, _ in moments["events"]:
            axes.axvline(t, color="0.55", linewidth=0.9, zorder=0)
        axes.set_xlim(moments["t"][0], moments["t"][-1])
        axes.grid(alpha=0.3)
        axes.tick_params(labelsize=8)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=7, frameon=False)
    for axes in (left[0], right[0]):
        for t, label in _event_labels(moments).items():
            axes.annotate(label, (t, 1.0), xycoords=("data", "axes fraction"), xytext=(0, 2),
                          textcoords="offset points", fontsize=8, ha="center")  # fmt: skip
    for axes in (left[-1], right[-1]):
        axes.set_xlabel("time [s]")


def _event_labels(moments: Case) -> dict[float, str]:
    """Return the numbers of the events at each time, as in the title: '1, 2'."""
    found: dict[float, str] = {}
    for i, (t, _) in enumerate(moments["events"]):
        found[t] = f"{found[t]}, {i + 1}" if t in found else f"{i + 1}"
    return found
