"""Survival of blind walking on uneven, slippery and soft ground, with a payload and with delayed commands."""

import math
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from pydantic.dataclasses import dataclass as schema

from benchmarks.core.benchmark import SurvivalBenchmark, by_scenario, settings
from benchmarks.core.contender import ContenderLoop
from benchmarks.core.harness import Case, Options, Report
from benchmarks.stability.falls import draw_distances, last_moments
from bridge.closed_loop import ClosedLoop
from bridge.plants.deviation import Deviation
from bridge.plants.sensors import SensorErrors
from models.config import STRICT, NonNegative, Positive, Share
from models.heading import heading
from models.robot_model import RobotModel
from models.terrain import FLAT, terrain_named
from models.terrain import Terrain as Ground


@schema(frozen=True, slots=True, config=STRICT)
class Condition:
    """Difficulties of a walk."""

    #: Ground, or its name in ``models/config/terrain.yaml``; random tiles use the seed of the case
    terrain: str | Ground = FLAT
    friction: Positive | None = None  #: Coulomb coefficient [-]; the robot's coefficient when None
    payload: NonNegative = 0.0  #: Unknown mass at the torso, as a share of the robot's mass [-]
    delay: NonNegative = 0.0  #: Delay added to the delay of sensors and commands [s]
    deviation: Deviation | None = None  #: Difference of the simulated robot from the model of the laws
    speed: Positive | None = None  #: Forward speed; the common speed when None [m/s]


@schema(frozen=True, slots=True, config=STRICT)
class TerrainConfig:
    """Settings of the test; the units are in ``benchmarks/config/terrain.yaml``."""

    speed: Positive
    duration: Positive
    distance_share: Share
    required_share: Share
    record_period: Positive
    shown: Positive
    conditions: dict[str, Condition]
    goals: dict[str, Condition]


_config = partial(settings, TerrainConfig, "terrain")

_robot = cache(RobotModel.load)


def walk(robot: str, seed: int, scenario: str, contender: str = "") -> Case:
    """Walk straight ahead under a condition of the settings, given its name (``walk_under``)."""
    config = _config()
    return walk_under({**config.conditions, **config.goals}[scenario], robot, seed, contender)


def loop_under(condition: Condition, model: RobotModel, seed: int, contender: str = "", **options: Any) -> ClosedLoop:
    """Return a loop under one condition, at its start; ``options`` are those of ``ClosedLoop``."""
    latency, deviation = model.profile.sensors.latency, condition.deviation
    options |= {
        "seed": seed,
        "terrain": terrain_named(condition.terrain, seed=seed),
        "friction": condition.friction,
        "payload_kg": condition.payload * model.mass,
        "delay_s": latency.sensors + latency.commands + condition.delay,
    }
    if deviation is not None:
        options["sensor_errors"] = SensorErrors(encoder_offsets=deviation.encoder_offsets(model, seed))
    loop: ClosedLoop = ContenderLoop(contender, model, **options) if contender else ClosedLoop(model, **options)
    if deviation is not None:
        deviation.apply(loop.plant, seed)
        loop.reset(seed)
    return loop


def walk_ahead(loop: ClosedLoop, speed: float, duration: float) -> tuple[float, float, bool]:
    """Walk from standing; returns time to the fall or the end [s], distance ahead [m], and whether it survived."""
    loop.command("walk")
    loop.set_velocity(speed, 0.0, 0.0)
    (x, y), yaw = loop.truth.q[:2].copy(), heading(*loop.truth.q[3:7])
    start = loop.t
    while loop.t - start < duration and not loop.fallen:
        loop.run(0.1)
    moved = loop.truth.q[:2] - (x, y)
    distance = float(moved @ (math.cos(yaw), math.sin(yaw)))
    return loop.t - start, distance, not loop.fallen and distance >= _config().distance_share * speed * duration


def walk_under(condition: Condition, robot: str, seed: int, contender: str = "") -> Case:
    """Walk straight ahead under one condition; ``trips`` counts caught feet, a failed walk has ``moments``."""
    config = _config()
    loop = loop_under(condition, _robot(robot), seed, contender, record_period_s=config.record_period)
    time, distance, survived = walk_ahead(loop, condition.speed or config.speed, config.duration)
    outcome: Case = {
        "fell": loop.fallen,
        "reason": loop.fall_reason or "; ".join(loop.faults),
        "time": time,
        "distance": distance,
        "survived": survived,
        "trips": 0 if isinstance(loop, ContenderLoop) else loop.gait.trips,
        "foot_slip": float(loop.foot_slip.max()),
    }
    if survived or isinstance(loop, ContenderLoop):  # a contender's log lacks the signals of ``moments``
        return outcome
    return {**outcome, "moments": last_moments(loop, config.shown)}


class Terrain(SurvivalBenchmark):
    """Conditions with a bound, or the selected ones, once per seed."""

    measure = staticmethod(walk)
    required_share, usual, goals = _config().required_share, _config().conditions, _config().goals

    def cases(self, options: Options) -> list[Case]:
        return [{**case, "contender": options.contender} for case in super().cases(options)]

    def further(self, name: str, cases: list[Case]) -> dict[str, float]:
        """Return the mean ``distance_`` [m]."""
        return {f"distance_{name}_m": float(np.mean([case["distance"] for case in cases]))}

    def notes(self, report: Report) -> list[str]:
        bounds = self.bounds(report)
        lines = [
            f"{name.removeprefix('survived_')}: {report.figures[name]:.0f} of "
            f"{report.figures[name.replace('survived_', 'total_')]:.0f} survived"
            for name, bound in bounds.items()
            if name in report.figures and not bound.holds(report.figures[name])
        ]
        return lines + [
            f"{case['scenario']}, seed {case['seed']}: {case['reason'] or 'too slow'} after {case['time']:.1f} s, "
            f"{case['distance']:.2f} m"
            for case in report.cases
            if not case["survived"]
        ]

    def plots(self, report: Report, folder: Path) -> list[Path]:
        config, known = _config(), {**self.usual, **self.goals}
        speeds = [known[name].speed or config.speed for name in by_scenario(report.cases)]

        def draw_limits(axes: Axes) -> None:
            at = np.arange(len(speeds))
            for label, share, style in (("commanded", 1.0, "-"), ("required", config.distance_share, "--")):
                limits = share * config.duration * np.array(speeds)
                axes.hlines(limits, at - 0.5, at + 0.5, color="k", linewidth=0.8, linestyle=style, label=label)

        return draw_distances(report, folder, f"distance in {config.duration:.0f} s [m]", draw_limits)
