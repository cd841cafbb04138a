"""Measures and report of ``poise demo``."""

import json
import math
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from rich.console import Console
from rich.markup import escape
from rich.table import Column, Table

from bridge.analysis.stability import Stability, analyse, stability_figures
from bridge.demo.stage import PUSH, STOP, WALK, WAVE, DemoConfig
from bridge.record.recording import Recording, sole_middle
from bridge.record.render import DONE
from models.constants import GRAVITY
from models.heading import heading, turned
from models.nodes.realtime import end_within
from models.nodes.spin import END_TIME
from models.robot_model import RobotModel
from models.types import Matrix, Vector

#: Label, factor and unit of each figure
LABELS = {
    "com_drift_m": ("CoM drift, end against beginning", 1e3, "mm"),
    "dcm_excursion_max_m": ("largest DCM excursion", 1e3, "mm"),
    "capture_margin_min_m": ("smallest capture margin", 1e3, "mm"),
    "sole_motion_max_m": ("largest motion of a sole", 1e3, "mm"),
    "walked_m": ("walked", 1.0, "m"),
    "drift_m": ("drift of the estimate, walking", 1e2, "cm"),
    "drift_percent": ("... of the distance", 1.0, "%"),
    "closure_m": ("distance of the end of the square from its start", 1e2, "cm"),
    "latency_us_p50": ("sensors to command, p50", 1e-3, "ms"),
    "latency_us_p99": ("sensors to command, p99", 1e-3, "ms"),
    "latency_us_max": ("sensors to command, largest", 1e-3, "ms"),
    "tick_us_p50": ("whole-body tick, p50", 1e-3, "ms"),
    "tick_us_p99": ("whole-body tick, p99", 1e-3, "ms"),
    "missed_percent": ("clock periods without a tick", 1.0, "%"),
    "map_rmse_m": ("map under a sole before it lands, RMSE", 1e3, "mm"),
    "map_known": ("... known share", 1e2, "%"),
    "foothold_along_max_m": ("error of a sole from its planned foothold, along the way, largest", 1e2, "cm"),
    "foothold_across_max_m": ("... across", 1e2, "cm"),
    "light_to_foothold_s_median": ("range measurement to foothold, median, robot time", 1e3, "ms"),
    "light_to_foothold_s_max": ("range measurement to foothold, largest", 1e3, "ms"),
    "real_time_factor": ("ratio of simulated to real time", 1.0, ""),
}

CPU = "cpu_"  #: Prefix of the figures of processor time over robot time, one for each process
SLOW = 0.9  #: Ratio of simulated to real time below which the report gives the cause [-]


@dataclass(frozen=True, slots=True)
class Check:
    """One criterion; ``detail`` is the measured value, or the cause of the failure."""

    name: str
    passed: bool
    detail: str


def judge(model: RobotModel, recording: Recording, config: DemoConfig) -> tuple[list[Check], Stability]:
    """Check motions, push and standing by the true motion of the robot; returns the checks and the balance."""
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


def judge_speed(figures: dict[str, float]) -> Check:
    """Report the ratio of simulated to real time, NaN when the scenario did not end; a slow machine is no failure."""
    factor = figures["real_time_factor"]
    if math.isnan(factor):
        return Check("real time", False, "did not happen")
    cause = "; simulated time waited: the processor is slow, or other programs used it" if factor < SLOW else ""
    return Check("real time", True, f"{factor:.2f} of real time{cause}")


def _judge_part(
    model: RobotModel, recording: Recording, stability: Stability, during: Any, name: str, config: DemoConfig
) -> Check:
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
    """Whether the base was ever at knee height or lower; ``height`` is the standing height [m]."""
    return bool((configurations[:, 2] <= 0.7 * height).any())


def hand_travel(model: RobotModel, configurations: Matrix) -> float:
    """Travel of the more active hand relative to the base [m]."""
    return max(_travel(model, configurations, wrist) for wrist in ("l_wrist", "r_wrist"))


def _travel(model: RobotModel, configurations: Vector, frame: str) -> float:
    """Diagonal of the bounding box of a frame's origin in the base frame [m]."""
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
    table = Table("check", "result", "measured", title=f"{robot}: checks", title_justify="left")
    for check in checks:
        word = "[green]done[/green]" if check.passed else "[red]failed[/red]"
        table.add_row(check.name, word, escape(check.detail))
    console.print(table)
    for title, figures in (("stability", stable), ("speed", fast)):
        table = Table("figure", Column("value", justify="right"), title=title, title_justify="left")
        for name, value in figures.items():
            label, factor, unit = LABELS.get(name, (name, 1.0, ""))
            if name.startswith(CPU):
                label, factor, unit = f"processor, {name.removeprefix(CPU)}", 1e2, "% of a core at real time"
            table.add_row(label, f"{factor * value:.3g} {unit}".strip() if math.isfinite(value) else "-")
        console.print(table)


def write_report(
    file: Path, robot: str, checks: list[Check], stable: dict[str, float], fast: dict[str, float], passed: bool
) -> None:
    """Write the content of ``print_report`` as JSON; numbers that are not finite become null."""
    figures = {name: value if math.isfinite(value) else None for name, value in {**stable, **fast}.items()}
    listed = [{"name": check.name, "passed": check.passed, "detail": check.detail} for check in checks]
    report = {"robot": robot, "passed": passed, "checks": listed, "figures": figures}
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")


