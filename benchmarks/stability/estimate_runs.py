"""Runs of ``poise bench estimate``: the estimator's errors in one scenario, and what one of its steps takes."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from functools import cache, partial
from typing import Annotated

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass as schema

from benchmarks.core.benchmark import Count, Positive, settings
from benchmarks.core.harness import Case, percentiles
from benchmarks.core.loops import demand
from benchmarks.core.timed_run import Stopwatch, blocks_growth, collector_off
from benchmarks.stability.exercise import exercise, exercise_config
from bridge.closed_loop import ClosedLoop
from models.config import STRICT
from models.types import Mode

#: What a contact-aided estimator can observe, as rows of the error of pose and twist: the rest is yaw and position
PARTS = {
    "velocity": np.array([6, 7, 8]),
    "tilt": np.array([3, 4]),
    "height": np.array([2]),
    "joint": np.array([2, 3, 4, 6, 7, 8]),
}


@schema(frozen=True, slots=True, config=STRICT)
class EstimateConfig:
    """The estimation test; the unit of every value stands in ``benchmarks/config/estimate.yaml``."""

    settle_time: Positive
    stand_time: Positive
    motions: tuple[str, ...]
    push_speed: Positive
    push_duration: Positive
    push_period: Positive
    pushes: Count
    directions: Count
    walk_velocity: Positive
    walk_time: Positive
    stop_time: Positive
    sample_period: Positive
    instant_period: Positive
    confidence: Annotated[float, Field(gt=0.0, lt=1.0)]
    timed_time: Positive
    velocity_rmse_max: Positive
    tilt_rmse_max: Positive
    height_rmse_max: Positive
    walk_velocity_rmse_max: Positive
    drift_max: Positive
    step_us_max: Positive
    growth_max: Positive


estimate_config = partial(settings, EstimateConfig, "estimate")


@cache
def _loop(robot: str) -> ClosedLoop:
    """One closed loop for every run of this process; ``reset`` starts it over as a new one would."""
    return ClosedLoop(robot=robot, record=False)


class ErrorLog:
    """Errors of the estimate against the true state of the same instant, with their covariance, every ``period`` [s].

    The error of a sample is (12,): position and rotation vector of the base in W, linear and angular velocity in B,
    as ``StateEstimator.base_covariance`` has them.
    """

    def __init__(self, loop: ClosedLoop, period: float) -> None:
        self._loop, self._every = loop, max(round(period / loop.plant.period), 1)
        self._tick = 0
        self.times: list[float] = []
        self.errors: list[NDArray[np.float64]] = []
        self.covariances: list[NDArray[np.float64]] = []
        self.positions: list[NDArray[np.float64]] = []

    def step(self) -> None:
        """One tick of the robot, sampled when due."""
        self._tick += 1
        if self._tick % self._every:
            self._loop.step()
            return
        truth = self._loop.truth  # of the instant that this tick's sensors measure
        self._loop.step()
        state = self._loop.state
        turn = pin.Quaternion(state.q[3:7]).matrix() @ pin.Quaternion(truth.q[3:7]).matrix().T
        self.times.append(truth.t)
        self.errors.append(np.concatenate([state.q[:3] - truth.q[:3], pin.log3(turn), state.v[:6] - truth.v[:6]]))
        self.covariances.append(self._loop.estimator.base_covariance())
        self.positions.append(truth.q[:3].copy())

    def run(self, duration: float) -> None:
        """Run for a simulated time [s]."""
        for _ in range(round(duration / self._loop.plant.period)):
            self.step()


def nees(errors: NDArray[np.float64], covariances: NDArray[np.float64], part: NDArray[np.int64]) -> NDArray[np.float64]:
    """Normalised estimation error squared of the rows ``part`` of errors (n, 12) with covariances (n, 12, 12): (n,)."""
    e = errors[:, part]
    solved = np.linalg.solve(covariances[:, part[:, None], part], e[:, :, None])[:, :, 0]
    return np.asarray(np.einsum("ni,ni->n", e, solved))


def _stand(log: ErrorLog, loop: ClosedLoop, seed: int, config: EstimateConfig) -> None:
    log.run(config.stand_time)


def _push(log: ErrorLog, loop: ClosedLoop, seed: int, config: EstimateConfig) -> None:
    force = config.push_speed * loop.robot.mass / config.push_duration
    for k in range(config.pushes):
        angle = 2.0 * math.pi * (3 * k + seed) / config.directions
        loop.apply_push((force * math.cos(angle), force * math.sin(angle), 0.0), config.push_duration)
        log.run(config.push_period)


def _walk(log: ErrorLog, loop: ClosedLoop, seed: int, config: EstimateConfig) -> None:
    demand(loop, "walk")
    loop.set_velocity(config.walk_velocity, 0.0, 0.0)
    log.run(config.walk_time)
    loop.set_velocity(0.0, 0.0, 0.0)
    log.run(config.stop_time)


def _motion(name: str) -> Callable[[ErrorLog, ClosedLoop, int, EstimateConfig], None]:
    def run(log: ErrorLog, loop: ClosedLoop, seed: int, config: EstimateConfig) -> None:
        demand(loop, name)
        while loop.mode is Mode.MOTION and not loop.fallen:
            log.step()
        log.run(config.settle_time)

    return run


def scenarios() -> dict[str, Callable[[ErrorLog, ClosedLoop, int, EstimateConfig], None]]:
    """What the robot does in each scenario."""
    return {
        "stand": _stand,
        **{name: _motion(name) for name in estimate_config().motions},
        "push": _push,
        "walk": _walk,
    }


def measure(robot: str, seed: int, scenario: str) -> Case:
    """Errors of one run of a scenario; the seed also draws the directions of the pushes.

    Returns:
        Root mean squares ``velocity_rmse`` [m/s], ``tilt_rmse_deg``, ``height_rmse`` [m], each over all axes of the
        part; ``distance`` and ``drift`` in x, y, z, the growth of the position error [m]; ``instants`` [s] with
        the normalised error squared ``nees`` of each part; for seed 0 also ``trace``: times, errors and standard
        deviations of velocity, roll, pitch and height; and ``ok`` when the robot did not fall.
    """
    config, loop = estimate_config(), _loop(robot)
    loop.reset(seed)
    loop.run(config.settle_time)
    log = ErrorLog(loop, config.sample_period)
    scenarios()[scenario](log, loop, seed, config)
    t, errors, covariances = np.array(log.times), np.array(log.errors), np.array(log.covariances)
    path = np.array(log.positions)
    every = max(round(config.instant_period / config.sample_period), 1)
    rms = {name: float(np.sqrt((errors[:, part] ** 2).sum(axis=1).mean())) for name, part in PARTS.items()}
    case: Case = {
        "velocity_rmse": rms["velocity"],
        "tilt_rmse_deg": math.degrees(rms["tilt"]),
        "height_rmse": rms["height"],
        "distance": float(np.linalg.norm(np.diff(path[:, :2], axis=0), axis=1).sum()),
        "drift": (errors[-1, :3] - errors[0, :3]).tolist(),
        "gated": loop.estimator.health.gated,
        "instants": (t - t[0])[::every].tolist(),
        "nees": {name: nees(errors[::every], covariances[::every], part).tolist() for name, part in PARTS.items()},
        "ok": not loop.fallen,
        "reason": loop.fall_reason,
    }
    if seed == 0:
        rows = PARTS["joint"]
        deviations = np.sqrt(covariances[:, rows, rows])
        case["trace"] = {"t": (t - t[0]).tolist(), "error": errors[:, rows].tolist(), "sigma": deviations.tolist()}
    return case


def time_steps(robot: str) -> dict[str, float]:
    """Time of the estimator's step and of the whole-body tick that follows it, alternating in the same run.

    Returns:
        ``estimator_us_*`` and ``tick_us_*`` of the calls that were not interrupted, and ``allocated_blocks_growth``
        [1/tick].
    """
    config, tick, loop = estimate_config(), exercise_config(), _loop(robot)
    loop.reset(0)
    demand(loop, tick.motion)
    loop.run(tick.warm_up)
    watch = Stopwatch(round(config.timed_time / loop.plant.period) + 1, 2)
    blocks: list[int] = []
    with collector_off(), watch.timing(loop.estimator, "step", 0), watch.timing(loop.controller, "step", 1):
        for _ in exercise(loop, config.timed_time, tick):
            blocks.append(sys.getallocatedblocks())
    figures = percentiles(watch.times(0), "estimator_us") | percentiles(watch.times(1), "tick_us")
    figures["allocated_blocks_growth"] = blocks_growth(blocks, loop.plant.period)
    return figures
