"""Error of the state estimator in five scenarios, consistency of its covariance, and time of its step.

The normalised estimation error squared (NEES) of n components, e' P^-1 e, has mean n when the covariance P is
consistent. Errors of one run are correlated in time (an encoder offset persists), so the NEES is averaged over
independent runs: at one instant, N times this mean has a chi^2 distribution with N n degrees of freedom. The mean over
the instants is compared with the same interval. Its variance is equal for errors that last for the whole run (tilt) and
smaller otherwise (velocity). The benchmark fails outside of the interval, on either side.

References:
    Y. Bar-Shalom, X. R. Li, T. Kirubarajan, "Estimation with applications to tracking and navigation", 2001, 5.4.
"""

import math
import sys
from collections.abc import Callable
from functools import cache, partial

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from pydantic.dataclasses import dataclass as schema
from scipy.stats import chi2

from benchmarks.core.benchmark import Benchmark, Bound, settings
from benchmarks.core.harness import Case, LoadMeter, Options, Report, percentiles, run_cases
from benchmarks.core.loops import demand, start_walk
from benchmarks.core.timed_run import Stopwatch, blocks_growth, collector_off
from benchmarks.stability.exercise import exercise, exercise_config
from bridge.closed_loop import ClosedLoop
from models.config import STRICT, Count, Fraction, Positive
from models.types import Mode

#: Observable errors of a contact-aided estimator, as rows of the error of pose and twist; without yaw and position
PARTS = {
    "velocity": np.array([6, 7, 8]),
    "tilt": np.array([3, 4]),
    "height": np.array([2]),
    "joint": np.array([2, 3, 4, 6, 7, 8]),
}


@schema(frozen=True, slots=True, config=STRICT)
class EstimateConfig:
    """Settings of the estimation test; the units are in ``benchmarks/config/estimate.yaml``."""

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
    confidence: Fraction
    timed_time: Positive


estimate_config = partial(settings, EstimateConfig, "estimate")


@cache
def _loop(robot: str) -> ClosedLoop:
    return ClosedLoop(robot=robot, record=False)


class ErrorLog:
    """Logs errors (12,), in the order of ``StateEstimator.base_covariance``, and covariances every ``period`` [s]."""

    def __init__(self, loop: ClosedLoop, period: float) -> None:
        self._loop, self._every = loop, max(round(period / loop.plant.period), 1)
        self._tick = 0
        self.times: list[float] = []
        self.errors: list[NDArray[np.float64]] = []
        self.covariances: list[NDArray[np.float64]] = []
        self.positions: list[NDArray[np.float64]] = []

    def step(self) -> None:
        """Step the robot and take a sample when due."""
        self._tick += 1
        if self._tick % self._every:
            self._loop.step()
            return
        truth = self._loop.truth  # at the instant of this tick's sensor data
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
    """Return the NEES (n,) of the rows ``part`` of errors (n, 12) with covariances (n, 12, 12)."""
    e = errors[:, part]
    solved = np.linalg.solve(covariances[:, part[:, None], part], e[:, :, None])[:, :, 0]
    return np.asarray(np.einsum("ni,ni->n", e, solved))


def _push(log: ErrorLog, loop: ClosedLoop, seed: int, config: EstimateConfig) -> None:
    force = config.push_speed * loop.robot.mass / config.push_duration
    for k in range(config.pushes):
        angle = 2.0 * math.pi * (3 * k + seed) / config.directions
        loop.apply_push((force * math.cos(angle), force * math.sin(angle), 0.0), config.push_duration)
        log.run(config.push_period)


def _walk(log: ErrorLog, loop: ClosedLoop, seed: int, config: EstimateConfig) -> None:
    start_walk(loop, config.walk_velocity)
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
    """Return the function that runs each scenario, by name."""
    return {
        "stand": lambda log, loop, seed, config: log.run(config.stand_time),
        **{name: _motion(name) for name in estimate_config().motions},
        "push": _push,
        "walk": _walk,
    }


