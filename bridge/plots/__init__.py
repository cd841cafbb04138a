"""Plots of a run: balance, footsteps, and joint torques against their limits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from bridge.record.recording import Recording
from bridge.record.render import DONE
from bridge.stability import Stability, analyse, support_polygon
from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.types import Matrix

COLOURS = {"CoM": "#1b6ca8", "DCM": "#d1495b", "ZMP": "#66a182"}


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of a size [inch] that needs no display."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def plot_run(model: RobotModel, recording: Recording, stability: Stability, folder: Path) -> list[Path]:
    """Draw the plots of one run into ``folder``; ``stability`` is from ``analyse``. Returns the files."""
    folder.mkdir(parents=True, exist_ok=True)
    balance, torques = folder / "balance.png", folder / "torques.png"
    _balance(model, recording, stability).savefig(balance, dpi=110)
    _torques(model, recording).savefig(torques, dpi=110)
    return [balance, torques]


def _mark_events(axes: Axes, recording: Recording, *, text: bool = False) -> None:
    for time, name in recording.events:
        axes.axvline(time, color="0.75", linewidth=0.8, zorder=0)
        if text and not name.endswith("done"):
            axes.annotate(
                name,
                (time, 1.0),
                xycoords=("data", "axes fraction"),
                xytext=(2, 3),
                textcoords="offset points",
                fontsize=8,
            )


def _balance(model: RobotModel, recording: Recording, stability: Stability) -> Figure:
    figure = new_figure(12.0, 6.0)
    grid = figure.add_gridspec(2, 2, width_ratios=[2.2, 1.0])
    series = {"ZMP": stability.zmp, "DCM": stability.dcm, "CoM": stability.com[:, :2]}
    for row, axis in enumerate("xy"):
        axes = figure.add_subplot(grid[row, 0])
        _mark_events(axes, recording, text=row == 0)
        for name, values in series.items():
            axes.plot(stability.t, values[:, row], color=COLOURS[name], linewidth=0.9, label=name)
        axes.set_ylabel(f"{axis} [m]")
        axes.margins(x=0.0)
        axes.legend(loc="lower left", fontsize=8, ncols=3)
    axes.set_xlabel("t [s]")
    above = figure.add_subplot(grid[:, 1])
    data = model.data()
    pin.framesForwardKinematics(model.pin, data, recording.q[0])
    corners = []
    for foot in model.feet:
        placement = data.oMf[foot.frame_id]
        outline = (placement.rotation @ foot.corners.T).T + placement.translation
        corners.append(outline)
        above.fill(outline[:, 0], outline[:, 1], color="0.85", zorder=0)
    hull = support_polygon(corners)
    above.plot(*np.vstack([hull, hull[:1]]).T, color="0.6", linewidth=0.8)
    for name, values in series.items():
        above.plot(values[:, 0], values[:, 1], color=COLOURS[name], linewidth=0.7, label=name)
    above.set_aspect("equal")
    above.set_xlabel("x [m]")
    above.set_ylabel("y [m]")
    above.set_title("from above, with the soles", fontsize=9)
    return figure


def _torques(model: RobotModel, recording: Recording) -> Figure:
    figure = new_figure(12.0, 6.0)
    used = recording.tau / model.tau_max
    groups = {
        "legs": sorted({index - 6 for foot in model.feet for index in foot.joint_ids_v}),
    }
    groups["waist, arms and head"] = [index for index in range(model.nj) if index not in groups["legs"]]
    for row, (name, joints) in enumerate(groups.items()):
        axes = figure.add_subplot(2, 1, row + 1)
        axes.set_prop_cycle(color=[colormaps["tab20"](k) for k in range(20)])
        _mark_events(axes, recording, text=row == 0)
        for index in joints:
            axes.plot(recording.t, used[:, index], linewidth=0.7, label=model.joint_names[index])
        axes.axhline(1.0, color="k", linewidth=0.6, linestyle="--")
        axes.axhline(-1.0, color="k", linewidth=0.6, linestyle="--")
        axes.set_ylabel(f"{name}\ntorque / limit [-]")
        axes.margins(x=0.0)
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=6, ncols=2 if len(joints) > 14 else 1)
    axes.set_xlabel("t [s]")
    return figure


LANDED = 0.5  #: Share of the weight on a foot that makes a footstep of it [-]


def footsteps(model: RobotModel, recording: Recording) -> list[tuple[int, Matrix]]:
    """Foot and outline of its sole in W (4, 3) [m] at each touchdown."""
    steps: list[tuple[int, Matrix]] = []
    data, weight = model.data(), model.mass * GRAVITY
    for i, foot in enumerate(model.feet):
        loaded = recording.wrenches[:, i, 2] > LANDED * weight
        for row in np.flatnonzero(loaded & ~np.r_[False, loaded[:-1]]):
            pin.framesForwardKinematics(model.pin, data, recording.q[row])
            placement = data.oMf[foot.frame_id]
            steps.append((i, (placement.rotation @ foot.corners.T).T + placement.translation))
    return steps


def plot_walk(model: RobotModel, recording: Recording, folder: Path) -> Path:
    """Draw the walking part of a run, from the beginning of the walk on; returns the file."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "walk.png"
    stability = analyse(model, recording)
    series = {"ZMP": stability.zmp, "DCM": stability.dcm, "CoM": stability.com[:, :2]}
    figure = new_figure(14.0, 7.0)
    grid = figure.add_gridspec(2, 2, width_ratios=[1.0, 1.2])
    above = figure.add_subplot(grid[:, 0])
    for foot, outline in footsteps(model, recording):
        above.fill(outline[:, 0], outline[:, 1], facecolor=("#cfe3f1", "#f6d9dc")[foot], edgecolor="0.5", linewidth=0.5)
    for name, values in series.items():
        above.plot(values[:, 0], values[:, 1], color=COLOURS[name], linewidth=0.7, label=name)
    if recording.estimate is not None:
        above.plot(*recording.estimate[:, :2].T, "k:", linewidth=0.9, label="base, estimated")
        above.plot(*recording.q[:, :2].T, "k", linewidth=0.7, label="base, true")
    above.set_aspect("equal")
    above.set_xlabel("x [m]")
    above.set_ylabel("y [m]")
    above.legend(loc="center", fontsize=8)
    above.set_title("footsteps from above: left blue, right red", fontsize=9)
    for row, axis in enumerate("xy"):
        axes = figure.add_subplot(grid[row, 1])
        for time, text in recording.events:
            axes.axvline(time, color="0.75", linewidth=0.8, zorder=0)
            if row == 0 and time > recording.t[0] + 0.5 and not text.endswith(DONE):
                axes.annotate(text, (time, 1.0), xycoords=("data", "axes fraction"), rotation=30.0, fontsize=7)
        for name, values in series.items():
            axes.plot(stability.t, values[:, row], color=COLOURS[name], linewidth=0.8, label=name)
        axes.set_ylabel(f"{axis} [m]")
        axes.margins(x=0.0)
    axes.set_xlabel("t [s]")
    figure.savefig(file, dpi=110)
    return file
