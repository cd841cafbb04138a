"""Pictures of a black box: sensors, commands and balance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from bridge.plots import new_figure, plot_run
from bridge.record.recording import Recording
from bridge.stability import analyse
from controllers.recording.black_box_file import BlackBoxRecord
from models.constants import GRAVITY
from models.errors import PoiseError
from models.robot_model import RobotModel
from models.types import FOOT_NAMES, Matrix, SolveStatus

ROWS = 1000  #: Maximum number of rows for the balance
JOINTS = 5  #: Number of joints drawn: farthest from the command, or nearest to the torque limit
_COLOURS = ("#7b4fa3", "#c98a1b")


def plot_black_box(model: RobotModel, record: BlackBoxRecord, folder: Path) -> list[Path]:
    """Draw a black box into ``folder``; returns the files. ``PoiseError`` when it is empty or of another robot."""
    if record.joint_names != model.joint_names:
        raise PoiseError(f"the black box is of a robot '{record.robot}' with other joints than '{model.name}'")
    if len(record.t) == 0:
        raise PoiseError("the black box is empty")
    recording = _recording(record)
    files = plot_run(model, recording, analyse(model, recording), folder)
    return [_overview(model, record, folder / "black_box.png"), *files]


def _recording(record: BlackBoxRecord) -> Recording:
    """Some rows as a recording: estimated state, measured torques and wrenches."""
    rows = slice(None, None, -(-len(record.t) // ROWS))
    return Recording(
        robot=record.robot,
        t=record.t[rows],
        q=record.q[rows].astype(float),
        v=record.v[rows].astype(float),
        tau=record.joint_tau[rows].astype(float),
        wrenches=record.wrenches[rows].astype(float),
        events=record.events,
    )


def _overview(model: RobotModel, record: BlackBoxRecord, file: Path) -> Path:
    """Attitude, IMU, loads, tracking, torques and solver against time."""
    figure = new_figure(13.0, 13.0)
    axes = [figure.add_subplot(7, 1, i + 1) for i in range(7)]
    t, weight = record.t, model.mass * GRAVITY
    x, y = record.q[:, 3:5].T
    tilt = np.degrees(np.arccos(np.clip(1.0 - 2.0 * (x * x + y * y), -1.0, 1.0)))
    axes[0].plot(t, tilt, color="k", linewidth=1.0, label="base")
    axes[0].set_ylabel("tilt [deg]", fontsize=8)
    for k, name in enumerate("xyz"):
        axes[1].plot(t, record.gyro[:, k], linewidth=0.7, label=f"gyro {name}")
        axes[2].plot(t, record.accel[:, k], linewidth=0.7, label=f"accel {name}")
    axes[1].set_ylabel("rate [rad/s]", fontsize=8)
    axes[2].set_ylabel("specific force\n[m/s^2]", fontsize=8)
    for foot, (name, colour) in enumerate(zip(FOOT_NAMES, _COLOURS, strict=True)):
        axes[3].plot(t, record.wrenches[:, foot, 2] / weight, color=colour, linewidth=0.9, label=f"{name} foot")
        axes[3].plot(t, record.planned_wrenches[:, foot, 2] / weight, ":", color=colour, linewidth=0.9, label="... QP")
    axes[3].set_ylabel("force / weight [-]", fontsize=8)
    _draw_worst(
        axes[4], record, np.degrees(record.command_q - record.joint_q, dtype=np.float64), "command - joint [deg]"
    )
    _draw_worst(axes[5], record, record.joint_tau.astype(float) / model.tau_max, "torque / limit [-]")
    _draw_status(axes[6], record)
    for one in axes:
        for time, _ in record.events:
            one.axvline(time, color="0.6", linewidth=0.8, zorder=0)
        one.set_xlim(t[0], max(t[-1], t[0] + 1e-3))
        one.grid(alpha=0.3)
        one.tick_params(labelsize=8)
        if one.get_legend_handles_labels()[0]:
            one.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=7, frameon=False)
    axes[-1].set_xlabel("t [s]")
    events = [f"{time:.2f} s {text[:120]}" for time, text in record.events]
    figure.suptitle("\n".join([f"{record.robot}: {record.reason[:120]}", *events[-8:]]), fontsize=9)
    figure.savefig(file, dpi=100)
    return file


def _draw_worst(axes: Axes, record: BlackBoxRecord, values: Matrix, label: str) -> None:
    """The joints with the largest values (n, nj)."""
    largest = np.nan_to_num(np.abs(values)).max(axis=0)
    for joint in np.argsort(-largest, kind="stable")[:JOINTS]:
        name = record.joint_names[joint].removesuffix("_joint")
        axes.plot(record.t, values[:, joint], linewidth=0.8, label=name)
    axes.set_ylabel(label, fontsize=8)


def _draw_status(axes: Axes, record: BlackBoxRecord) -> None:
    """Solver status, better ones higher, the lowest for no command; and the modes."""
    statuses = list(SolveStatus)
    levels = ["none", *(status.value.replace("_", " ") for status in reversed(statuses))]
    heights = np.where(record.status < 0, 0, len(statuses) - record.status)
    axes.step(record.t, heights, where="post", color="k", linewidth=1.0)
    axes.set_yticks(range(len(levels)), levels, fontsize=7)
    axes.set_ylim(-0.5, len(levels) - 0.5)
    modes = record.modes
    for i in [i for i in range(len(modes)) if i == 0 or modes[i] is not modes[i - 1]]:
        axes.text(record.t[i], 0.2, f" {modes[i].value}", fontsize=7, color="0.3")
