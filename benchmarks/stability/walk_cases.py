"""Walking test: settings, measures of a walk from the true state, and measurement of each kind of case."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np
import pinocchio as pin
from pydantic.dataclasses import dataclass as schema

from benchmarks.core.benchmark import settings
from benchmarks.core.contender import ContenderLoop
from benchmarks.core.harness import Case
from benchmarks.core.loops import demand, start_walk
from benchmarks.stability.falls import last_moments
from bridge.closed_loop import ClosedLoop
from models.config import STRICT, Count, Positive, Share
from models.constants import GRAVITY
from models.errors import ConfigError
from models.heading import heading, turned
from models.robot_model import RobotModel
from models.types import Matrix, Mode, Vector, Velocity
from planners.gait.config import VelocityConfig
from planners.gait.scaling import load_gait_config


@dataclass(frozen=True, slots=True)
class Walked:
    """Measured walk of the CoM; the base moves around the CoM while the robot turns in place."""

    velocities: Matrix  #: Mean velocity of each chunk, in its heading (n, 3) [m/s, m/s, rad/s]
    distance: float  #: Length of the path [m]
    energy: float  #: Mechanical work of the joints, braking counted as positive [J]

    @property
    def mean(self) -> Vector:
        """Mean velocity (3,) [m/s, m/s, rad/s]; zero if it fell before the end of the first chunk."""
        if not len(self.velocities):
            return np.zeros(3)
        mean: Vector = self.velocities.mean(axis=0)
        return mean


def watch(loop: ClosedLoop, duration: float, chunk: float) -> Walked:
    """Measure a walk for ``duration`` [s] or until a fall, every ``chunk`` [s]; the power is from the loop's log."""
    velocities, distance, energy = [], 0.0, 0.0
    end, model, data = loop.t + duration, loop.robot.pin, loop.robot.data()

    def place() -> tuple[Vector, float]:
        """Return CoM (2,) [m] and heading [rad]."""
        q = loop.truth.q
        return pin.centerOfMass(model, data, q)[:2].copy(), heading(*q[3:7])

    start, first = place()
    while loop.t < end - 1e-9 and not loop.fallen:  # 1e-9: rounding of the simulated time
        rows = len(loop.log)
        loop.run(chunk)
        now, last = place()
        turn = (last - first + math.pi) % (2.0 * math.pi) - math.pi
        moved = now - start
        velocities.append(np.array([*turned(moved, -(first + 0.5 * turn)), turn]) / chunk)
        distance += math.hypot(*moved)
        power = np.abs(loop.log.tau[rows:] * loop.log.true_v[rows:, 6:]).sum(axis=1)  # (n,)
        energy += float(power.mean()) * chunk
        start, first = now, last
    return Walked(np.array(velocities).reshape(-1, 3), distance, energy)


def speed_error(mean: Vector, command: Velocity) -> float:
    """Return the error of a mean velocity (straight or turn) relative to the command [-]."""
    return float(np.linalg.norm(mean - np.array(command)) / np.linalg.norm(command))


def tracking_error(velocities: Matrix, commands: Matrix, count: int) -> float:
    """Return the RMS error of the linear velocity [m/s]; velocity and command are averaged over ``count`` chunks."""
    if len(velocities) < count:
        return math.nan
    kernel = np.ones(count) / count
    errors = [np.convolve(velocities[:, i] - commands[:, i], kernel, mode="valid") for i in range(2)]
    return float(np.sqrt(np.mean(errors[0] ** 2 + errors[1] ** 2)))


@schema(frozen=True, slots=True, config=STRICT)
class RobotWalk:
    """Scenarios of one robot; see ``benchmarks/config/walk.yaml``."""

    scenarios: dict[str, Velocity]
    random: bool
    top_speeds: tuple[Positive, ...]
    required_top_speed: Positive

    @property
    def names(self) -> tuple[str, ...]:
        """All scenarios that can be selected."""
        return (*self.scenarios, *(("random",) if self.random else ()), "stop", "top")


