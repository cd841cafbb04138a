"""Pictures of a run, a recording or a black box: balance, footsteps, torques, sensors, commands and timing."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from bridge.analysis.stability import Stability, analyse
from bridge.record.mcap_log import EVENTS
from bridge.record.recording import Recording
from bridge.record.render import DONE
from controllers.recording.black_box_file import BlackBoxRecord
from models.constants import FOOT_NAMES, GRAVITY, NANOSECONDS
from models.errors import PoiseError
from models.nodes import topics
from models.robot_model import RobotModel
from models.types import Matrix, Mode, SolveStatus, Vector

if TYPE_CHECKING:
    from bridge.record.run_file import RecordedRun


COLOURS = {"CoM": "#1b6ca8", "DCM": "#d1495b", "ZMP": "#66a182"}


def new_figure(width: float, height: float) -> Figure:
    """Empty figure of a size [inch], without a display."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def plot_run(model: RobotModel, recording: Recording, stability: Stability, folder: Path) -> list[Path]:
    """Draw the plots of one run into ``folder`` and return the files; ``stability`` is the result of ``analyse``."""
    folder.mkdir(parents=True, exist_ok=True)
    balance, torques = folder / "balance.png", folder / "torques.png"
    _balance(model, recording, stability).savefig(balance, dpi=110)
    _torques(model, recording).savefig(torques, dpi=110)
    return [balance, torques]


NEAR = 0.02  #: Maximum time between two events that share a label, as a fraction of the plotted time [-]


def _mark_events(axes: Axes, recording: Recording, *, text: bool = False) -> None:
    """Draw the events as lines; with ``text``, also their names. Events at nearly the same time share a label."""
    labels: list[tuple[float, list[str]]] = []
    for time, name in recording.events:
        axes.axvline(time, color="0.75", linewidth=0.8, zorder=0)
        if text and not name.endswith(DONE):
            if not labels or time - labels[-1][0] > NEAR * np.ptp(recording.t):
                labels.append((time, []))
            labels[-1][1].append(name)
    for time, names in labels:
        axes.annotate("\n".join(names), (time, 1.0), xycoords=("data", "axes fraction"), rotation=30.0, fontsize=7)


def _balance(model: RobotModel, recording: Recording, stability: Stability) -> Figure:
    figure = new_figure(14.0, 7.0)
    grid = figure.add_gridspec(2, 2, width_ratios=[1.0, 1.2])
    series = {"ZMP": stability.zmp, "DCM": stability.dcm, "CoM": stability.com[:, :2]}
    above = figure.add_subplot(grid[:, 0])
    for foot, outline in footsteps(model, recording):
        above.fill(outline[:, 0], outline[:, 1], facecolor=("#cfe3f1", "#f6d9dc")[foot], edgecolor="0.5", linewidth=0.5)
    for name, values in series.items():
        above.plot(values[:, 0], values[:, 1], color=COLOURS[name], linewidth=0.7, label=name)
    if recording.estimate is not None:
        above.plot(*recording.estimate[:, :2].T, "k:", linewidth=0.9, label="base, estimated")
        above.plot(*recording.q[:, :2].T, "k", linewidth=0.7, label="base, true")
    above.set_aspect("equal")
    above.locator_params(axis="x", nbins=6)
    above.set_xlabel("x [m]")
    above.set_ylabel("y [m]")
    above.legend(loc="best", fontsize=8)
    above.set_title("footsteps from above: left blue, right red", fontsize=9)
    for row, axis in enumerate("xy"):
        axes = figure.add_subplot(grid[row, 1])
        _mark_events(axes, recording, text=row == 0)
        for name, values in series.items():
            axes.plot(stability.t, values[:, row], color=COLOURS[name], linewidth=0.8, label=name)
        axes.set_ylabel(f"{axis} [m]")
        axes.margins(x=0.0)
    axes.set_xlabel("t [s]")
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


