"""Judges the walking part of a recorded demonstration, by the true pose, and the estimate by it."""

from __future__ import annotations

import numpy as np

from bridge.demo_config import DemoConfig
from bridge.demo_walk import PUSH, STOP, WALK, WAVE
from bridge.recording import Recording, sole_middle
from bridge.render import DONE
from bridge.report import Check, fell, hand_travel
from bridge.stability import analyse
from models.constants import GRAVITY
from models.heading import heading, turned
from models.robot_model import RobotModel
from models.types import Matrix, Vector


def judge_walk(model: RobotModel, recording: Recording, config: DemoConfig) -> tuple[list[Check], dict[str, float]]:
    """Check that the square was walked with all that goes with it, and measure the drift.

    Args:
        model: The robot.
        recording: From the event ``walk`` to the end.
        config: What counts as done.

    Returns:
        Checks of the square, the wave and the push on it, the stop and the drift; and ``walked_m``, ``drift_m`` (true
        against estimated way from beginning to end), ``drift_percent`` of the distance, and ``closure_m``.
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
        and bool((size > 0.8 * config.square_side).all())  # 0.8: rounded corners, but all four sides
    )
    detail = f"{walked:.2f} m and {np.degrees(turn):.0f} deg; ends {100 * closure:.1f} cm from where it began"
    checks = [Check(WALK, square and not fell(recording.q, recording.q[0, 2]), detail)]
    checks.append(_judge_wave(model, recording, config))
    checks.append(_judge_push(model, recording, config))
    checks.append(_judge_stop(recording, places, config))
    drift, share = figures["drift_m"], figures["drift_percent"]
    told = f"estimate {100 * drift:.1f} cm off after {walked:.2f} m: {share:.2f} %"
    checks.append(Check("drift", share < 100.0 * config.drift_limit, told))
    return checks, figures


def _distances(recording: Recording, places: Matrix) -> dict[str, float]:
    """How far it went and how far off the estimate was at the end."""
    steps = np.linalg.norm(np.diff(places[:, :2][::50], axis=0), axis=1)  # every half second: sway is no way
    walked = float(steps.sum())
    drift = np.nan
    if recording.estimate is not None:
        true, told = recording.q[:, :7], recording.estimate
        ways = [_seen_from(np.array([*rows[0, :2], heading(*rows[0, 3:7])]), rows[-1:, :2])[0] for rows in (true, told)]
        drift = float(np.linalg.norm(ways[0] - ways[1]))
    return {
        "walked_m": walked,
        "drift_m": drift,
        "drift_percent": 100.0 * drift / walked if walked > 0.0 else np.nan,
        "closure_m": float(np.linalg.norm(places[-1, :2] - places[0, :2])),
    }


def _seen_from(place: Vector, points: Matrix) -> Matrix:
    """Points (n, >= 2) in the frame of a place (x, y, heading) (n, 2) [m]."""
    return turned(points[:, :2] - place[:2], -place[2])


def _part(recording: Recording, name: str) -> Recording | None:
    """From an event to the next one, or to the end; None where it did not happen."""
    starts = [time for time, text in recording.events if text.startswith(name)]
    if not starts:
        return None
    done = [time for time, text in recording.events if text == f"{name} {DONE}"]
    ends = done or [time for time, _ in recording.events if time > starts[0]]
    return recording.between(starts[0], min(ends, default=np.inf))


def _judge_wave(model: RobotModel, recording: Recording, config: DemoConfig) -> Check:
    part = _part(recording, WAVE)
    if part is None:
        return Check(WAVE, False, "did not happen")
    travel = hand_travel(model, part.q)
    loaded = part.wrenches[:, :, 2] > 0.5 * model.mass * GRAVITY  # (n, 2)
    steps = int((loaded[1:] & ~loaded[:-1]).sum())
    told = f"hand moved {100 * travel:.0f} cm during {steps} footsteps"
    return Check(WAVE, travel > config.walk_hand_travel and steps >= config.walk_wave_steps, told)


def _judge_push(model: RobotModel, recording: Recording, config: DemoConfig) -> Check:
    part = _part(recording, PUSH)
    if part is None:
        return Check(PUSH, False, "did not happen")
    impulse = abs(config.walk_push) * model.mass
    shown = part.between(part.t[0], part.t[0] + 0.5)  # within half a second the push is over and not yet made up for
    speeds = np.linalg.norm(analyse(model, shown).com_velocity[:, :2], axis=1)
    rise = float(speeds.max() - speeds[0])
    told = f"{impulse:.0f} N.s, CoM {rise:.2f} m/s faster, walked on"
    return Check(PUSH, not fell(part.q, recording.q[0, 2]) and rise > 0.3 * abs(config.walk_push), told)


def _judge_stop(recording: Recording, places: Matrix, config: DemoConfig) -> Check:
    part = _part(recording, STOP)
    if part is None:
        return Check(STOP, False, "did not happen")
    rest = places[recording.t >= recording.t[-1] - config.pause, :2]
    moved = float(np.ptp(rest, axis=0).max())
    return Check(STOP, moved < config.foot_limit, f"soles moved {1e3 * moved:.1f} mm in the last {config.pause:g} s")
