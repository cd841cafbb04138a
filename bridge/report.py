"""Judges a recorded demonstration and reports it: checks, how stable, how fast."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from bridge.demo_config import DemoConfig
from bridge.recording import Recording
from bridge.stability import Stability, analyse, stability_figures
from models.robot_model import RobotModel
from models.types import Matrix, Vector

LABELS = {
    "com_drift_m": ("CoM drift, end against beginning", 1e3, "mm"),
    "dcm_excursion_max_m": ("largest DCM excursion", 1e3, "mm"),
    "capture_margin_min_m": ("smallest capture margin", 1e3, "mm"),
    "sole_motion_max_m": ("largest motion of a sole", 1e3, "mm"),
    "walked_m": ("walked", 1.0, "m"),
    "drift_m": ("drift of the estimate, walking", 1e2, "cm"),
    "drift_percent": ("... of the distance", 1.0, "%"),
    "closure_m": ("end of the square from its beginning", 1e2, "cm"),
    "latency_us_p50": ("sensors to command, p50", 1e-3, "ms"),
    "latency_us_p99": ("sensors to command, p99", 1e-3, "ms"),
    "latency_us_max": ("sensors to command, largest", 1e-3, "ms"),
    "tick_us_p50": ("whole-body tick, p50", 1e-3, "ms"),
    "tick_us_p99": ("whole-body tick, p99", 1e-3, "ms"),
    "missed_percent": ("ticks missed", 1.0, "%"),
    "real_time_factor": ("simulated over real time", 1.0, ""),
}
"""What each figure is called, its factor and the unit it is shown in."""


@dataclass(frozen=True, slots=True)
class Check:
    """One thing that had to happen.

    Attributes:
        name: What.
        passed: Whether it did.
        detail: The number that shows it, or what went wrong.
    """

    name: str
    passed: bool
    detail: str


def judge(model: RobotModel, recording: Recording, config: DemoConfig) -> tuple[list[Check], Stability]:
    """Check in the true motion of the robot that everything which was asked for happened.

    Args:
        model: The robot.
        recording: The run; its events carry the names of the motions and ``push``.
        config: What counts as done.

    Returns:
        One check per motion, one for the push, one for standing, and the balance of the run.
    """
    stability = analyse(model, recording)
    figures = stability_figures(stability, config.pause)
    starts = {text.split()[0]: time for time, text in reversed(recording.events)}  # the first of each name
    ends = sorted([*(time for time, _ in recording.events), float(recording.t[-1])])
    checks = []
    for name in (*config.motions, "push"):
        if name not in starts:
            checks.append(Check(name, False, "did not happen"))
            continue
        end = next((time for time in ends if time > starts[name]), ends[-1])
        during = (recording.t >= starts[name]) & (recording.t <= end)
        checks.append(_judge_part(model, recording, stability, during, name, config))
    height = recording.q[:, 2]
    sunk = abs(float(height[-1] - height[0]))
    drift, moved = figures["com_drift_m"], figures["sole_motion_max_m"]
    still = drift < config.com_drift_limit and moved < config.foot_limit and sunk < config.height_tolerance
    detail = f"CoM {1e3 * drift:.1f} mm, soles {1e3 * moved:.1f} mm, height {1e3 * sunk:.1f} mm off at the end"
    return [Check("stand", still, detail), *checks], stability


def judge_speed(figures: dict[str, float], config: DemoConfig) -> Check:
    """Check that the scenario ran in real time; ``figures`` holds ``real_time_factor``, NaN when it was not ended."""
    factor = figures["real_time_factor"]
    return Check("real time", factor >= config.real_time_min, f"{factor:.2f} of real time")


def _judge_part(
    model: RobotModel, recording: Recording, stability: Stability, during: Any, name: str, config: DemoConfig
) -> Check:
    """Check one motion or the push within its part of the run."""
    if name == "wave":
        travel = hand_travel(model, recording.q[during])
        return Check(name, travel > config.hand_travel, f"hand moved {100 * travel:.0f} cm")
    if name == "squat":
        depth = float(recording.q[0, 2] - recording.q[during, 2].min())
        return Check(name, depth > config.squat_depth, f"pelvis sank {100 * depth:.0f} cm")
    if name == "push":
        before = stability.dcm[during][0]
        excursion = float(np.linalg.norm(stability.dcm[during] - before, axis=1).max())
        impulse = float(np.linalg.norm(config.push_force)) * config.push_duration
        upright = not fell(recording.q[during], recording.q[0, 2])
        detail = f"{impulse:.0f} N.s, DCM moved {100 * excursion:.1f} cm"
        return Check(name, upright and excursion > config.push_excursion, detail)
    moved = float(np.abs(recording.q[during, 7:] - recording.q[during][0, 7:]).max())
    return Check(name, moved > 0.0, f"a joint moved {moved:.2f} rad")


def fell(configurations: Matrix, height: float) -> bool:
    """Whether the base of a robot that stood at a height [m] has ever been on its knees or lower."""
    return bool((configurations[:, 2] <= 0.7 * height).any())


def hand_travel(model: RobotModel, configurations: Matrix) -> float:
    """How far the hand that moved more has moved relative to the base [m]."""
    return max(_travel(model, configurations, wrist) for wrist in ("l_wrist", "r_wrist"))


def _travel(model: RobotModel, configurations: Vector, frame: str) -> float:
    """Diagonal of the box that the origin of a frame fills in the base frame [m]."""
    data, base, moving = model.data(), model.frame_id("base_link"), model.frame_id(frame)
    points = np.empty((len(configurations), 3))
    for i, q in enumerate(configurations):
        pin.framesForwardKinematics(model.pin, data, q)
        points[i] = data.oMf[base].actInv(data.oMf[moving]).translation
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def print_report(
    console: Console, robot: str, checks: list[Check], stable: dict[str, float], fast: dict[str, float]
) -> None:
    """Print the checks and both groups of figures."""
    table = Table(title=f"{robot}: what happened", title_justify="left")
    for column in ("", "", ""):
        table.add_column(column)
    for check in checks:
        word = "[green]done[/green]" if check.passed else "[red]failed[/red]"
        table.add_row(check.name, word, escape(check.detail))
    table.show_header = False
    console.print(table)
    for title, figures in (("how stable", stable), ("how fast", fast)):
        table = Table(title=title, title_justify="left", show_header=False)
        table.add_column()
        table.add_column(justify="right")
        for name, value in figures.items():
            label, factor, unit = LABELS.get(name, (name, 1.0, ""))
            table.add_row(label, f"{factor * value:.3g} {unit}".strip() if math.isfinite(value) else "-")
        console.print(table)


def write_report(
    file: Path, robot: str, checks: list[Check], stable: dict[str, float], fast: dict[str, float], passed: bool
) -> None:
    """Write everything that ``print_report`` shows as JSON; numbers that are not finite become null."""
    figures = {name: value if math.isfinite(value) else None for name, value in {**stable, **fast}.items()}
    listed = [{"name": check.name, "passed": check.passed, "detail": check.detail} for check in checks]
    report = {"robot": robot, "passed": passed, "checks": listed, "figures": figures}
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
