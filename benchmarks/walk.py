"""Walking at commanded velocities: who falls, how fast it really goes, what it costs, and whether it stops."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass as schema

from benchmarks.harness import Case, LoadMeter, Options, Report, run_cases
from benchmarks.walk_measure import Velocity, Walked, speed_error, tracking_error, watch
from bridge.closed_loop import ClosedLoop
from bridge.plots import new_figure
from models.config import STRICT, default_config
from models.constants import GRAVITY
from models.errors import ConfigError
from models.types import Matrix, Mode

Positive = Annotated[float, Field(gt=0.0)]


@schema(frozen=True, slots=True, config=STRICT)
class RobotWalk:
    """What one robot is asked for; see ``benchmarks/config/walk.yaml``."""

    scenarios: dict[str, Velocity]
    random: bool
    top_speeds: tuple[Positive, ...]
    required_top_speed: Positive


@schema(frozen=True, slots=True, config=STRICT)
class WalkConfig:
    """The walking test; the unit of every value stands in ``benchmarks/config/walk.yaml``."""

    duration: Positive
    start_time: Positive
    window: Positive
    chunk: Positive
    record_period: Positive
    random_period: Positive
    random_share: Annotated[float, Field(gt=0.0, le=1.0)]
    speed_error_limit: Positive
    top_duration: Positive
    top_tolerance: Positive
    stop_speed: Positive
    stop_after: Positive
    stop_limit: Positive
    stop_steps: Annotated[int, Field(ge=1)]
    stand_time: Positive
    stand_drift_limit: Positive
    robots: dict[str, RobotWalk]


@cache
def _config() -> WalkConfig:
    return default_config(WalkConfig, "benchmarks", "walk")


@cache
def _loop(robot: str) -> ClosedLoop:
    """One closed loop for every case of this process."""
    return ClosedLoop(robot=robot, record=True, record_period_s=_config().record_period)


def _scores(loop: ClosedLoop, walked: Walked, commands: Matrix, config: WalkConfig) -> Case:
    window = max(round(config.window / config.chunk), 1)
    weight = loop.robot.mass * GRAVITY
    return {
        "fell": loop.fallen,
        "reason": loop.fall_reason or "; ".join(loop.faults),
        "velocity": walked.mean.tolist(),
        "tracking_error": tracking_error(walked.velocities, commands, window),
        "cost_of_transport": walked.energy / (weight * walked.distance) if walked.distance > 0.1 else math.nan,
        "foot_slip": float(loop.foot_slip.max()),
    }


def _begin(robot: str, seed: int, command: Velocity, config: WalkConfig) -> ClosedLoop:
    """A robot that has walked at a velocity for ``start_time``."""
    loop = _loop(robot)
    loop.reset(seed)
    loop.command("walk")
    loop.set_velocity(*command)
    loop.run(config.start_time)
    return loop


def steady(robot: str, seed: int, command: Velocity, duration: float) -> Case:
    """Hold one velocity.

    Returns:
        ``fell``, ``reason``, ``velocity`` (3,) [m/s, m/s, rad/s], ``speed_error`` [-], ``tracking_error`` [m/s],
        ``cost_of_transport`` [-], ``foot_slip`` [m].
    """
    config = _config()
    loop = _begin(robot, seed, command, config)
    walked = watch(loop, duration - config.start_time, config.chunk)
    commands = np.tile(command, (len(walked.velocities), 1))
    return {**_scores(loop, walked, commands, config), "speed_error": speed_error(walked.mean, command)}


def random_walk(robot: str, seed: int) -> Case:
    """A new velocity every ``random_period``; scores as of ``steady``, without ``speed_error``."""
    config, loop = _config(), _loop(robot)
    loop.reset(seed)
    loop.command("walk")
    limits = loop.gait.config.velocity
    low = config.random_share * np.array([-limits.backward, -limits.lateral, -limits.turn])
    high = config.random_share * np.array([limits.forward, limits.lateral, limits.turn])
    rng = np.random.default_rng(seed)
    parts, commands = [], []
    for _ in range(max(round(config.duration / config.random_period), 1)):
        command = rng.uniform(low, high)
        if loop.fallen or loop.mode is not Mode.WALK:
            break
        loop.set_velocity(*command)
        parts.append(watch(loop, config.random_period, config.chunk))
        commands.append(np.tile(command, (len(parts[-1].velocities), 1)))
    walked = Walked(
        np.vstack([part.velocities for part in parts]),
        sum(part.distance for part in parts),
        sum(part.energy for part in parts),
    )
    return _scores(loop, walked, np.vstack(commands), config)


def stop(robot: str, seed: int) -> Case:
    """Stop from a walk, then stand.

    Returns:
        ``fell``, ``reason``, ``steps`` after the command, ``stood`` in time, ``drift`` [m] of the base while standing.
    """
    config = _config()
    loop = _begin(robot, seed, (config.stop_speed, 0.0, 0.0), config)
    loop.run(max(config.stop_after - config.start_time, 0.0))
    steps = loop.gait.steps
    loop.command("stop")
    loop.run(config.stop_limit)
    steps = loop.gait.steps - steps
    stood = loop.mode is Mode.STAND
    place, drift = loop.truth.q[:2].copy(), 0.0
    for _ in range(round(config.stand_time)):
        loop.run(1.0)
        drift = max(drift, float(np.linalg.norm(loop.truth.q[:2] - place)))
    return {
        "fell": loop.fallen,
        "reason": loop.fall_reason or "; ".join(loop.faults),
        "steps": steps,
        "stood": stood,
        "drift": drift,
        "ok": stood and steps <= config.stop_steps and drift < config.stand_drift_limit and not loop.fallen,
    }


def top_speed(robot: str, seed: int) -> Case:
    """Try ever higher speeds until one is not held.

    Returns:
        ``top_speed``: the highest mean speed that was held, 0 when none [m/s]; ``reason``: why the next one was not.
    """
    config, best, reason = _config(), 0.0, ""
    for speed in _robot(robot).top_speeds:
        case = steady(robot, seed, (speed, 0.0, 0.0), config.top_duration)
        mean = float(case["velocity"][0])
        if case["fell"] or mean < (1.0 - config.top_tolerance) * speed:
            reason = f"{speed:g} m/s: {case['reason'] or f'mean {mean:.2f} m/s'}"
            break
        best = max(best, mean)
    return {"top_speed": best, "reason": reason}


def _robot(name: str) -> RobotWalk:
    robots = _config().robots
    if name not in robots:
        raise ConfigError(f"bench walk: no scenarios for '{name}'; known: {', '.join(robots)}")
    return robots[name]


MEASURES: dict[str, Callable[..., Case]] = {"steady": steady, "random": random_walk, "stop": stop, "top": top_speed}
"""How each kind of case is measured."""


def _measure(kind: str, **inputs: Any) -> Case:
    inputs.pop("scenario")
    return MEASURES[kind](**inputs)


def _cases(robot: str, seeds: int) -> list[Case]:
    """Inputs of every case."""
    config, wanted, cases = _config(), _robot(robot), []
    for seed in range(seeds):
        for name, command in wanted.scenarios.items():
            case = {"kind": "steady", "scenario": name, "command": command, "duration": config.duration}
            cases.append({**case, "robot": robot, "seed": seed})
        kinds = ["random"] * wanted.random + ["stop", "top"]
        cases += [{"kind": kind, "scenario": kind, "robot": robot, "seed": seed} for kind in kinds]
    return cases


def judge(robot: str, results: list[Case]) -> tuple[dict[str, float], list[str]]:
    """Figures of the results, and every bound that does not hold."""
    config, wanted = _config(), _robot(robot)
    of: dict[str, list[Case]] = {}
    for case in results:
        of.setdefault(case["kind"], []).append(case)
    walked = of["steady"] + of.get("random", [])
    falls = [case for case in walked + of["stop"] if case["fell"]]
    broken = [f"fell: {case['scenario']}, seed {case['seed']}: {case['reason']}" for case in falls]
    errors = {}
    for name, command in wanted.scenarios.items():
        means = [case["velocity"] for case in of["steady"] if case["scenario"] == name]
        errors[name] = speed_error(np.mean(means, axis=0), command)
        if not errors[name] < config.speed_error_limit:
            broken.append(f"{name}: the mean velocity is {errors[name]:.3f} of the command off")
    broken += [f"stop, seed {case['seed']}: {case}" for case in of["stop"] if not case["ok"] and not case["fell"]]
    top = min(case["top_speed"] for case in of["top"])
    if top < wanted.required_top_speed:
        broken += [f"top speed, seed {case['seed']}: {case['reason']}" for case in of["top"] if case["reason"]]
    figures = {
        "falls": float(len(falls)),
        "walks": float(len(walked) + len(of["stop"])),
        "speed_error_mean": float(np.mean([case["speed_error"] for case in of["steady"]])),
        **{f"speed_error_{name}": error for name, error in errors.items()},
        "top_speed": top,
        "tracking_error_m_s": float(np.nanmean([case["tracking_error"] for case in walked])),
        "cost_of_transport": float(
            np.nanmean([case["cost_of_transport"] for case in of["steady"] if case["scenario"] == "forward"])
        ),
        "stop_drift_max_m": max(case["drift"] for case in of["stop"]),
        "stop_steps_max": float(max(case["steps"] for case in of["stop"])),
        "foot_slip_max_m": max(case["foot_slip"] for case in walked),
    }
    return figures, broken


def run(options: Options) -> Report:
    """Every scenario of the robot, once a seed.

    Args:
        options: Robot, seeds and workers.

    Returns:
        Figures ``falls`` of ``walks``, ``speed_error_mean`` and of each scenario [-], ``top_speed`` that every seed
        holds [m/s], ``tracking_error_m_s``, ``cost_of_transport`` (forward), ``stop_drift_max_m``, ``stop_steps_max``,
        ``foot_slip_max_m``.

    Raises:
        ConfigError: There are no scenarios for this robot.
    """
    load = LoadMeter()
    results = run_cases(
        _measure, _cases(options.robot, options.seeds), title=f"walk {options.robot}", workers=options.workers
    )
    figures, broken = judge(options.robot, results)
    return Report(
        bench="walk",
        robot=options.robot,
        seeds=options.seeds,
        figures=figures,
        cases=results,
        passed=not broken,
        load=load.read(),
        notes=broken[:10],
    )


def plot(report: Report, folder: Path) -> list[Path]:
    """Draw how far each walk's mean velocity is off its command, and the top speed of each seed.

    Args:
        report: What ``run`` found.
        folder: Where the picture goes.

    Returns:
        The file written.
    """
    figure = new_figure(8.0, 3.5)
    left, right = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2)
    walked = [case for case in report.cases if case["kind"] == "steady"]
    names = list(dict.fromkeys(case["scenario"] for case in walked))
    for fell, colour in ((False, "#1b6ca8"), (True, "#c0392b")):
        chosen = [case for case in walked if case["fell"] == fell]
        left.plot(
            [names.index(case["scenario"]) for case in chosen],
            [case["speed_error"] for case in chosen],
            "o",
            color=colour,
            label="fell" if fell else "walked",
        )
    left.axhline(_config().speed_error_limit, color="k", linewidth=0.8, linestyle="--")
    left.set_xticks(range(len(names)), names, fontsize=8)
    left.set_ylabel("mean velocity off the command [-]")
    left.legend(fontsize=8)
    top = [case for case in report.cases if case["kind"] == "top"]
    right.plot([case["seed"] for case in top], [case["top_speed"] for case in top], "o", color="#1b6ca8")
    right.axhline(_robot(report.robot).required_top_speed, color="k", linewidth=0.8, linestyle="--")
    right.set_xlabel("seed")
    right.set_ylabel("top speed held [m/s]")
    right.set_ylim(bottom=0.0)
    file = folder / f"walk-{report.robot}.png"
    figure.savefig(file, dpi=110)
    return [file]
