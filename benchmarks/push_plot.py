"""Pictures of the push test with steps: the map of all directions, and the fall that limits it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from benchmarks.harness import Report
from benchmarks.push import Stance, stance
from benchmarks.push_trial import Trial, survives
from bridge.closed_loop import ClosedLoop
from bridge.plots import COLOURS, new_figure
from models.constants import GRAVITY
from models.types import Matrix


def draw_map(report: Report, folder: Path) -> Path:
    """Polar map of impulse over mass [m/s], labelled in N.s too, with the bounds of ankles and steps."""
    figure = new_figure(7.0, 6.5)
    axes = figure.add_subplot(projection="polar", theta_offset=0.5 * math.pi)  # forward is up
    angles = sorted({case["angle"] for case in report.cases})
    lines = (
        ("steps_dv", {"color": "0.6", "linestyle": ":", "label": "N-step capturability bound"}),
        ("ankle_dv", {"color": "0.4", "linestyle": "--", "label": "ankle bound"}),
        ("dv", {"color": "#1b6ca8", "marker": "o", "label": "taken in every phase"}),
    )
    for key, style in lines:
        values = [min(case[key] for case in report.cases if case["angle"] == angle) for angle in angles]
        axes.plot([*angles, angles[0]], [*values, values[0]], **style)  # type: ignore[arg-type]
    axes.set_ylim(0.0, 1.3 * max(0.6, *(case["dv"] for case in report.cases)))
    mass = report.cases[0]["mass"]
    ticks = [tick for tick in axes.get_yticks() if tick > 0.0]
    axes.set_yticks(ticks, [f"{tick:.1f} m/s\n{tick * mass:.0f} N.s" for tick in ticks], fontsize=7)
    axes.set_title(f"{report.robot}, {report.bench.removeprefix('push_')}: push at the pelvis, forward up", fontsize=10)
    axes.legend(loc="lower right", fontsize=8, bbox_to_anchor=(1.1, -0.08))
    file = folder / f"push-map-{report.bench.removeprefix('push_')}-{report.robot}.png"
    figure.savefig(file, dpi=110)
    return file


class _Watch:
    """Keeps what a picture of a trial needs."""

    def __init__(self) -> None:
        self.times: list[float] = []
        self.stances: list[Stance] = []
        self.targets: list[Matrix] = []
        self.commands: list[Matrix] = []
        self.swinging: list[int | None] = []

    def __call__(self, loop: ClosedLoop) -> None:
        view = loop.gait.view
        self.times.append(loop.t)
        self.stances.append(stance(loop.robot, loop.truth))
        self.targets.append(np.array([[hold.x, hold.y] for hold in loop.gait.footholds]))
        self.commands.append(loop.result.zmp.copy())
        self.swinging.append(1 - view.stance if view.swinging else None)


def draw_failure(trial: Trial, dv: float, folder: Path) -> Path:
    """DCM, ZMP and soles of one push against time, along and across the robot.

    Args:
        trial: The push but for its size.
        dv: Impulse over mass [m/s].
        folder: Where the picture goes.
    """
    watch = _Watch()
    reason = survives(trial, dv, watch)
    omega = math.sqrt(GRAVITY / float(watch.stances[0].com[2] - watch.stances[0].soles[:, 2].mean()))
    time = np.array(watch.times) - watch.times[0]
    figure = new_figure(9.0, 6.5)
    for i, name in enumerate(("forward", "left")):
        axes = figure.add_subplot(2, 1, i + 1)
        _draw_axis(axes, watch, time, omega, i)
        axes.set_ylabel(f"{name} [m]")
    axes.set_xlabel("time from the push [s]")
    figure.axes[0].legend(fontsize=7, ncols=4)
    figure.axes[0].set_title(
        f"{trial.robot}, {trial.mode.value}: {dv:.2f} m/s at {math.degrees(trial.angle):.0f} deg, phase {trial.phase}: "
        f"{reason or 'taken'}",
        fontsize=10,
    )
    file = folder / f"push-failure-{trial.mode.value}-{trial.robot}.png"
    figure.savefig(file, dpi=110)
    return file


def _draw_axis(axes: Axes, watch: _Watch, time: Matrix, omega: float, i: int) -> None:
    """One horizontal axis of W against time; true DCM, CoP and soles, commanded CMP and footholds."""
    dcm = [now.com[i] + now.com_velocity[i] / omega for now in watch.stances]
    axes.plot(time, dcm, color=COLOURS["DCM"], label="DCM")
    axes.plot(time, [now.com[i] for now in watch.stances], color=COLOURS["CoM"], label="CoM")
    axes.plot(time, [now.cop[i] for now in watch.stances], color=COLOURS["ZMP"], label="CoP")
    axes.plot(time, [zmp[i] for zmp in watch.commands], color=COLOURS["ZMP"], linestyle=":", label="commanded CMP")
    for foot, colour in ((0, "0.2"), (1, "0.6")):
        side = "left" if foot == 0 else "right"
        axes.plot(time, [now.soles[foot, i] for now in watch.stances], color=colour, label=f"{side} sole")
        aims = [
            target[foot, i] if swinging == foot else math.nan
            for target, swinging in zip(watch.targets, watch.swinging, strict=True)
        ]
        axes.plot(time, aims, color=colour, linestyle="--", label="its foothold")
    # The range is that of the feet, wherever the robot falls to.
    places = np.array([now.soles[:, i] for now in watch.stances])
    axes.set_ylim(float(places.min()) - 0.4, float(places.max()) + 0.4)
    axes.grid(alpha=0.3)
