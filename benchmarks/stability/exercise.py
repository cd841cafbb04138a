"""Exercise for timing of tick and estimator: wave while pushed from all sides."""

import math
from collections.abc import Iterator
from functools import partial

import numpy as np
from pydantic.dataclasses import dataclass as schema

from benchmarks.core.benchmark import settings
from benchmarks.core.loops import demand, keep_upright
from benchmarks.stability.push import stance
from benchmarks.stability.push_bounds import ankle_bound
from bridge.analysis.stability import distance_along
from bridge.closed_loop import ClosedLoop
from models.config import STRICT, Count, Positive
from models.types import Mode, Vector


@schema(frozen=True, slots=True, config=STRICT)
class ExerciseConfig:
    """Motion and pushes; the units are in ``benchmarks/config/exercise.yaml``."""

    warm_up: Positive
    motion: str
    push_ratio: Positive
    push_period: Positive
    push_duration: Positive
    push_body: str
    directions: Count


exercise_config = partial(settings, ExerciseConfig, "exercise")


def push_forces(loop: ClosedLoop, config: ExerciseConfig) -> list[Vector]:
    """Return the force of each push in W (3,) [N]; the present centre of pressure counts as the one at rest."""
    rest = stance(loop.robot, loop.truth)
    height = float(rest.com[2] - rest.soles[:, 2].mean())
    forces = []
    for k in range(config.directions):
        angle = 2.0 * math.pi * (3 * k % config.directions) / config.directions
        direction = np.array([math.cos(angle), math.sin(angle), 0.0])
        distance = distance_along(rest.polygon, rest.cop, direction)
        bound = ankle_bound(loop.robot.mass, height, distance, config.push_duration)
        forces.append(config.push_ratio * bound * direction)
    return forces


def exercise(loop: ClosedLoop, duration: float, config: ExerciseConfig) -> Iterator[None]:
    """Wave and push for a time [s]; yields every second; ``PoiseError`` if the robot falls or refuses the motion."""
    forces = push_forces(loop, config)
    start, pushes, second = loop.t, 0, 1
    while loop.t < start + duration - 1e-9:  # 1e-9: rounding of the simulated time
        if loop.mode is Mode.STAND:
            demand(loop, config.motion)
        if loop.t - start >= config.push_period * (pushes + 0.5):
            force = forces[pushes % len(forces)]
            loop.apply_push((force[0], force[1], force[2]), config.push_duration, config.push_body)
            pushes += 1
        loop.step()
        keep_upright(loop)
        if loop.t >= start + second - 1e-9:
            second += 1
            yield
