"""Speed of a whole closed loop on one core, as a multiple of real time, and its time by stage.

The robot stands, then walks straight ahead in lockstep (``ClosedLoop``) with sensor noise, estimator and the delay of
its profile, without a log. Second by second, in turn: the plain loop, with clocks read around it only; the loop with
every tick split by stage (``loop_timing.py``); and the physics of that second alone
(``bridge/plants/world.py``), the floor of a tick. So ratios are of the same run. The process keeps to one core.
Speed is judged by the processor time of all its threads, which other load does not change; wall time stands beside it.
The garbage collector is off.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass as schema

from benchmarks.core.benchmark import Bound, Positive, at_least, at_most, saved, settings
from benchmarks.core.harness import Case, Report, percentiles
from benchmarks.core.loops import advance, demand
from benchmarks.core.timed_run import MICRO, QUANTILES, TimedBenchmark, collector_off, plot_tails
from benchmarks.speed.loop_timing import (
    PIECE,
    SCENARIOS,
    STAGES,
    Pieces,
    draw_stages,
    one_core,
    stage_figure,
    time_pieces,
)
from bridge.closed_loop import ClosedLoop
from bridge.plots import new_figure
from models.config import STRICT

NANO = 1e-9  # nanoseconds to seconds


@schema(frozen=True, slots=True, config=STRICT)
class LoopBenchConfig:
    """What is run and its bounds; the unit of every value stands in ``benchmarks/config/loop.yaml``."""

    forward: float
    warm_up_stand: Positive
    warm_up_walk: Positive
    pieces: Annotated[int, Field(ge=1)]
    real_time_min: Positive
    threads_max: Annotated[float, Field(ge=0.0)]


loop_config = partial(settings, LoopBenchConfig, "loop")


def measure(robot: str, seed: int) -> Case:
    """Time a robot that stands, then walks: ``figures``, and ``quantiles`` [us] of each scenario's ticks.

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
    """Figures of every scenario from pieces of ``piece`` [s]; ``ValueError`` when every tick of one was interrupted."""
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


class Loop(TimedBenchmark):
    """See the module's text."""

    measure = staticmethod(measure)

    def bounds(self, report: Report) -> dict[str, Bound]:
        """Least speeds, and the largest share of other threads."""
        config = loop_config()
        speeds = {f"real_time_{name}_cpu": config.real_time_min for name in SCENARIOS}
        return at_least(speeds) | at_most({"other_threads_share": config.threads_max})

    def notes(self, report: Report) -> list[str]:
        """Those of time, and the speed by the clock."""
        speeds = (
            f"{name} {report.figures[f'real_time_{name}_cpu']:.2f}, by the clock "
            f"{report.figures[f'real_time_{name}']:.2f}"
            for name in SCENARIOS
        )
        judged = f"times real time by processor time, which is judged: {'; '.join(speeds)}; without a log"
        return [*super().notes(report), judged]

    def plots(self, report: Report, folder: Path) -> list[Path]:
        """Draw the stages of a tick, and how long ticks take at every percentile."""
        figure = new_figure(9.0, 4.0)
        left, right = figure.subplots(1, 2, width_ratios=(1, 2))
        draw_stages(left, [report])
        plot_tails(right, [f"tick_{name}" for name in SCENARIOS], report.cases)
        figure.suptitle(f"{report.robot}: a tick of the whole closed loop", fontsize=10)
        return [saved(figure, folder / f"loop-{report.robot}.png")]