@schema(frozen=True, slots=True, config=STRICT)
class WalkConfig:
    """Settings of the walking test; the units are in ``benchmarks/config/walk.yaml``."""

    duration: Positive
    start_time: Positive
    window: Positive
    chunk: Positive
    record_period: Positive
    shown: Positive
    random_period: Positive
    random_share: Share
    speed_error_limit: Positive
    top_duration: Positive
    top_tolerance: Positive
    stop_speed: Positive
    stop_after: Positive
    stop_limit: Positive
    stop_steps: Count
    stand_time: Positive
    stand_drift_limit: Positive
    robots: dict[str, RobotWalk]


walk_config = partial(settings, WalkConfig, "walk")


def robot_walk(name: str) -> RobotWalk:
    """Return the scenarios of a robot; ``ConfigError`` if there are none."""
    robots = walk_config().robots
    if name not in robots:
        raise ConfigError(f"bench walk: no scenarios for '{name}'; known: {', '.join(robots)}")
    return robots[name]


@cache
def _contested(robot: str, contender: str) -> ContenderLoop:
    return ContenderLoop(contender, robot, record_period_s=walk_config().record_period)


@cache
def _loop(robot: str) -> ClosedLoop:
    """Return the closed loop for all cases of this process; its gait permits the highest top speed."""
    model = RobotModel.load(robot)
    gait = load_gait_config(model)
    forward = max(gait.velocity.forward, *robot_walk(robot).top_speeds)
    gait = replace(gait, velocity=replace(gait.velocity, forward=forward))
    return ClosedLoop(model, record=True, record_period_s=walk_config().record_period, gait=gait)


@cache
def _limits(robot: str) -> VelocityConfig:
    return load_gait_config(RobotModel.load(robot)).velocity


def _scores(loop: ClosedLoop, walked: Walked, commands: Matrix, config: WalkConfig) -> Case:
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


def _reason(loop: ClosedLoop) -> str:
    what = loop.fall_reason or "; ".join(loop.faults)
    return f"{what} at {loop.t:.1f} s" if what else ""


def _moments(loop: ClosedLoop, failed: bool) -> Case:
    """Return ``last_moments`` of a failed walk; empty without failure, and for a contender (incomplete log)."""
    return last_moments(loop, walk_config().shown) if failed and not isinstance(loop, ContenderLoop) else {}


def _run(loop: ClosedLoop, duration: float) -> None:
    chunk = walk_config().chunk
    for _ in range(round(duration / chunk)):
        if not loop.fallen:
            loop.run(chunk)


def _begin(loop: ClosedLoop, seed: int, command: Velocity, config: WalkConfig) -> ClosedLoop:
    """Start a walk at a velocity and run it for ``start_time``; ``PoiseError`` if the robot refuses to walk."""
    loop.reset(seed)
    start_walk(loop, *command)
    _run(loop, config.start_time)
    return loop


def steady(robot: str, seed: int, command: Velocity, duration: float, contender: str = "") -> Case:
    """Hold one velocity; ``PoiseError`` if the robot refuses to walk. A fall has ``moments``."""
    config = walk_config()
    loop = _begin(_contested(robot, contender) if contender else _loop(robot), seed, command, config)
    walked = watch(loop, duration - config.start_time, config.chunk)
    commands = np.tile(command, (len(walked.velocities), 1))
    return {**_scores(loop, walked, commands, config), "speed_error": speed_error(walked.mean, command)}


def random_walk(robot: str, seed: int) -> Case:
    """Change the velocity every ``random_period``; scores as in ``steady``, without ``speed_error``."""
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
    """Stop from a walk, then stand: steps after the command, whether it stood in time, and drift [m]."""
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
    """Try decreasing speeds until one is held; returns its mean [m/s]. Falls end a try early, so they cost little."""
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


def measure(kind: str, **inputs: Any) -> Case:
    """Measure one case; the name of its scenario is not used."""
    inputs.pop("scenario")
    return MEASURES[kind](**inputs)
