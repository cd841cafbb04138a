"""How each kind of case of the walking benchmark is measured."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any, TypeVar

import numpy as np

from benchmarks.commands import demand
from benchmarks.contender_loop import AnyLoop, ContenderLoop
from benchmarks.fall_signals import last_moments
from benchmarks.harness import Case
from benchmarks.walk_config import WalkConfig, robot_walk, walk_config
from benchmarks.walk_measure import Velocity, Walked, speed_error, tracking_error, watch
from bridge.closed_loop import ClosedLoop
from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.types import Matrix, Mode
from planners.gait.config import VelocityConfig
from planners.gait.scaling import load_gait_config


@cache
def _contested(robot: str, contender: str) -> ContenderLoop:
    """One loop for every case of a contender in this process."""
    return ContenderLoop(contender, robot, record_period_s=walk_config().record_period)


@cache
def _loop(robot: str) -> ClosedLoop:
    """One closed loop for every case of this process; its gait takes the fastest of the top speeds."""
    model = RobotModel.load(robot)
    gait = load_gait_config(model)
    forward = max(gait.velocity.forward, *robot_walk(robot).top_speeds)
    gait = replace(gait, velocity=replace(gait.velocity, forward=forward))
    return ClosedLoop(model, record=True, record_period_s=walk_config().record_period, gait=gait)


@cache
def _limits(robot: str) -> VelocityConfig:
    return load_gait_config(RobotModel.load(robot)).velocity


def _scores(loop: AnyLoop, walked: Walked, commands: Matrix, config: WalkConfig) -> Case:
    window = max(round(config.window / config.chunk), 1)
    weight = loop.robot.mass * GRAVITY
    return {
        "fell": loop.fallen,
        "reason": _reason(loop),
        "velocity": walked.mean.tolist(),
        "tracking_error": tracking_error(walked.velocities, commands, window),
        "cost_of_transport": walked.energy / (weight * walked.distance) if walked.distance > 0.1 else math.nan,
        "foot_slip": float(loop.foot_slip.max()),
        "moments": _moments(loop, loop.fallen),
    }


def _reason(loop: AnyLoop) -> str:
    what = loop.fall_reason or "; ".join(loop.faults)
    return f"{what} at {loop.t:.1f} s" if what else ""


def _moments(loop: AnyLoop, failed: bool) -> Case:
    """What explains a failed walk; empty for one that did not fail, and for a contender, whose log has too little."""
    return last_moments(loop, walk_config().shown) if failed and not isinstance(loop, ContenderLoop) else {}


def _run(loop: AnyLoop, duration: float) -> None:
    """Run for a time [s], or until the robot has fallen."""
    chunk = walk_config().chunk
    for _ in range(round(duration / chunk)):
        if not loop.fallen:
            loop.run(chunk)


L = TypeVar("L", bound=AnyLoop)


def _begin(loop: L, seed: int, command: Velocity, config: WalkConfig) -> L:
    """The robot of a loop, which has walked at a velocity for ``start_time``.

    Raises:
        PoiseError: It would not walk.
    """
    loop.reset(seed)
    demand(loop, "walk")
    loop.set_velocity(*command)
    _run(loop, config.start_time)
    return loop


def steady(robot: str, seed: int, command: Velocity, duration: float, contender: str = "") -> Case:
    """Hold one velocity.

    Returns:
        ``fell``, ``reason``, ``velocity`` (3,) [m/s, m/s, rad/s], ``speed_error`` [-], ``tracking_error`` [m/s],
        ``cost_of_transport`` [-], ``foot_slip`` [m], ``moments``: the last ones when it fell.

    Raises:
        PoiseError: The robot would not walk.
    """
    config = walk_config()
    loop: AnyLoop = _contested(robot, contender) if contender else _loop(robot)
    loop = _begin(loop, seed, command, config)
    walked = watch(loop, duration - config.start_time, config.chunk)
    commands = np.tile(command, (len(walked.velocities), 1))
    return {**_scores(loop, walked, commands, config), "speed_error": speed_error(walked.mean, command)}


def random_walk(robot: str, seed: int) -> Case:
    """A new velocity every ``random_period``; scores as of ``steady``, without ``speed_error``.

    Raises:
        PoiseError: The robot would not walk.
    """
    config, loop = walk_config(), _loop(robot)
    loop.reset(seed)
    demand(loop, "walk")
    limits = _limits(robot)
    low = config.random_share * np.array([-limits.backward, -limits.lateral, -limits.turn])
    high = config.random_share * np.array([limits.forward, limits.lateral, limits.turn])
    rng = np.random.default_rng(seed)
    parts, commands = [], []
    for _ in range(max(round(config.duration / config.random_period), 1)):
        command = rng.uniform(low, high)
        loop.set_velocity(*command)
        parts.append(watch(loop, config.random_period, config.chunk))
        commands.append(np.tile(command, (len(parts[-1].velocities), 1)))
        if loop.fallen or loop.mode is not Mode.WALK:
            break
    walked = Walked(
        np.vstack([part.velocities for part in parts]),
        sum(part.distance for part in parts),
        sum(part.energy for part in parts),
    )
    return _scores(loop, walked, np.vstack(commands), config)


def stop(robot: str, seed: int) -> Case:
    """Stop from a walk, then stand.

    Returns:
        ``fell``, ``reason``, ``steps`` after the command, ``stood`` in time, ``drift`` [m] of the base while standing,
        ``ok``, ``moments``: the last ones when it is not.

    Raises:
        PoiseError: The robot would not walk.
    """
    config = walk_config()
    loop = _begin(_loop(robot), seed, (config.stop_speed, 0.0, 0.0), config)
    _run(loop, max(config.stop_after - config.start_time, 0.0))
    steps = loop.gait.steps
    loop.command("stop")
    _run(loop, config.stop_limit)
    steps = loop.gait.steps - steps
    stood = loop.mode is Mode.STAND
    place, drift = loop.truth.q[:2].copy(), 0.0
    for _ in range(round(config.stand_time)):
        _run(loop, 1.0)
        drift = max(drift, float(np.linalg.norm(loop.truth.q[:2] - place)))
    ok = stood and steps <= config.stop_steps and drift < config.stand_drift_limit and not loop.fallen
    return {
        "fell": loop.fallen,
        "reason": _reason(loop),
        "steps": steps,
        "stood": stood,
        "drift": drift,
        "ok": ok,
        "moments": _moments(loop, not ok),
    }


def top_speed(robot: str, seed: int, contender: str = "") -> Case:
    """Try ever lower speeds until one is held: falls end a try early, so the fast ones cost little.

    Returns:
        ``top_speed``: the mean of the highest speed that was held, 0 when none [m/s]; ``reason``, ``moments``: how the
        one above it failed.
    """
    config, reason = walk_config(), ""
    tested = {"contender": contender} if contender else {}
    moments: Case = {}
    for speed in sorted(robot_walk(robot).top_speeds, reverse=True):
        case = steady(robot, seed, (speed, 0.0, 0.0), config.top_duration, **tested)
        mean = float(case["velocity"][0])
        if not case["fell"] and mean >= (1.0 - config.top_tolerance) * speed:
            return {"top_speed": mean, "reason": reason, "moments": moments}
        reason = f"{speed:g} m/s: {case['reason'] or f'mean {mean:.2f} m/s'}"
        moments = case["moments"] or ({} if contender else _moments(_loop(robot), True))
    return {"top_speed": 0.0, "reason": reason, "moments": moments}


MEASURES: dict[str, Callable[..., Case]] = {"steady": steady, "random": random_walk, "stop": stop, "top": top_speed}
"""How each kind of case is measured."""


def measure(kind: str, **inputs: Any) -> Case:
    """Measure one case, whose name says nothing more than its inputs."""
    inputs.pop("scenario")
    return MEASURES[kind](**inputs)
