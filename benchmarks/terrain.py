"""Blind walking on uneven, slippery and soft ground, with a payload and with late commands: who gets through."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass as schema

from benchmarks.contender_loop import AnyLoop, ContenderLoop
from benchmarks.fall_plot import FAILED, PASSED, draw_failures
from benchmarks.fall_signals import last_moments
from benchmarks.harness import Case, LoadMeter, Options, Report, chosen, run_cases
from bridge.closed_loop import ClosedLoop
from bridge.plots import new_figure
from models.config import STRICT, default_config
from models.heading import heading
from models.robot_model import RobotModel
from models.terrain import FLAT, terrain_named

Positive = Annotated[float, Field(gt=0.0)]
NonNegative = Annotated[float, Field(ge=0.0)]
Share = Annotated[float, Field(gt=0.0, le=1.0)]


@schema(frozen=True, slots=True, config=STRICT)
class Condition:
    """What makes a walk hard.

    Attributes:
        terrain: Name of the ground, see ``models/config/terrain.yaml``; random tiles get the seed of the case.
        friction: Coulomb coefficient [-]; the robot's own when None.
        payload: Mass at the torso that no law knows of, as a share of the robot's [-].
        delay: Of the joint targets, on top of the usual delay of sensors and commands [s].
    """

    terrain: str = FLAT
    friction: Positive | None = None
    payload: NonNegative = 0.0
    delay: NonNegative = 0.0


@schema(frozen=True, slots=True, config=STRICT)
class TerrainConfig:
    """The test; the unit of every value stands in ``benchmarks/config/terrain.yaml``."""

    speed: Positive
    duration: Positive
    distance_share: Share
    required_share: Share
    record_period: Positive
    shown: Positive
    conditions: dict[str, Condition]
    goals: dict[str, Condition]


@cache
def _config() -> TerrainConfig:
    return default_config(TerrainConfig, "benchmarks", "terrain")


@cache
def _robot(name: str) -> RobotModel:
    return RobotModel.load(name)


def walk(robot: str, seed: int, scenario: str, contender: str = "") -> Case:
    """Walk straight ahead under one condition.

    Args:
        robot: Name of a profile.
        seed: Of sensor noise and of random tiles.
        scenario: Name of the condition.
        contender: Controller to test instead of poise's own.

    Returns:
        ``fell``, ``reason``, ``time`` until the end or the fall [s], ``distance`` along the heading at the start [m],
        ``survived``, ``trips`` (feet that were caught), ``foot_slip`` [m], and of a walk that did not survive
        ``moments``, its last moments.
    """
    config = _config()
    condition = {**config.conditions, **config.goals}[scenario]
    model = _robot(robot)
    latency = model.profile.sensors.latency
    conditions: dict[str, Any] = {
        "seed": seed,
        "terrain": terrain_named(condition.terrain, seed=seed),
        "friction": condition.friction,
        "payload_kg": condition.payload * model.mass,
        "delay_s": latency.sensors + latency.commands + condition.delay,
        "record_period_s": config.record_period,
    }
    loop: AnyLoop = ContenderLoop(contender, model, **conditions) if contender else ClosedLoop(model, **conditions)
    loop.command("walk")
    loop.set_velocity(config.speed, 0.0, 0.0)
    (x, y), yaw = loop.truth.q[:2].copy(), heading(*loop.truth.q[3:7])
    start = loop.t
    while loop.t - start < config.duration and not loop.fallen:
        loop.run(0.1)
    moved = loop.truth.q[:2] - (x, y)
    distance = float(moved @ (math.cos(yaw), math.sin(yaw)))
    survived = not loop.fallen and distance >= config.distance_share * config.speed * config.duration
    outcome: Case = {
        "fell": loop.fallen,
        "reason": loop.fall_reason or "; ".join(loop.faults),
        "time": loop.t - start,
        "distance": distance,
        "survived": survived,
        "trips": 0 if isinstance(loop, ContenderLoop) else loop.gait.trips,
        "foot_slip": float(loop.foot_slip.max()),
    }
    if survived or isinstance(loop, ContenderLoop):  # nobody but poise keeps what its moments show
        return outcome
    return {**outcome, "moments": last_moments(loop, config.shown)}


def cases(robot: str, seeds: int, scenarios: tuple[str, ...] = (), contender: str = "") -> list[Case]:
    """Inputs of every case: the conditions that have a bound, or those chosen.

    Raises:
        ConfigError: A chosen condition is unknown.
    """
    config = _config()
    names = chosen("terrain", scenarios, [*config.conditions, *config.goals], list(config.conditions))
    return [
        {"robot": robot, "seed": seed, "scenario": name, "contender": contender}
        for name in names
        for seed in range(seeds)
    ]


def judge(results: list[Case]) -> tuple[dict[str, float], list[str]]:
    """Figures of the results, and every bound that does not hold."""
    config, figures, broken = _config(), {}, []
    for name in dict.fromkeys(case["scenario"] for case in results):
        of = [case for case in results if case["scenario"] == name]
        survived = sum(case["survived"] for case in of)
        figures[f"survived_{name}"], figures[f"total_{name}"] = float(survived), float(len(of))
        figures[f"distance_{name}_m"] = float(np.mean([case["distance"] for case in of]))
        if name in config.conditions and survived < config.required_share * len(of):
            broken.append(f"{name}: {survived} of {len(of)} survived")
        broken += [
            f"{name}, seed {case['seed']}: {case['reason'] or 'too slow'} after {case['time']:.1f} s, "
            f"{case['distance']:.2f} m"
            for case in of
            if not case["survived"]
        ]
    return figures, broken


def run(options: Options) -> Report:
    """The chosen conditions, once a seed.

    Args:
        options: Robot, seeds, workers and conditions.

    Returns:
        Of each condition ``survived_`` of ``total_`` walks and the mean ``distance_`` [m].

    Raises:
        ConfigError: A chosen condition is unknown.
    """
    load = LoadMeter()
    wanted = cases(options.robot, options.seeds, options.scenarios, options.contender)
    results = run_cases(walk, wanted, bench="terrain", options=options)
    figures, notes = judge(results)
    return Report(
        bench="terrain",
        robot=options.robot,
        seeds=options.seeds,
        figures=figures,
        cases=results,
        passed=passed(figures),
        contender=options.contender,
        load=load.read(),
        notes=notes,
    )


def passed(figures: dict[str, float]) -> bool:
    """Whether enough walks of every measured condition that has a bound survived."""
    config = _config()
    return all(
        figures[f"survived_{name}"] >= config.required_share * figures[f"total_{name}"]
        for name in config.conditions
        if f"total_{name}" in figures
    )


def plot(report: Report, folder: Path) -> list[Path]:
    """Draw how far every walk came, and the last moments of the first failure of each condition.

    Args:
        report: What ``run`` found.
        folder: Where the pictures go.

    Returns:
        The files written.
    """
    config, names = _config(), list(dict.fromkeys(case["scenario"] for case in report.cases))
    figure = new_figure(3.5 + 0.9 * len(names), 3.6)
    axes = figure.add_subplot(1, 1, 1)
    for survived, colour in ((True, PASSED), (False, FAILED)):
        chosen = [case for case in report.cases if case["survived"] == survived]
        places = [names.index(case["scenario"]) + 0.3 * ((case["seed"] + 0.5) / report.seeds - 0.5) for case in chosen]
        label = "survived" if survived else "did not survive"
        axes.plot(places, [case["distance"] for case in chosen], "o", markersize=4, color=colour, label=label)
    commanded = config.speed * config.duration
    axes.axhline(commanded, color="k", linewidth=0.8, label="commanded")
    axes.axhline(config.distance_share * commanded, color="k", linewidth=0.8, linestyle="--", label="required")
    axes.set_xticks(range(len(names)), names, fontsize=8, rotation=20)
    axes.set_ylabel(f"distance in {config.duration:.0f} s [m]")
    axes.set_xlim(-0.5, len(names) - 0.5)
    axes.set_ylim(bottom=0.0)
    axes.set_title(f"terrain, {report.who}, seeds: {report.seeds}", fontsize=10)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8, frameon=False)
    files = [folder / f"terrain-{report.robot}.png"]
    figure.savefig(files[0], dpi=110)
    return files + draw_failures(report, folder)
