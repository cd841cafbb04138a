"""What more workers bring: the same cases over one worker and over several, and what a case costs.

A case is a walk of the terrain benchmark. Each count of workers gets a cluster of its own, whose processes load the
robot and its compiled code before the time begins. Passed is when all cases came back, the same to the last bit over
any number of workers; there is no bound on the time.
"""

from __future__ import annotations

import time
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass as schema

from benchmarks.executors import worker_processes
from benchmarks.harness import Case, LoadMeter, Options, Report, Sweep, run_cases
from benchmarks.plain_json import worded
from benchmarks.terrain import walk
from bridge.closed_loop import ClosedLoop
from bridge.plots import new_figure
from models.config import STRICT, default_config

HOUR = 3600.0
"""[s]"""

Count = Annotated[int, Field(ge=1)]


@schema(frozen=True, slots=True, config=STRICT)
class ScalingConfig:
    """The sweep; the unit of every value stands in ``benchmarks/config/scaling.yaml``."""

    workers: Annotated[tuple[Count, ...], Field(min_length=1)]
    cases: Count
    scenario: str
    warm_up: Annotated[float, Field(gt=0.0)]
    planned: Count


@cache
def _config() -> ScalingConfig:
    return default_config(ScalingConfig, "benchmarks", "scaling")


def warm_up(robot: str, seed: int) -> Case:
    """Let a worker load what a case needs.

    Args:
        robot: Name of a profile.
        seed: Of nothing that matters.
    """
    ClosedLoop(robot, seed=seed).run(_config().warm_up)
    return {}


def measure(robot: str, seed: int, scenario: str) -> Case:
    """One walk of the terrain benchmark, and ``seconds`` that it took here [s]."""
    began = time.monotonic()
    outcome = walk(robot, seed, scenario)
    return {"outcome": outcome, "seconds": time.monotonic() - began}


def _round(options: Options, workers: int) -> list[Case]:
    """Every case over so many workers, with the ``wall`` time of all of them [s]."""
    config = _config()
    with worker_processes(workers) as executor:
        given = replace(options, sweep=Sweep(executor))
        first = [{"robot": options.robot, "seed": seed} for seed in range(workers)]
        run_cases(warm_up, first, bench="scaling, warm-up", options=given)
        count = config.cases * options.seeds
        inputs = [{"robot": options.robot, "seed": seed, "scenario": config.scenario} for seed in range(count)]
        began = time.monotonic()
        results = run_cases(measure, inputs, bench=f"scaling, workers: {workers}", options=given)
        wall = time.monotonic() - began
    return [{"workers": workers, "wall": wall, **case} for case in results]


def summarise(results: list[Case], planned: int) -> dict[str, float]:
    """Figures of all rounds.

    Args:
        results: ``workers``, ``wall`` and ``seconds`` [s] of every case.
        planned: Cases of the sweep that is planned.

    Returns:
        ``case_s``: median cost of a case with the fewest workers; ``overhead_s``: of a case, what its round took beyond
        it there; of each count of workers ``wall_<n>_s``, ``speedup_<n>`` and ``efficiency_<n>`` over the fewest, and
        ``planned_<n>_hours``.
    """
    counts = sorted({case["workers"] for case in results})
    rounds = {count: [case for case in results if case["workers"] == count] for count in counts}
    base, fewest = rounds[counts[0]], counts[0]
    spent = sum(case["seconds"] for case in base)
    figures = {
        "case_s": float(np.median([case["seconds"] for case in base])),
        "overhead_s": (fewest * base[0]["wall"] - spent) / len(base),
        "planned_cases": float(planned),
    }
    for count, cases in rounds.items():
        wall = cases[0]["wall"]
        speedup = base[0]["wall"] / wall
        figures |= {
            f"wall_{count}_s": wall,
            f"speedup_{count}": speedup,
            f"efficiency_{count}": speedup * fewest / count,
            f"planned_{count}_hours": planned * wall / len(cases) / HOUR,
        }
    return figures


def same(results: list[Case]) -> bool:
    """Whether every case came out the same over any number of workers."""
    outcomes: dict[int, list[Any]] = {}
    for case in results:
        outcomes.setdefault(case["seed"], []).append(worded(case["outcome"]))  # NaN is not the same as itself
    return all(outcome == found[0] for found in outcomes.values() for outcome in found)


def run(options: Options) -> Report:
    """Measure every count of workers; each seed adds as many cases as are configured.

    Args:
        options: Robot and seeds; its workers and sweep do not count.

    Returns:
        Figures of ``summarise``.
    """
    config, load = _config(), LoadMeter()
    results = [case for workers in config.workers for case in _round(options, workers)]
    figures, equal = summarise(results, config.planned), same(results)
    notes = [f"cases {'are the same' if equal else 'DIFFER'} over {', '.join(map(str, config.workers))} workers"]
    return Report("scaling", options.robot, options.seeds, figures, results, equal, load.read(), notes)


def plot(report: Report, folder: Path) -> list[Path]:
    """Draw the speed-up over the number of workers.

    Args:
        report: What ``run`` found.
        folder: Where the picture goes.

    Returns:
        The file written.
    """
    counts = sorted({case["workers"] for case in report.cases})
    figure = new_figure(5.0, 4.0)
    axes = figure.add_subplot()
    axes.plot(counts, [count / counts[0] for count in counts], "k:", linewidth=0.8, label="ideal")
    axes.plot(counts, [report.figures[f"speedup_{count}"] for count in counts], "o-", label=report.robot)
    axes.set_xticks(counts)
    axes.set_xlabel("workers")
    axes.set_ylabel("speed-up [-]")
    axes.legend(fontsize=8)
    file = folder / f"scaling-{report.robot}.png"
    figure.savefig(file, dpi=110)
    return [file]
