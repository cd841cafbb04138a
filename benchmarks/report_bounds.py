"""What each benchmark holds its figures to, for who reads a report; the verdict is the benchmark's own."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from benchmarks import gait, loop
from benchmarks.calibrate import CalibrateConfig
from benchmarks.endurance import EnduranceConfig
from benchmarks.estimate_runs import settings
from benchmarks.fault_rows import config as fault_config
from benchmarks.harness import Report
from benchmarks.latency_config import latency_config
from benchmarks.loop_stages import SCENARIOS
from benchmarks.push import PushConfig
from benchmarks.push_trial import map_config
from benchmarks.stand import StandConfig
from benchmarks.terrain import TerrainConfig
from benchmarks.tick import tick_config
from benchmarks.timed_run import tick_limits
from benchmarks.walk_config import robot_walk, walk_config
from models.config import default_config

ROUNDING = 1e-9
"""By which a sum of steps may miss a bound that it meets."""


@dataclass(frozen=True, slots=True)
class Bound:
    """What a figure is held to.

    Attributes:
        value: The bound, in the figure's unit.
        least: Whether the figure must reach it; else it must not exceed it.
    """

    value: float
    least: bool = False

    def holds(self, figure: float) -> bool:
        """Whether a figure is on the right side; one that was not measured is not."""
        return figure >= self.value - ROUNDING if self.least else figure <= self.value + ROUNDING

    def __str__(self) -> str:
        return f"{'≥' if self.least else '≤'} {self.value:.4g}"


def bounds_of(report: Report) -> dict[str, Bound]:
    """Bound of every figure of a report that has one, by the figure's name."""
    return BOUNDS[report.bench](report) if report.bench in BOUNDS else {}


def _most(values: Mapping[str, float]) -> dict[str, Bound]:
    return {name: Bound(value) for name, value in values.items()}


def _least(values: Mapping[str, float]) -> dict[str, Bound]:
    return {name: Bound(value, least=True) for name, value in values.items()}


def _gait(report: Report) -> dict[str, Bound]:
    return _most(gait.limits(default_config(gait.GaitBenchConfig, "benchmarks", "gait")))


def _loop(report: Report) -> dict[str, Bound]:
    given = loop.loop_config()
    times = {f"real_time_{name}_cpu": given.real_time_min for name in SCENARIOS}
    return _least(times) | _most({"other_threads_share": given.threads_max})


def _latency(report: Report) -> dict[str, Bound]:
    found: dict[str, float] = {
        name: report.figures[f"{name[:3]}_bound_us"] for name in ("p50_us", "p99_us") if name in report.figures
    }
    return _most({**found, "missed_fraction": latency_config().missed_bound})


def _estimate(report: Report) -> dict[str, Bound]:
    given = settings()
    return _most({
        "velocity_rmse": given.velocity_rmse_max,
        "tilt_rmse_deg": given.tilt_rmse_max,
        "height_rmse": given.height_rmse_max,
        "velocity_rmse_walk": given.walk_velocity_rmse_max,
        "drift": given.drift_max,
        "estimator_us_p50": given.step_us_max,
        "fallen": 0.0,
    })  # fmt: skip


def _stand(report: Report) -> dict[str, Bound]:
    given = default_config(StandConfig, "benchmarks", "stand")
    return {
        "stood": Bound(report.figures["stand_total"], least=True),
        "motions_survived": Bound(report.figures["motions_total"], least=True),
        "com_drift_max_m": Bound(given.com_drift_limit),
        "foot_slide_max_m": Bound(given.foot_slide_limit),
        "joint_speed_mean_max_rad_s": Bound(given.joint_speed_limit),
    }


def _push(report: Report) -> dict[str, Bound]:
    return _least({"ratio_to_ankle_bound_min": default_config(PushConfig, "benchmarks", "push").required_ratio})


def _push_map(report: Report) -> dict[str, Bound]:
    required = map_config().required[report.bench.removeprefix("push_")]
    return _least({"dv_min": required.smallest, "dv_median": required.median})


def _walk(report: Report) -> dict[str, Bound]:
    given, robot = walk_config(), robot_walk(report.robot)
    speeds = {f"speed_error_{name}": given.speed_error_limit for name in robot.scenarios}
    stop = {"stop_drift_max_m": given.stand_drift_limit, "stop_steps_max": float(given.stop_steps)}
    return _most({"falls": 0.0, **speeds, **stop}) | _least({"top_speed": robot.required_top_speed})


def _terrain(report: Report) -> dict[str, Bound]:
    given = default_config(TerrainConfig, "benchmarks", "terrain")
    walks = {name: report.figures.get(f"total_{name}", 0.0) for name in given.conditions}
    required = {name: math.ceil(given.required_share * total - ROUNDING) for name, total in walks.items()}
    return _least({f"survived_{name}": float(count) for name, count in required.items()})


def _calibrate(report: Report) -> dict[str, Bound]:
    share = default_config(CalibrateConfig, "benchmarks", "calibrate").share
    left = {name: share for name in report.figures if name.endswith("_left_max")}
    return _most({"failed": 0.0, **left})


def _faults(report: Report) -> dict[str, Bound]:
    margins = {f"{name}_s": margin.required for name, margin in fault_config().margins.items()}
    return _least({"survived": report.figures["total"], **margins})


def _endurance(report: Report) -> dict[str, Bound]:
    given = default_config(EnduranceConfig, "benchmarks", "endurance")
    limits = {"memory_growth_mib": given.memory_limit, "torque_step_max": given.torque_step_limit}
    return _most({"falls_and_faults": 0.0, **limits})


BOUNDS: dict[str, Callable[[Report], dict[str, Bound]]] = {
    "tick": lambda report: _most(tick_limits(tick_config())),
    "qp": lambda report: _least({"poise_solved": 1.0}),
    "gait": _gait,
    "loop": _loop,
    "latency": _latency,
    "estimate": _estimate,
    "stand": _stand,
    "push": _push,
    "push_step": _push_map,
    "push_walk": _push_map,
    "walk": _walk,
    "terrain": _terrain,
    "calibrate": _calibrate,
    "faults": _faults,
    "graph_faults": lambda report: _least({"survived": report.figures["total"]}),
    "endurance": _endurance,
}
"""By bench."""
