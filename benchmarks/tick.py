"""Time of the whole-body tick in the closed loop, beside placo's dynamics solver and bare Pinocchio calls.

The robot waves and is pushed from all sides, so that the set of active rows changes. On every tick the state that the
estimator hands to ``BalanceController.step`` also goes to the peers (``benchmarks/tick_peers.py``), in changing order,
so that caches and the speed of the machine are the same for all. Times are wall-clock times of the calls; samples
during which the scheduler took the core away (involuntary context switches of the thread) are left out and counted.
Medians make the ratios. The garbage collector is off while it is timed: what the tick allocates must go by itself.
Where pink and mink are installed, a shorter run of its own has their inverse kinematics beside the tick
(``benchmarks/tick_kinematic_peers.py``), so that they neither cool its caches nor count as what it allocates.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass as schema

from benchmarks.commands import demand, keep_upright
from benchmarks.harness import Case, Options, Report, percentiles
from benchmarks.push import stance
from benchmarks.push_bounds import ankle_bound
from benchmarks.tick_kinematic_peers import installed_peers
from benchmarks.tick_timing import STAGES, SUBJECTS, TimedController, solution_figures
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
from bridge.support_polygon import distance_along
from models.config import STRICT, default_config
from models.robot_model import RobotModel
from models.types import Mode, Vector

Count = Annotated[int, Field(ge=1)]


@schema(frozen=True, slots=True, config=STRICT)
class TickConfig(TickBounds):
    """The tick test; the unit of every value stands in ``benchmarks/config/tick.yaml``."""

    warm_up: Positive
    duration: Positive
    kinematics_duration: Positive
    motion: str
    push_ratio: Positive
    push_period: Positive
    push_duration: Positive
    push_body: str
    directions: Count
    stage_period: Annotated[int, Field(ge=2)]
    active_tolerance: Positive


@cache
def tick_config() -> TickConfig:
    """The packaged test."""
    return default_config(TickConfig, "benchmarks", "tick")


def push_forces(loop: ClosedLoop, config: TickConfig) -> list[Vector]:
    """Force of each push in W (3,) [N], the present centre of pressure taken as that at rest."""
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


def exercise(loop: ClosedLoop, duration: float, config: TickConfig) -> Iterator[None]:
    """Wave and push for a time [s]; yields after every second.

    Raises:
        PoiseError: The robot fell, or would not move.
    """
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


def measure(robot: str, seed: int) -> Case:
    """Time the ticks of one run.

    Args:
        robot: Name of the profile.
        seed: Seed of the sensor noise.

    Returns:
        ``figures`` of this run, and of every subject its ``quantiles`` [us] at ``QUANTILES``.
    """
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
    demand(loop, config.motion)
    loop.run(config.warm_up)
    blocks = []
    with collector_off():
        timed.recording = True
        for _ in exercise(loop, config.duration, config):
            blocks.append(sys.getallocatedblocks())
    figures = summarise(timed)
    figures["allocated_blocks_growth"] = blocks_growth(blocks, loop.plant.period)
    timed.recording = timed.peers = False
    figures["resident_growth_kib"] = resident_growth(loop.run, config.push_period, config.memory_time)
    kept = timed.wall[: timed.count] * MICRO
    quantiles = {name: np.percentile(kept[:, i], QUANTILES).tolist() for i, name in enumerate(SUBJECTS)}
    figures |= beside_kinematics(model, seed, config)
    return {"figures": figures, "quantiles": quantiles, "blocks": blocks}


def beside_kinematics(model: RobotModel, seed: int, config: TickConfig) -> dict[str, float]:
    """Time pink and mink, as far as they are installed, and the tick of the same run.

    Returns:
        Of each ``<name>_us_p50`` and ``_p99`` [us], and ``ratio_to_<name>`` of the tick of this run; empty for none.
    """
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
    demand(loop, config.motion)
    loop.run(config.warm_up)
    timed.recording = True
    for _ in exercise(loop, config.kinematics_duration, config):
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
    """Figures of what was recorded; the names say the unit, ratios and counts have none."""
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


def run(options: Options) -> Report:
    """Time every seed; see ``run_seeds`` for how, and ``summarise`` for the figures.

    Args:
        options: Robot and seeds.
    """
    return run_seeds("tick", options, measure, tick_limits(tick_config()))


def plot(report: Report, folder: Path) -> list[Path]:
    """Draw the stages of the tick, and how long tick and peers take at every percentile.

    Args:
        report: What ``run`` found.
        folder: Where the picture goes.

    Returns:
        The file written.
    """
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
    file = folder / f"tick-{report.robot}.png"
    figure.savefig(file, dpi=110)
    return [file]