def conclude(
    console: Console,
    out: Path,
    robot: str,
    checks: list[Check],
    stable: dict[str, float],
    fast: dict[str, float],
    ending: ExitStack,
) -> int:
    """Print and write the report, then close ``ending`` (the middleware), which may block; returns the exit code."""
    passed = all(check.passed for check in checks)
    print_report(console, robot, checks, stable, fast)
    write_report(out / "report.json", robot, checks, stable, fast, passed)
    console.print(f"[dim]report: {out / 'report.json'}[/dim]", highlight=False)
    cancel = end_within(END_TIME, int(not passed))
    ending.close()
    cancel()
    return int(not passed)


def judge_walk(model: RobotModel, recording: Recording, config: DemoConfig) -> tuple[list[Check], dict[str, float]]:
    """Check the walk along the square with all its steps, and measure the drift.

    ``recording`` begins at the event ``walk``. Returns the checks of the square, the wave and the push during the walk,
    the stop and the drift; and the figures ``walked_m``, ``drift_m`` (difference of true and estimated displacement
    from start to end), ``drift_percent`` of the distance, and ``closure_m``.
    """
    data = model.data()
    places = np.array([sole_middle(model, data, q) for q in recording.q])  # (n, 3)
    figures = _distances(recording, places)
    turn = float(np.unwrap(places[:, 2])[-1] - places[0, 2])
    size = np.ptp(_seen_from(places[0], places), axis=0)
    walked, closure = figures["walked_m"], figures["closure_m"]
    square = (
        closure < config.closure_limit
        and abs(turn - 2.0 * np.pi) < config.turn_tolerance
        and bool((size > 0.8 * config.square_side).all())  # 0.8 accepts rounded corners and detects a missing side
    )
    detail = f"{walked:.2f} m and {np.degrees(turn):.0f} deg; end {100 * closure:.1f} cm from the start"
    checks = [Check(WALK, square and not fell(recording.q, recording.q[0, 2]), detail)]
    rest = places[recording.t >= recording.t[-1] - config.pause, :2]
    judges: dict[str, Callable[[Recording], tuple[bool, str]]] = {
        WAVE: lambda part: _judge_wave(model, part, config),
        PUSH: lambda part: _judge_push(model, part, recording.q[0, 2], config),
        STOP: lambda part: _judge_stop(rest, config),
    }
    for name, judged in judges.items():
        part = _part(recording, name)
        checks.append(Check(name, *((False, "did not happen") if part is None else judged(part))))
    drift, share = figures["drift_m"], figures["drift_percent"]
    text = f"estimate {100 * drift:.1f} cm off after {walked:.2f} m: {share:.2f} %"
    checks.append(Check("drift", share < 100.0 * config.drift_limit, text))
    return checks, figures


def _distances(recording: Recording, places: Matrix) -> dict[str, float]:
    steps = np.linalg.norm(np.diff(places[:, :2][::50], axis=0), axis=1)  # every half second, to exclude the sway
    walked = float(steps.sum())
    drift = np.nan
    if recording.estimate is not None:
        true, text = recording.q[:, :7], recording.estimate
        ways = [_seen_from(np.array([*rows[0, :2], heading(*rows[0, 3:7])]), rows[-1:, :2])[0] for rows in (true, text)]
        drift = float(np.linalg.norm(ways[0] - ways[1]))
    return {
        "walked_m": walked,
        "drift_m": drift,
        "drift_percent": 100.0 * drift / walked if walked > 0.0 else np.nan,
        "closure_m": float(np.linalg.norm(places[-1, :2] - places[0, :2])),
    }


def _seen_from(place: Vector, points: Matrix) -> Matrix:
    """Transform points (n, >= 2) to the frame of a place (x, y, heading); returns (n, 2) [m]."""
    return turned(points[:, :2] - place[:2], -place[2])


def _part(recording: Recording, name: str) -> Recording | None:
    """Part of a recording from an event to the next one, or to the end; None without the event."""
    starts = [time for time, text in recording.events if text.startswith(name)]
    if not starts:
        return None
    done = [time for time, text in recording.events if text == f"{name} {DONE}"]
    ends = done or [time for time, _ in recording.events if time > starts[0]]
    return recording.between(starts[0], min(ends, default=np.inf))


def _judge_wave(model: RobotModel, part: Recording, config: DemoConfig) -> tuple[bool, str]:
    travel = hand_travel(model, part.q)
    loaded = part.wrenches[:, :, 2] > 0.5 * model.mass * GRAVITY  # (n, 2)
    steps = int((loaded[1:] & ~loaded[:-1]).sum())
    text = f"hand moved {100 * travel:.0f} cm during {steps} footsteps"
    return travel > config.walk_hand_travel and steps >= config.walk_wave_steps, text


def _judge_push(model: RobotModel, part: Recording, height: float, config: DemoConfig) -> tuple[bool, str]:
    impulse = abs(config.walk_push) * model.mass
    shown = part.between(part.t[0], part.t[0] + 0.5)  # half a second: the push has ended and is not yet compensated
    speeds = np.linalg.norm(analyse(model, shown).com_velocity[:, :2], axis=1)
    rise = float(speeds.max() - speeds[0])
    text = f"{impulse:.0f} N.s, CoM {rise:.2f} m/s faster, walk continued"
    return not fell(part.q, height) and rise > 0.3 * abs(config.walk_push), text


def _judge_stop(rest: Matrix, config: DemoConfig) -> tuple[bool, str]:
    moved = float(np.ptp(rest, axis=0).max())
    return moved < config.foot_limit, f"soles moved {1e3 * moved:.1f} mm in the last {config.pause:g} s"
