"""Time of the whole-body tick in the closed loop, beside placo's dynamics solver and bare Pinocchio calls.

The robot waves and is pushed from all sides, so that the set of active rows changes. On every tick the state of
``BalanceController.step`` also goes to the peers (``tick_peers.py``), in changing order, so that caches and the speed
of the machine are the same for all. Pre-empted samples (involuntary context switches of the thread) are left out and
counted. Medians make the ratios. The garbage collector is off: what the tick allocates must be freed by itself. Where
pink and mink are installed, a separate shorter run has their inverse kinematics beside the tick, so that they neither
cool its caches nor count as its allocations. Another run times the whole ``ControlStack`` (``time_stack``).
"""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass as schema

from benchmarks.core.benchmark import Bound, Positive, at_most, saved, settings
from benchmarks.core.harness import Case, Report, percentiles
from benchmarks.core.loops import demand
from benchmarks.core.timed_run import (
    MICRO,
    QUANTILES,
    TickBounds,
    TimedBenchmark,
    blocks_growth,
    collector_off,
    plot_tails,
    resident_growth,
    tick_bounds,
)
from benchmarks.speed.tick_peers import installed_peers
from benchmarks.speed.tick_timing import MODES, STAGES, SUBJECTS, TimedController, solution_figures, time_stack
from benchmarks.stability.exercise import exercise, exercise_config
from bridge.closed_loop import ClosedLoop
from bridge.plots import new_figure
from models.config import STRICT
from models.robot_model import RobotModel


@schema(frozen=True, slots=True, config=STRICT)
class TickConfig(TickBounds):
    """The tick test; the unit of every value stands in ``benchmarks/config/tick.yaml``."""

    duration: Positive
    kinematics_duration: Positive
    stack_warm_up: Positive
    stack_duration: Positive
    stack_speed: Positive
    stack_us_max: Positive
    stage_period: Annotated[int, Field(ge=2)]
    active_tolerance: Positive


tick_config = partial(settings, TickConfig, "tick")


def measure(robot: str, seed: int) -> Case:
    """Time the ticks of one run: ``figures``, and ``quantiles`` [us] of every subject at ``QUANTILES``."""
    config = tick_config()
    model = RobotModel.load(robot)
    ticks = round(config.duration / 0.001) + 1
    timed = TimedController(
        model,
        ticks=ticks,
        stage_period=config.stage_period,
        active_tolerance=config.active_tolerance,
    )
    loop = ClosedLoop(robot=model, seed=seed, record=False, controller=timed)
    demand(loop, exercise_config().motion)
    loop.run(exercise_config().warm_up)
    blocks = []
    with collector_off():
        timed.recording = True
        for _ in exercise(loop, config.duration, exercise_config()):
            blocks.append(sys.getallocatedblocks())
    figures = summarise(timed)
    figures["allocated_blocks_growth"] = blocks_growth(blocks, loop.plant.period)
    timed.recording = timed.peers = False
    figures["resident_growth_kib"] = resident_growth(loop.run, exercise_config().push_period, config.memory_time)
    kept = timed.wall[: timed.count] * MICRO
    quantiles = {name: np.percentile(kept[:, i], QUANTILES).tolist() for i, name in enumerate(SUBJECTS)}
    figures |= beside_kinematics(model, seed, config)
    figures |= time_stack(
        model, seed, warm_up=config.stack_warm_up, duration=config.stack_duration, speed=config.stack_speed
    )
    return {"figures": figures, "quantiles": quantiles, "blocks": blocks}


