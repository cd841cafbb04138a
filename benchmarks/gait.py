"""Time of the gait planner, of one step adjustment, and of the whole-body tick in single support.

The robot walks in lockstep at one velocity, estimator and sensor noise included. The whole-body tick (walking
controller with its QP) runs beside placo's dynamics solver and the bare Pinocchio calls at the same state
(``benchmarks/tick_peers.py``) and is judged like the standing one (``benchmarks/tick.py``). placo runs in every other
second only, and only the ratio to it is taken from those: it empties the caches, and the planner would be timed
beside something that no robot runs. As there, samples during which the scheduler took the core away are left out and
counted, and the garbage collector is off.
"""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic.dataclasses import dataclass as schema

from benchmarks.commands import advance, demand
from benchmarks.gait_timing import ADJUSTMENT, GAIT, PINOCCHIO, PLACO, SUBJECTS, TICK, TimedWalk
from benchmarks.harness import Case, Options, Report, percentiles
from benchmarks.tick_timing import solution_figures
from benchmarks.timed_run import (
    MICRO,
    QUANTILES,
    Positive,
    TickBounds,
    blocks_growth,
    collector_off,
    plot_tails,
    resident_growth,
    run_seeds,
    tick_limits,
)
from bridge.closed_loop import ClosedLoop
from bridge.plots import new_figure
from models.config import STRICT, default_config


@schema(frozen=True, slots=True, config=STRICT)
class GaitBenchConfig(TickBounds):
    """The walk and its bounds; the unit of every value stands in ``benchmarks/config/gait.yaml``."""

    forward: float
    warm_up: Positive
    duration: Positive
    gait_max: Positive
    adjustment_max: Positive


@cache
def _config() -> GaitBenchConfig:
    return default_config(GaitBenchConfig, "benchmarks", "gait")


def measure(robot: str, seed: int) -> Case:
    """Time the ticks of one walk.

    Args:
        robot: Name of the profile.
        seed: Seed of the sensor noise.

    Returns:
        ``figures`` of this walk, and of every subject its ``quantiles`` [us] at ``QUANTILES``.

    Raises:
        PoiseError: The robot fell, or would not walk.
    """
    config = _config()
    loop = ClosedLoop(robot=robot, seed=seed, record=False)
    demand(loop, "walk")
    loop.set_velocity(config.forward, 0.0, 0.0)
    advance(loop, config.warm_up)
    timed = TimedWalk(loop.walker, round(config.duration / loop.plant.period) + 1)
    with collector_off(), timed.recording():
        for second in range(round(config.duration)):
            timed.with_placo = second % 2 == 1
            advance(loop, 1.0)
    blocks: list[int] = []
    settle = 2  # seconds

    def walk_alone(time: float) -> None:
        """Nothing beside the robot allocates now."""
        for _ in range(round(time)):
            advance(loop, 1.0)
            blocks.append(sys.getallocatedblocks())

    figures = summarise(timed)
    figures["resident_growth_kib"] = resident_growth(walk_alone, settle, config.memory_time)
    figures["allocated_blocks_growth"] = blocks_growth(blocks[settle:], loop.plant.period)
    rows = _rows(timed)
    quantiles = {
        name: np.percentile(timed.watch.wall[rows[:, i], i] * MICRO, QUANTILES).tolist()
        for i, name in enumerate(SUBJECTS)
    }
    return {"figures": figures, "quantiles": quantiles}


def _rows(timed: TimedWalk) -> NDArray[np.bool_]:
    """The ticks that count for each subject, pre-empted or not (ticks, 5)."""
    rows = np.zeros(timed.watch.wall.shape, dtype=bool)
    n = timed.count
    alone, single = ~timed.beside[:n], timed.single[:n]
    rows[:n, GAIT] = alone
    rows[:n, ADJUSTMENT] = alone & timed.adjusted[:n]
    rows[:n, TICK] = rows[:n, PINOCCHIO] = alone & single
    rows[:n, PLACO] = ~alone & single
    return rows


def summarise(timed: TimedWalk) -> dict[str, float]:
    """Figures of what was recorded; the names say the unit, ratios and counts have none.

    Raises:
        ValueError: There is no tick of some kind.
    """
    rows, wall, preempted = _rows(timed), timed.watch.wall * MICRO, timed.watch.preempted
    figures: dict[str, float] = {}
    kept = rows & ~preempted
    for i, name in enumerate(SUBJECTS):
        figures |= percentiles(wall[kept[:, i], i], f"{name}_us")
        figures[f"{name}_ungated_us_p99"] = float(np.percentile(wall[rows[:, i], i], 99.0))
    beside = rows[:, PLACO] & ~preempted[:, TICK]
    figures["tick_beside_placo_us_p50"] = float(np.median(wall[beside, TICK]))
    figures["ratio_to_placo"] = figures["tick_beside_placo_us_p50"] / figures["placo_us_p50"]
    figures["ratio_to_pinocchio_calls"] = figures["tick_us_p50"] / figures["pinocchio_calls_us_p50"]
    figures["p99_over_median"] = figures["tick_us_p99"] / figures["tick_us_p50"]
    figures["pinocchio_calls_p99_over_median"] = figures["pinocchio_calls_us_p99"] / figures["pinocchio_calls_us_p50"]
    figures["preempted_fraction"] = 1.0 - float(kept[:, GAIT].sum() / rows[:, GAIT].sum())
    counted = {"ticks": rows[:, GAIT], "adjustments": rows[:, ADJUSTMENT], "ticks_single_support": rows[:, TICK]}
    figures |= {name: float(chosen.sum()) for name, chosen in counted.items()}
    figures |= solution_figures(timed.residual[: timed.count], timed.status[: timed.count])
    figures["placo_failed"] = float(timed.placo_failed)
    return figures


def limits(config: GaitBenchConfig) -> dict[str, float]:
    """Largest value of each figure that passes."""
    return {
        "gait_us_p99": config.gait_max,
        "adjustment_us_p50": config.adjustment_max,
        "adjustment_us_p99": config.adjustment_max,
        **tick_limits(config),
    }


def run(options: Options) -> Report:
    """Time every seed; see ``run_seeds`` for how, and ``summarise`` for the figures.

    Args:
        options: Robot and seeds.
    """
    return run_seeds("gait", options, measure, limits(_config()))


def plot(report: Report, folder: Path) -> list[Path]:
    """Draw how long each subject takes at every percentile.

    Args:
        report: What ``run`` found.
        folder: Where the picture goes.

    Returns:
        The file written.
    """
    figure = new_figure(7.0, 4.5)
    plot_tails(figure.subplots(), SUBJECTS, report.cases)
    figure.suptitle(f"{report.robot}: gait, and whole-body tick in single support", fontsize=10)
    file = folder / f"gait-{report.robot}.png"
    figure.savefig(file, dpi=110)
    return [file]
