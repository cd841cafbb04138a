"""One push on a robot that may step: prepared, pushed, judged by the true state."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Annotated

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass as schema

from benchmarks.cli import PushMode
from benchmarks.commands import demand
from benchmarks.fall_signals import moments_since
from benchmarks.harness import Case
from benchmarks.leg_clearance import LegClearance
from benchmarks.push import stance
from bridge.closed_loop import ClosedLoop
from models.config import STRICT, default_config
from models.errors import PoiseError
from models.heading import heading
from models.types import Vector

Positive = Annotated[float, Field(gt=0.0)]


@schema(frozen=True, slots=True, config=STRICT)
class Required:
    """Impulse over mass that passes, or is the goal, of all directions [m/s]."""

    smallest: Positive
    median: Positive


@schema(frozen=True, slots=True, config=STRICT)
class PushMapConfig:
    """The push test with steps; the unit of every value stands in ``benchmarks/config/push_map.yaml``."""

    body: str
    directions: Annotated[int, Field(ge=1)]
    phases: Annotated[int, Field(ge=1)]
    duration: Positive
    stand_time: Positive
    walk_time: Positive
    walk_speed: Positive
    recover_time: Positive
    check_period: Positive
    first: Positive
    largest: Positive
    stride: Positive
    resolution: Positive
    speed_tolerance: Positive
    overlap_tolerance: Annotated[float, Field(ge=0.0)]
    sole_thickness: Positive
    walk_window: Positive
    walk_share: Annotated[float, Field(gt=0.0, lt=1.0)]
    bound_steps: Annotated[int, Field(ge=1)]
    record_period: Positive
    lead: Positive
    required: dict[str, Required]
    goals: dict[str, Required]


@dataclass(frozen=True, slots=True)
class Trial:
    """Everything but the size of one push.

    Attributes:
        robot: Name of the profile.
        mode: ``STEP`` or ``WALK``.
        seed: Of the sensor noise.
        phase: Which of the moments; standing it is added to the seed.
        angle: Heading of the push relative to that of the robot [rad].
    """

    robot: str
    mode: PushMode
    seed: int
    phase: int
    angle: float


@dataclass(frozen=True, slots=True)
class Outcome:
    """How one push ended.

    Attributes:
        reason: Why it was not taken; empty when it was.
        pushed: Simulated time of the push [s].
    """

    reason: str
    pushed: float


@cache
def map_config() -> PushMapConfig:
    """The packaged push test."""
    return default_config(PushMapConfig, "benchmarks", "push_map")


@cache
def loop_of(robot: str) -> ClosedLoop:
    """One closed loop for every push of this process; ``reset`` starts it over as a new one would."""
    return ClosedLoop(robot=robot, record_period_s=map_config().record_period)


@cache
def legs_of(robot: str) -> LegClearance:
    """The clearance of a robot's legs, for every push of this process."""
    return LegClearance(loop_of(robot).robot, map_config().sole_thickness)


def prepare(trial: Trial) -> ClosedLoop:
    """A robot at the moment of its push.

    Raises:
        PoiseError: It falls, or does not walk, without one.
    """
    config, loop = map_config(), loop_of(trial.robot)
    standing = trial.mode is not PushMode.WALK
    loop.reset(trial.seed + (trial.phase if standing else 0))
    demand(loop, "walk")
    if standing:
        loop.run(config.stand_time)
        return loop
    loop.set_velocity(config.walk_speed, 0.0, 0.0)
    loop.run(config.walk_time)
    stride = 2.0 * loop.gait.config.period
    end, was = loop.t + 2.0 * stride, True
    while True:  # until the left foot lifts
        lifted = loop.gait.view.swinging and loop.gait.stance == 1
        if lifted and not was:
            break
        was = lifted
        if loop.t > end or loop.fallen:
            raise PoiseError(f"{trial.robot} does not walk at {config.walk_speed} m/s before it is pushed")
        loop.step()
    loop.run(stride * trial.phase / config.phases)
    return loop


def survives(loop: ClosedLoop, trial: Trial, dv: float) -> Outcome:
    """Push once.

    Args:
        loop: The robot at the moment of its push, as ``prepare`` returns it.
        trial: Everything but the size of the push.
        dv: Impulse over mass [m/s].
    """
    config, legs, pushed = map_config(), legs_of(trial.robot), loop.t
    angle = heading(*loop.truth.q[3:7]) + trial.angle
    force = loop.robot.mass * dv / config.duration
    loop.apply_push((force * math.cos(angle), force * math.sin(angle), 0.0), config.duration, config.body)
    end, places = pushed + config.duration + config.recover_time, [loop.truth.q[:2].copy()]
    while loop.t < end - 1e-9:  # 1e-9: rounding of the simulated time
        loop.run(config.check_period)
        if loop.fallen:
            return Outcome(loop.fall_reason, pushed)
        if legs.distance(loop.truth.q) < -config.overlap_tolerance:
            return Outcome("the legs run through each other", pushed)
        places.append(loop.truth.q[:2].copy())
    return Outcome(_ending(trial, loop, places), pushed)


def moments(loop: ClosedLoop, outcome: Outcome) -> Case:
    """What explains how a push ended, from shortly before it on; see ``moments_since``."""
    return moments_since(loop, outcome.pushed - map_config().lead)


def _ending(trial: Trial, loop: ClosedLoop, places: list[Vector]) -> str:
    """Why the end of a trial is not what it has to be; empty when it is."""
    config = map_config()
    if trial.mode is PushMode.WALK:
        window = min(round(config.walk_window / config.check_period), len(places) - 1)
        moved = float(np.linalg.norm(places[-1] - places[-1 - window]))
        return "" if moved > config.walk_share * config.walk_speed * config.walk_window else "does not walk on"
    speed = float(np.linalg.norm(stance(loop.robot, loop.truth).com_velocity))
    if loop.gait.walking:
        return "still steps"
    return "" if speed < config.speed_tolerance else f"CoM still moves at {speed:.2f} m/s"
