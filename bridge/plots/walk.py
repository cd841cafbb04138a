"""Plot of a walk: footsteps, CoM, DCM and ZMP seen from above and against time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin

from bridge.plots import COLOURS, new_figure
from bridge.record.recording import Recording
from bridge.record.render import DONE
from bridge.stability import analyse
from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.types import Matrix

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
