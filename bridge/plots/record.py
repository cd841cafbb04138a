"""Pictures of a recording: balance, torques, walk, and tick timing."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bridge.plots import new_figure, plot_run
from bridge.plots.walk import plot_walk
from bridge.record.recording import Recording
from bridge.record.run_file import RecordedRun
from bridge.record.run_topics import EVENTS
from bridge.stability import analyse
from models.constants import GRAVITY, NANOSECONDS
from models.errors import PoiseError
from models.nodes import topics
from models.types import FOOT_NAMES, Mode

ROWS = 3000  #: Maximum number of rows for balance and torques
_MS = 1e-6  #: Of a nanosecond [ms]


def plot_record(run: RecordedRun, folder: Path) -> list[Path]:
    """Draw a recording into ``folder``; returns the files. ``PoiseError`` when there is nothing to draw."""
    recording = as_recording(run)
    files = plot_run(run.robot, recording, analyse(run.robot, recording), folder)
    walks = [stamp for stamp, topic, text in run.texts if topic == topics.MODE and text == Mode.WALK.value]
    if walks and (recording.t > walks[0] / NANOSECONDS).sum() > 1:
        files.append(plot_walk(run.robot, recording.between(walks[0] / NANOSECONDS, np.inf), folder))
    return [_overview(run, folder / "record.png"), *files]


def as_recording(run: RecordedRun) -> Recording:
    """Some rows of a recording with the true base where the simulator published it, otherwise the estimated one.

    Raises ``PoiseError`` when no odometry has sensors of the same stamp.
    """
    bases = run.truths or run.estimates
    stamps = sorted(set(bases) & set(run.joints))
    if not stamps:
        raise PoiseError("the recording holds no odometry with joint samples of the same stamp: nothing to draw")
    stamps = stamps[:: -(-len(stamps) // ROWS)]
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


def _overview(run: RecordedRun, file: Path) -> Path:
    """Loads, torques near their limits, modes, time between samples, and ticks without an answer."""
    figure = new_figure(13.0, 10.0)
    loads, torques, modes, steps, missing = (figure.add_subplot(5, 1, i + 1) for i in range(5))
    stamps = np.array(sorted(run.joints))
    t, weight = stamps / NANOSECONDS, run.robot.mass * GRAVITY
    for foot, name in enumerate(FOOT_NAMES):
        kept = run.feet[foot]
        at = np.array(sorted(kept))
        if at.size:
            loads.plot(at / NANOSECONDS, [kept[s][2] / weight for s in at], linewidth=0.8, label=f"{name} foot")
    loads.set_ylabel("force / weight [-]", fontsize=8)
    used = np.array([np.abs(run.joints[s][3]) / run.robot.tau_max for s in stamps])  # (n, nj)
    for joint in np.argsort(-used.max(axis=0), kind="stable")[:5]:
        torques.plot(t, used[:, joint], linewidth=0.7, label=run.robot.joint_names[joint].removesuffix("_joint"))
    torques.set_ylabel("torque / limit [-]", fontsize=8)
    names = [mode.value for mode in Mode]
    found = [(s / NANOSECONDS, names.index(text)) for s, topic, text in run.texts if topic == topics.MODE]
    if found:
        times, levels = zip(*found, (t[-1], found[-1][1]), strict=True)
        modes.step(times, levels, where="post", color="k", linewidth=1.0)
    modes.set_yticks(range(len(names)), names, fontsize=7)
    modes.set_ylabel("mode", fontsize=8)
    steps.plot(t[1:], np.diff(stamps) * _MS, ".", markersize=2, label=f"{run.lost} samples lost")
    steps.set_ylabel("between\nsamples [ms]", fontsize=8)
    answered = np.array(sorted(run.commands))
    if answered.size > 1:
        missing.plot(answered[1:] / NANOSECONDS, np.diff(answered) * _MS, ".", markersize=2)
    missing.set_ylabel("between\ncommands [ms]", fontsize=8)
    for one in (loads, torques, modes, steps, missing):
        one.set_xlim(t[0], max(t[-1], t[0] + 1e-3))
        one.grid(alpha=0.3)
        one.tick_params(labelsize=8)
        if one.get_legend_handles_labels()[0]:
            one.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=7, frameon=False)
    missing.set_xlabel("t [s]")
    figure.savefig(file, dpi=100)
    return file