LANDED = 0.5  #: Fraction of the weight on a foot from which it counts as a footstep [-]


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
    """Draw the walking part of a run; returns the file."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "walk.png"
    _balance(model, recording, analyse(model, recording)).savefig(file, dpi=110)
    return file


RECORD_ROWS, BOX_ROWS = 3000, 1000  #: Maximum number of rows for balance and torques
JOINTS = 5  #: Number of joints drawn: farthest from the command, or nearest to the torque limit
_COLOURS = ("#7b4fa3", "#c98a1b")  #: Colours of left and right foot
_MS = 1e-6  #: One nanosecond [ms]


def plot_record(run: RecordedRun, folder: Path) -> list[Path]:
    """Draw a recording into ``folder``; returns the files. ``PoiseError`` when there is nothing to draw."""
    recording = as_recording(run)
    files = plot_run(run.robot, recording, analyse(run.robot, recording), folder)
    walks = [stamp for stamp, topic, text in run.texts if topic == topics.MODE and text == Mode.WALK.value]
    if walks and (recording.t > walks[0] / NANOSECONDS).sum() > 1:
        files.append(plot_walk(run.robot, recording.between(walks[0] / NANOSECONDS, np.inf), folder))
    return [_record_overview(run, folder / "record.png"), *files]


def as_recording(run: RecordedRun) -> Recording:
    """Rows of a recording with the true base, or the estimated base without it; ``PoiseError`` without either."""
    bases = run.truths or run.estimates
    stamps = sorted(set(bases) & set(run.joints))
    if not stamps:
        raise PoiseError("the recording holds no odometry with joint samples of the same stamp: nothing to draw")
    stamps = stamps[:: -(-len(stamps) // RECORD_ROWS)]
    nothing = np.zeros(6)
    joints = [run.joints[stamp] for stamp in stamps]
    found = sorted(set(stamps) & set(run.estimates)) == stamps
    return Recording(
        robot=run.robot.name,
        t=np.array(stamps) / NANOSECONDS,
        q=np.array([np.r_[bases[s][0], q] for s, (_, q, _, _) in zip(stamps, joints, strict=True)]),
        v=np.array([np.r_[bases[s][1], v] for s, (_, _, v, _) in zip(stamps, joints, strict=True)]),
        tau=np.array([tau for *_, tau in joints]),
        wrenches=np.array([[foot.get(s, nothing) for foot in run.feet] for s in stamps]),
        events=tuple((stamp / NANOSECONDS, _label(topic, text)) for stamp, topic, text in run.texts),
        estimate=np.array([run.estimates[s][0] for s in stamps]) if found else None,
    )


def _label(topic: str, text: str) -> str:
    return text if topic in (EVENTS, topics.HUMANOID_COMMANDS) else f"mode {text}"


def _stacked(count: int, height: float) -> tuple[Figure, list[Axes]]:
    figure = new_figure(13.0, height)
    return figure, [figure.add_subplot(count, 1, i + 1) for i in range(count)]


def _finish(figure: Figure, axes: Sequence[Axes], t: Vector, file: Path) -> Path:
    for one in axes:
        one.set_xlim(t[0], max(t[-1], t[0] + 1e-3))
        one.grid(alpha=0.3)
        one.tick_params(labelsize=8)
        one.yaxis.label.set_fontsize(8)
        if one.get_legend_handles_labels()[0]:
            one.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=7, frameon=False)
    axes[-1].set_xlabel("t [s]")
    figure.savefig(file, dpi=100)
    return file


def _draw_largest(axes: Axes, t: Vector, values: Matrix, names: Sequence[str], label: str) -> None:
    largest = np.nan_to_num(np.abs(values)).max(axis=0)
    for joint in np.argsort(-largest, kind="stable")[:JOINTS]:
        axes.plot(t, values[:, joint], linewidth=0.8, label=names[joint].removesuffix("_joint"))
    axes.set_ylabel(label)


def _record_overview(run: RecordedRun, file: Path) -> Path:
    figure, axes = _stacked(5, 10.0)
    loads, torques, modes, steps, missing = axes
    stamps = np.array(sorted(run.joints))
    t, weight = stamps / NANOSECONDS, run.robot.mass * GRAVITY
    for kept, name in zip(run.feet, FOOT_NAMES, strict=True):
        at = np.array(sorted(kept))
        if at.size:
            loads.plot(at / NANOSECONDS, [kept[s][2] / weight for s in at], linewidth=0.8, label=f"{name} foot")
    loads.set_ylabel("force / weight [-]")
    used = np.array([np.abs(run.joints[s][3]) / run.robot.tau_max for s in stamps])  # (n, nj)
    _draw_largest(torques, t, used, run.robot.joint_names, "torque / limit [-]")
    names = [mode.value for mode in Mode]
    found = [(s / NANOSECONDS, names.index(text)) for s, topic, text in run.texts if topic == topics.MODE]
    if found:
        times, levels = zip(*found, (t[-1], found[-1][1]), strict=True)
        modes.step(times, levels, where="post", color="k", linewidth=1.0)
    modes.set_yticks(range(len(names)), names, fontsize=7)
    modes.set_ylabel("mode")
    steps.plot(t[1:], np.diff(stamps) * _MS, ".", markersize=2, label=f"{run.lost} samples lost")
    steps.set_ylabel("between\nsamples [ms]")
    answered = np.array(sorted(run.commands))
    if answered.size > 1:
        missing.plot(answered[1:] / NANOSECONDS, np.diff(answered) * _MS, ".", markersize=2)
    missing.set_ylabel("between\ncommands [ms]")
    return _finish(figure, axes, t, file)


def plot_black_box(model: RobotModel, record: BlackBoxRecord, folder: Path) -> list[Path]:
    """Draw a black box into ``folder``; returns the files. ``PoiseError`` for an empty one or another robot."""
    if record.joint_names != model.joint_names:
        raise PoiseError(f"the black box is of a robot '{record.robot}' with other joints than '{model.name}'")
    if len(record.t) == 0:
        raise PoiseError("the black box is empty")
    recording = _recording(record)
    files = plot_run(model, recording, analyse(model, recording), folder)
    return [_box_overview(model, record, folder / "black_box.png"), *files]


def _recording(record: BlackBoxRecord) -> Recording:
    arrays = (record.t, record.q, record.v, record.joint_tau, record.wrenches)
    t, q, v, tau, wrenches = (array[:: -(-len(record.t) // BOX_ROWS)].astype(float) for array in arrays)
    return Recording(record.robot, t, q, v, tau, wrenches, record.events)


def _box_overview(model: RobotModel, record: BlackBoxRecord, file: Path) -> Path:
    figure, axes = _stacked(7, 13.0)
    t, weight = record.t, model.mass * GRAVITY
    x, y = record.q[:, 3:5].T
    tilt = np.degrees(np.arccos(np.clip(1.0 - 2.0 * (x * x + y * y), -1.0, 1.0)))
    axes[0].plot(t, tilt, color="k", linewidth=1.0, label="base")
    axes[0].set_ylabel("tilt [deg]")
    for k, name in enumerate("xyz"):
        axes[1].plot(t, record.gyro[:, k], linewidth=0.7, label=f"gyro {name}")
        axes[2].plot(t, record.accel[:, k], linewidth=0.7, label=f"accel {name}")
    axes[1].set_ylabel("rate [rad/s]")
    axes[2].set_ylabel("specific force\n[m/s^2]")
    for foot, (name, colour) in enumerate(zip(FOOT_NAMES, _COLOURS, strict=True)):
        axes[3].plot(t, record.wrenches[:, foot, 2] / weight, color=colour, linewidth=0.9, label=f"{name} foot")
        axes[3].plot(t, record.planned_wrenches[:, foot, 2] / weight, ":", color=colour, linewidth=0.9, label="... QP")
    axes[3].set_ylabel("force / weight [-]")
    error = np.degrees(record.command_q - record.joint_q, dtype=np.float64)
    _draw_largest(axes[4], t, error, record.joint_names, "command - joint [deg]")
    used = record.joint_tau.astype(float) / model.tau_max
    _draw_largest(axes[5], t, used, record.joint_names, "torque / limit [-]")
    _draw_status(axes[6], record)
    for one in axes:
        for time, _ in record.events:
            one.axvline(time, color="0.6", linewidth=0.8, zorder=0)
    events = [f"{time:.2f} s {text[:120]}" for time, text in record.events]
    figure.suptitle("\n".join([f"{record.robot}: {record.reason[:120]}", *events[-8:]]), fontsize=9)
    return _finish(figure, axes, t, file)


def _draw_status(axes: Axes, record: BlackBoxRecord) -> None:
    """Draw the modes and the solver status: a better status is higher, the lowest value means no command."""
    statuses = list(SolveStatus)
    levels = ["none", *(status.value.replace("_", " ") for status in reversed(statuses))]
    heights = np.where(record.status < 0, 0, len(statuses) - record.status)
    axes.step(record.t, heights, where="post", color="k", linewidth=1.0)
    axes.set_yticks(range(len(levels)), levels, fontsize=7)
    axes.set_ylim(-0.5, len(levels) - 0.5)
    modes = record.modes
    for i in [i for i in range(len(modes)) if i == 0 or modes[i] is not modes[i - 1]]:
        axes.text(record.t[i], 0.2, f" {modes[i].value}", fontsize=7, color="0.3")
