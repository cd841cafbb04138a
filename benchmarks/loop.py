"""Speed of a whole closed loop on one core, as a multiple of real time, and where its time goes.

The robot stands, then walks straight ahead, in lockstep (``ClosedLoop``) with sensor noise, estimator and the delay of
its profile, without a log. Second by second, in turn: the loop as everybody runs it, with clocks read around it and
none inside; the loop with every tick split by stage (``benchmarks/loop_timing.py``); and the physics of that second
alone (``bridge/bare_physics.py``), the least that a tick can take. So ratios are of the same run. The process is held
to one core. Speed is judged by the processor time of the whole process, all threads: what others on a shared machine
take of the core is not the loop's. That by the clock stands beside it. The garbage collector is off.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass as schema

from benchmarks.commands import advance, demand
from benchmarks.harness import Case, Options, Report, percentiles
from benchmarks.loop_stages import SCENARIOS, draw_stages, stage_figure
from benchmarks.loop_timing import PIECE, STAGES, Pieces, one_core, time_pieces
from benchmarks.timed_run import MICRO, QUANTILES, Positive, collector_off, plot_tails, run_seeds
from bridge.closed_loop import ClosedLoop
from bridge.plots import new_figure
from models.config import STRICT, default_config

NANO = 1e-9
"""Nanoseconds to seconds."""


@schema(frozen=True, slots=True, config=STRICT)
class LoopBenchConfig:
    """What is run and its bounds; the unit of every value stands in ``benchmarks/config/loop.yaml``."""

    forward: float
    warm_up_stand: Positive
    warm_up_walk: Positive
    pieces: Annotated[int, Field(ge=1)]
    real_time_min: Positive
    threads_max: Annotated[float, Field(ge=0.0)]


@cache
def loop_config() -> LoopBenchConfig:
    """The packaged configuration."""
    return default_config(LoopBenchConfig, "benchmarks", "loop")


def measure(robot: str, seed: int) -> Case:
    """Time a robot, by name of its profile, that stands, then walks; the seed is that of the sensor noise.

    Returns:
        ``figures`` of this run, and ``quantiles`` [us] at ``QUANTILES`` of the ticks of each scenario.

    Raises:
        PoiseError: The robot fell, or would not walk.
    """
    config = loop_config()
    loop = ClosedLoop(robot=robot, seed=seed, record=False)
    found: dict[str, Pieces] = {}
    with one_core(), collector_off():
        for scenario in SCENARIOS:
            if scenario == "walk":
                demand(loop, "walk")
                loop.set_velocity(config.forward, 0.0, 0.0)
            advance(loop, config.warm_up_walk if scenario == "walk" else config.warm_up_stand)
            found[scenario] = time_pieces(loop, config.pieces)
    quantiles = {f"tick_{name}": np.percentile(pieces.ticks, QUANTILES).tolist() for name, pieces in found.items()}
    return {"figures": summarise(found), "quantiles": quantiles}


def summarise(found: Mapping[str, Pieces], piece: float = PIECE) -> dict[str, float]:
    """Figures of every scenario; the names say the unit, ratios and shares have none.

    Args:
        found: What was timed, by scenario.
        piece: Length of each piece [s].

    Raises:
        ValueError: Every tick of a scenario was interrupted.
    """
    figures: dict[str, float] = {}
    for name, pieces in found.items():
        wall, cpu = (np.array([getattr(span, of) for span in pieces.plain]) for of in ("wall", "process"))
        bare = np.array([span.process for span in pieces.bare])
        watched = np.array([span.process for span in pieces.split])
        figures[f"core_share_{name}"] = share = float(np.median(cpu)) * NANO / piece
        figures[f"real_time_{name}_cpu"] = 1.0 / share
        figures[f"real_time_{name}"] = piece / (float(np.median(wall)) * NANO)
        figures[f"cpu_per_wall_{name}"] = float(cpu.sum() / wall.sum())
        figures[f"ratio_to_physics_{name}"] = float(np.median(cpu / bare))
        figures[f"split_over_plain_{name}"] = float(np.median(watched / cpu))
        figures[f"bare_physics_{name}_us"] = float(np.median(bare)) * MICRO * len(bare) / len(pieces.ticks)
        figures |= percentiles(pieces.ticks[pieces.kept], f"tick_{name}_us")
        figures[f"tick_{name}_ungated_us_p99"] = float(np.percentile(pieces.ticks, 99.0))
        figures[f"tick_{name}_us_mean"] = float(pieces.ticks[pieces.kept].mean())
        means = pieces.stages[pieces.kept].mean(axis=0)
        figures |= {stage_figure(stage, name): float(mean) for stage, mean in zip(STAGES, means, strict=True)}
    plain = [span for pieces in found.values() for span in pieces.plain]
    process, own = sum(span.process for span in plain), sum(span.thread for span in plain)
    figures["other_threads_share"] = max(1.0 - own / process, 0.0)
    figures["preempted_fraction"] = 1.0 - float(np.concatenate([pieces.kept for pieces in found.values()]).mean())
    return figures


def limits(config: LoopBenchConfig) -> dict[str, float]:
    """Largest value of each figure that passes."""
    shares = {f"core_share_{name}": 1.0 / config.real_time_min for name in SCENARIOS}
    return shares | {"other_threads_share": config.threads_max}


def run(options: Options) -> Report:
    """Time every seed; see ``run_seeds`` for how, and ``summarise`` for the figures.

    Args:
        options: Robot and seeds.
    """
    report = run_seeds("loop", options, measure, limits(loop_config()))
    told = (
        f"{name} {report.figures[f'real_time_{name}_cpu']:.2f}, by the clock {report.figures[f'real_time_{name}']:.2f}"
        for name in SCENARIOS
    )
    report.notes.append(f"times real time by processor time, which is judged: {'; '.join(told)}; without a log")
    return report


def plot(report: Report, folder: Path) -> list[Path]:
    """Draw the stages of a tick, and how long ticks take at every percentile; returns the file written."""
    figure = new_figure(9.0, 4.0)
    left, right = figure.subplots(1, 2, width_ratios=(1, 2))
    draw_stages(left, [report])
    plot_tails(right, [f"tick_{name}" for name in SCENARIOS], report.cases)
    figure.suptitle(f"{report.robot}: a tick of the whole closed loop", fontsize=10)
    file = folder / f"loop-{report.robot}.png"
    figure.savefig(file, dpi=110)
    return [file]
