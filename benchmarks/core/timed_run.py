"""Common parts of the timing benchmarks: execution, judgement over seeds, quantiles, plot of tails."""

import gc
import resource
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from time import perf_counter_ns, thread_time_ns
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmarks.core.benchmark import Benchmark, Bound
from benchmarks.core.harness import Case, Report
from benchmarks.core.machine import resident
from models.types import SolveStatus, Vector

MICRO = 1e-3  # nanoseconds to microseconds
STATUSES = tuple(SolveStatus)

#: Percentiles that a case stores for the plot of each subject [%]
QUANTILES = (*np.linspace(0.0, 99.0, 100).tolist(), 99.5, 99.8, 99.9, 99.95, 100.0)


@contextmanager
def collector_off() -> Iterator[None]:
    """Freeze live objects and disable the garbage collector within the context."""
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        gc.unfreeze()


def blocks_growth(seconds: Sequence[int], period: float) -> float:
    """Return the growth of blocks [1/tick] from ``sys.getallocatedblocks`` per second; ``period`` of a tick [s]."""
    return float(np.median(np.diff(seconds))) * period


def resident_growth(run: Callable[[float], None], settle: float, time: float) -> float:
    """Return growth of resident memory [KiB] over ``time`` [s] of simulation, after ``settle`` [s]."""
    with collector_off():
        run(settle)
        before = resident("self")
        run(time)
        return 1024.0 * (resident("self") - before)


class Stopwatch:
    """Times calls and records whether the scheduler interrupted them."""

    def __init__(self, rows: int, subjects: int) -> None:
        self.wall = np.zeros((rows, subjects), dtype=np.int64)  #: Wall-clock time (rows, subjects) [ns]
        self.cpu = np.zeros_like(self.wall)  #: CPU time of the thread (rows, subjects) [ns]
        #: Whether the scheduler interrupted the call (rows, subjects)
        self.preempted = np.zeros(self.wall.shape, dtype=bool)
        self.count = 0  #: Rows started by ``timing``

    def measure(self, row: int, subject: int, call: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
        """Time one call and return its result."""
        switches = resource.getrusage(resource.RUSAGE_THREAD).ru_nivcsw
        cpu = thread_time_ns()
        start = perf_counter_ns()
        result = call(*arguments, **named)
        end = perf_counter_ns()
        self.cpu[row, subject] = thread_time_ns() - cpu
        self.preempted[row, subject] = resource.getrusage(resource.RUSAGE_THREAD).ru_nivcsw != switches
        self.wall[row, subject] = end - start
        return result

    @contextmanager
    def timing(self, owner: Any, name: str, subject: int = 0) -> Iterator[None]:
        """Time every call of a method within the context; subject 0 starts a new row; calls in a row add up."""
        inner = getattr(owner, name)

        def timed(*arguments: Any, **named: Any) -> Any:
            self.count += subject == 0
            row = self.count - 1
            if not 0 <= row < len(self.wall):
                return inner(*arguments, **named)
            wall, preempted = self.wall[row, subject], self.preempted[row, subject]
            result = self.measure(row, subject, inner, *arguments, **named)
            self.wall[row, subject] += wall
            self.preempted[row, subject] |= preempted
            return result

        with patch.object(owner, name, timed):
            yield

    def times(self, *subjects: int) -> Vector:
        """Return the summed time of subjects (n,) [us], for each row in which no subject was pre-empted."""
        wall, preempted = self.wall[: self.count, subjects], self.preempted[: self.count, subjects]
        kept: Vector = wall.sum(axis=1)[~preempted.any(axis=1)] * MICRO
        return kept


class TimedBenchmark(Benchmark):
    """Timing benchmark: one case with ``figures`` per seed, measured alone; every seed must satisfy every bound."""

    alone = True

    def figures(self, cases: list[Case]) -> dict[str, float]:
        """Return ``over_seeds``, with the value of the worst seed for every figure with a bound."""
        found = over_seeds(cases)
        bounds = self.bounds(Report(self.name, "", len(cases), found, cases, False, {}))
        worst = {name: _worst(cases, name, bound)["figures"][name] for name, bound in bounds.items() if name in found}
        return found | worst

    def judged(self, report: Report) -> list[tuple[bool, str]]:
        """Return, for each bound, whether it holds for every seed, and a text with the worst figure."""
        found = []
        for name, bound in self.bounds(report).items():
            worst = _worst(report.cases, name, bound)
            value = worst["figures"].get(name, np.nan)
            found.append((bound.holds(value), f"{name} {bound}: worst {value:.4g}, seed {worst['seed']}"))
        return found

    def notes(self, report: Report) -> list[str]:
        preempted = f"{report.figures['preempted_fraction']:.2%} of the ticks were pre-empted and left out"
        return [*super().notes(report), f"wall-clock time; {preempted}"]


def _worst(cases: Sequence[Case], name: str, bound: Bound) -> Case:
    """Return the case with the worst figure for a bound; NaN is the worst."""
    values = [case["figures"].get(name, np.nan) for case in cases]
    return cases[int(np.argmax(values) if np.isinf(bound.least) else np.argmin(values))]


def solution_figures(residual: NDArray[np.float64], status: NDArray[np.int64]) -> dict[str, float]:
    """Return the figures of QPs, from KKT residuals (ticks,) [-] and indices into ``STATUSES`` (ticks,)."""
    figures = {"kkt_residual_max": float(residual.max())}
    for index, name in enumerate(STATUSES):
        figures[f"ticks_{name.value}"] = float(np.count_nonzero(status == index))
    certified = (SolveStatus.OPTIMAL, SolveStatus.FALLBACK_SOLVER)
    figures["ticks_uncertified"] = len(status) - sum(figures[f"ticks_{name.value}"] for name in certified)
    return figures


def over_seeds(cases: Sequence[Case]) -> dict[str, float]:
    """Combine the figures of all cases: the worst for tails, residuals, failures and growth, otherwise the median."""
    figures = {}
    for name in cases[0]["figures"]:
        values = [case["figures"][name] for case in cases]
        worst = name.endswith(("_max", "_p999", "_uncertified", "growth", "growth_kib"))
        figures[name] = float(np.max(values) if worst else np.median(values))
    return figures


Spread = dict[str, Any]  # ``count`` of samples and ``quantiles`` at ``QUANTILES``, as plain values


def spread(samples: ArrayLike) -> Spread:
    """Return count and quantiles of samples (n,); NaN without samples."""
    values = np.asarray(samples, dtype=np.float64)
    found = np.percentile(values, QUANTILES) if values.size else np.full(len(QUANTILES), np.nan)
    return {"count": int(values.size), "quantiles": found.tolist()}


def percentiles_of(spreads: Sequence[Spread], percents: Sequence[float] = QUANTILES) -> Vector:
    """Return percentiles (k,) of all samples, exact at ``QUANTILES`` for one spread; NaN without samples."""
    held = [each for each in spreads if each["count"]]
    if not held:
        return np.full(len(percents), np.nan)
    if len(held) == 1:
        return np.asarray(np.interp(percents, QUANTILES, held[0]["quantiles"]))
    values = np.unique(np.concatenate([each["quantiles"] for each in held]))
    below = [each["count"] * np.interp(values, each["quantiles"], QUANTILES) for each in held]
    return np.asarray(np.interp(percents, np.sum(below, axis=0) / sum(each["count"] for each in held), values))