def beside_kinematics(model: RobotModel, seed: int, config: TickConfig) -> dict[str, float]:
    """Time pink and mink where installed: ``<name>_us_p50`` and ``_p99`` [us], and ``ratio_to_<name>`` of the tick."""
    peers = installed_peers(model)
    if not peers:
        return {}
    timed = TimedController(
        model,
        ticks=round(config.kinematics_duration / 0.001) + 1,
        stage_period=config.stage_period,
        active_tolerance=config.active_tolerance,
        kinematic=peers,
    )
    loop = ClosedLoop(robot=model, seed=seed, record=False, controller=timed)
    demand(loop, exercise_config().motion)
    loop.run(exercise_config().warm_up)
    timed.recording = True
    for _ in exercise(loop, config.kinematics_duration, exercise_config()):
        pass
    wall, kept = timed.wall[: timed.count] * MICRO, ~timed.preempted[: timed.count]
    figures: dict[str, float] = {}
    kept[timed.stages[: timed.count].any(axis=1), 0] = False
    tick = float(np.median(wall[kept[:, 0], 0]))
    for i, name in enumerate(timed.subjects[len(SUBJECTS) :], start=len(SUBJECTS)):
        p50, p99 = np.percentile(wall[kept[:, i], i], [50.0, 99.0])
        figures |= {f"{name}_us_p50": float(p50), f"{name}_us_p99": float(p99), f"ratio_to_{name}": tick / float(p50)}
    return figures


def summarise(timed: TimedController) -> dict[str, float]:
    """Figures of the recorded ticks, with the unit in the name."""
    n = timed.count
    wall, cpu = timed.wall[:n] * MICRO, timed.cpu[:n] * MICRO
    staged = timed.stages[:n].any(axis=1)
    kept = ~timed.preempted[:n]
    kept[staged, 0] = False
    whole = ~staged
    figures = percentiles(wall[kept[:, 0], 0], "tick_us")
    figures["p99_over_median"] = figures["tick_us_p99"] / figures["tick_us_p50"]
    median = {name: float(np.median(wall[kept[:, i], i])) for i, name in enumerate(SUBJECTS)}
    for name in SUBJECTS[1:]:
        figures[f"ratio_to_{name}"] = median["tick"] / median[name]
    for i, name in enumerate(SUBJECTS[1:], start=1):
        figures |= {f"{name}_us_p50": median[name], f"{name}_us_p99": float(np.percentile(wall[kept[:, i], i], 99.0))}
    for i, stage in enumerate(STAGES):
        figures[f"{stage}_us_p50"] = float(np.median(timed.stages[:n][staged & ~timed.preempted[:n, 0], i])) * MICRO
    figures |= percentiles(wall[whole, 0], "tick_ungated_us")
    figures |= percentiles(cpu[whole, 0], "tick_cpu_us")
    figures["ratio_to_placo_cpu"] = float(np.median(cpu[whole, 0]) / np.median(cpu[:, 1]))
    figures["preempted_fraction"] = float(timed.preempted[:n][whole, 0].mean())
    figures["ticks"] = float(n)
    figures |= solution_figures(timed.residual[:n], timed.status[:n])
    figures["active_set_changes"] = float(np.count_nonzero(timed.changed[:n]))
    figures["active_rows_mean"] = float(timed.active[:n].mean())
    figures["active_rows_max"] = float(timed.active[:n].max())
    figures["placo_failed"] = float(timed.placo_failed)
    return figures


class Tick(TimedBenchmark):
    """See the module's text."""

    measure = staticmethod(measure)

    def bounds(self, report: Report) -> dict[str, Bound]:
        """Bounds of the whole-body tick, and of the whole stack."""
        stack = {f"stack_{mode}_us_p99": tick_config().stack_us_max for mode in MODES}
        return tick_bounds(tick_config()) | at_most(stack)

    def plots(self, report: Report, folder: Path) -> list[Path]:
        """Draw the stages of the tick, and how long tick and peers take at every percentile."""
        figure = new_figure(9.0, 4.0)
        left, right = figure.subplots(1, 2, width_ratios=(1, 2))
        bottom = 0.0
        for stage in STAGES:
            height = report.figures[f"{stage}_us_p50"]
            left.bar(["tick"], [height], bottom=bottom, label=stage)
            bottom += height
        for name in SUBJECTS[1:]:
            left.bar([name.replace("_", "\n")], [report.figures[f"{name}_us_p50"]], color="0.7")
        left.set_ylabel("median [us]")
        left.tick_params(labelsize=7)
        left.legend(fontsize=7)
        plot_tails(right, SUBJECTS, report.cases)
        figure.suptitle(f"{report.robot}: whole-body tick in the closed loop", fontsize=10)
        return [saved(figure, folder / f"tick-{report.robot}.png")]