def measure(robot: str, seed: int, scenario: str) -> Case:
    """Measure one run of a scenario; the seed also selects the directions of the pushes."""
    config, loop = estimate_config(), _loop(robot)
    loop.reset(seed)
    loop.run(config.settle_time)
    log = ErrorLog(loop, config.sample_period)
    scenarios()[scenario](log, loop, seed, config)
    t, errors, covariances = np.array(log.times), np.array(log.errors), np.array(log.covariances)
    path = np.array(log.positions)
    every = max(round(config.instant_period / config.sample_period), 1)
    rms = {name: float(np.sqrt((errors[:, part] ** 2).sum(axis=1).mean())) for name, part in PARTS.items()}
    return {
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


def time_steps(robot: str) -> dict[str, float]:
    """Return ``estimator_us_*`` and ``tick_us_*`` of alternating calls in one run, and ``allocated_blocks_growth``."""
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


WALK = "walk"


def interval(size: int, runs: int, confidence: float) -> tuple[float, float]:
    """Return the two-sided interval of the mean over ``runs`` of the NEES of ``size`` components."""
    tails = (0.5 - 0.5 * confidence, 0.5 + 0.5 * confidence)
    low, high = (float(chi2.ppf(tail, size * runs)) / runs for tail in tails)
    return low, high


def mean_nees(cases: list[Case], part: str) -> NDArray[np.float64]:
    """Return the NEES of a part at every instant, averaged over the runs of one scenario (n,)."""
    count = min(len(case["nees"][part]) for case in cases)
    return np.asarray(np.mean([case["nees"][part][:count] for case in cases], axis=0))


def drift(case: Case) -> float:
    """Return the growth of the position error over the distance walked [-]."""
    return float(np.linalg.norm(case["drift"]) / case["distance"])


def summarise(results: list[Case], config: EstimateConfig) -> dict[str, float]:
    """Compute the figures: errors of the worst seed per scenario and, without suffix, over all except walking."""
    figures: dict[str, float] = {}
    groups = {name: [case for case in results if case["scenario"] == name] for name in scenarios()}
    errors = ("velocity_rmse", "tilt_rmse_deg", "height_rmse")
    for error in errors:
        worst = {name: max(case[error] for case in cases) for name, cases in groups.items()}
        figures[error] = max(value for name, value in worst.items() if name != WALK)
        figures |= {f"{error}_{name}": value for name, value in worst.items()}
    walks = groups[WALK]
    figures["drift"] = max(drift(case) for case in walks)
    figures["drift_median"] = float(np.median([drift(case) for case in walks]))
    figures["drift_horizontal"] = max(float(np.linalg.norm(case["drift"][:2])) / case["distance"] for case in walks)
    figures["drift_height_mean_m"] = float(np.mean([case["drift"][2] for case in walks]))
    figures["walk_distance_m"] = float(np.median([case["distance"] for case in walks]))
    for part, rows in PARTS.items():
        for name, cases in groups.items():
            values = mean_nees(cases, part)
            low, high = interval(rows.size, len(cases), config.confidence)
            figures[f"nees_{part}_{name}"] = float(values.mean())
            figures[f"nees_{part}_{name}_below"] = float((values < low).mean())
            figures[f"nees_{part}_{name}_above"] = float((values > high).mean())
    figures["fallen"] = float(sum(not case["ok"] for case in results))
    return figures


class Estimate(Benchmark):
    """Time the step with nothing else running, then measure every scenario with every seed."""

    measure = staticmethod(measure)

    def cases(self, options: Options) -> list[Case]:
        seeds = options.each_seed()
        return [{"robot": options.robot, "seed": seed, "scenario": name} for seed in seeds for name in scenarios()]

    def figures(self, cases: list[Case]) -> dict[str, float]:
        return summarise(cases, estimate_config())

    def bounds(self, report: Report) -> dict[str, Bound]:
        confidence = estimate_config().confidence
        honest = {
            f"nees_{part}_{name}": Bound(*interval(rows.size, report.seeds, confidence))
            for part, rows in PARTS.items()
            for name in scenarios()
        }
        return super().bounds(report) | honest

    def notes(self, report: Report) -> list[str]:
        fell = [case for case in report.cases if not case["ok"]]
        return super().notes(report) + [
            f"fell: {case['scenario']} seed {case['seed']}: {case['reason']}" for case in fell
        ]

    def survived(self, case: Case) -> tuple[str, bool]:
        return case["scenario"], bool(case["ok"])

    def run(self, options: Options) -> Report:
        load = LoadMeter()
        step = [{"robot": options.robot}]
        timed = run_cases(time_steps, step, bench="estimate_step", options=options, alone=True)[0]
        results = run_cases(self.measure, self.cases(options), bench=self.name, options=options)
        timed.pop("robot")
        return self.report(options, results, self.figures(results) | timed, load)
