"""Speed-up with more workers: walks of the terrain benchmark with one worker and with several, and their cost.

The benchmark passes if all cases are bitwise equal for any number of workers; the time has no bound.
"""

import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass as schema

from benchmarks.core.benchmark import Benchmark, saved, settings
from benchmarks.core.executors import ProcessPool
from benchmarks.core.harness import Case, LoadMeter, Options, Report, Sweep, run_cases
from benchmarks.core.results import encode_nonfinite
from benchmarks.stability.terrain import walk
from bridge.analysis.plots import new_figure
from bridge.closed_loop import ClosedLoop
from models.config import STRICT, Count, Positive

HOUR = 3600.0  # [s]


@schema(frozen=True, slots=True, config=STRICT)
class ScalingConfig:
    """Settings of the sweep; the units are in ``benchmarks/config/scaling.yaml``."""

    workers: Annotated[tuple[Count, ...], Field(min_length=1)]
    cases: Count
    scenario: str
    warm_up: Positive
    planned: Count


_config = partial(settings, ScalingConfig, "scaling")


def warm_up(robot: str, seed: int) -> Case:
    """Make a worker load the code and data of a case."""
    ClosedLoop(robot, seed=seed).run(_config().warm_up)
    return {}


def measure(robot: str, seed: int, scenario: str) -> Case:
    """Run one walk of the terrain benchmark; ``seconds`` is its duration in this process [s]."""
    began = time.monotonic()
    outcome = walk(robot, seed, scenario)
    return {"outcome": outcome, "seconds": time.monotonic() - began}


def _round(options: Options, inputs: list[Case], workers: int) -> list[Case]:
    """Run all cases with a number of workers; ``wall`` is their total time [s]."""
    with ProcessPool(workers) as executor:
        given = replace(options, sweep=Sweep(executor))
        first = [{"robot": options.robot, "seed": seed} for seed in range(workers)]
        run_cases(warm_up, first, bench="scaling, warm-up", options=given)
        began = time.monotonic()
        results = run_cases(measure, inputs, bench=f"scaling, workers: {workers}", options=given)
        wall = time.monotonic() - began
    return [{"workers": workers, "wall": wall, **case} for case in results]


def summarise(results: list[Case], planned: int) -> dict[str, float]:
    """Compute the figures of all rounds; speed-up and efficiency are relative to the round with fewest workers."""
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
    """Whether every case has the same outcome with any number of workers."""
    outcomes: dict[int, list[Any]] = {}
    for case in results:
        outcomes.setdefault(case["seed"], []).append(encode_nonfinite(case["outcome"]))  # encoded because NaN != NaN
    return all(outcome == found[0] for found in outcomes.values() for outcome in found)


class Scaling(Benchmark):
    """See the docstring of the module; the options' workers and sweep are not used."""

    def cases(self, options: Options) -> list[Case]:
        """Return as many walks per seed as are configured."""
        config = _config()
        count = config.cases * options.seeds
        return [{"robot": options.robot, "seed": seed, "scenario": config.scenario} for seed in range(count)]

    def figures(self, cases: list[Case]) -> dict[str, float]:
        return summarise(cases, _config().planned)

    def passed(self, report: Report) -> bool:
        return same(report.cases)

    def notes(self, report: Report) -> list[str]:
        outcome = "are the same" if same(report.cases) else "DIFFER"
        return [f"cases {outcome} over {', '.join(map(str, _config().workers))} workers"]

    def run(self, options: Options) -> Report:
        load = LoadMeter()
        results = [case for workers in _config().workers for case in _round(options, self.cases(options), workers)]
        return self.report(options, results, self.figures(results), load)

    def plots(self, report: Report, folder: Path) -> list[Path]:
        counts = sorted({case["workers"] for case in report.cases})
        figure = new_figure(5.0, 4.0)
        axes = figure.add_subplot()
        axes.plot(counts, [count / counts[0] for count in counts], "k:", linewidth=0.8, label="ideal")
        axes.plot(counts, [report.figures[f"speedup_{count}"] for count in counts], "o-", label=report.robot)
        axes.set_xticks(counts)
        axes.set(xlabel="workers", ylabel="speed-up [-]")
        axes.legend(fontsize=8)
        return [saved(figure, folder / f"scaling-{report.stem}.png")]
