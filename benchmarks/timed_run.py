"""What the benchmarks of time share: how they run, how their figures are judged over seeds, and the plot of tails."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Annotated

import numpy as np
from matplotlib.axes import Axes
from pydantic import Field
from pydantic.dataclasses import dataclass as schema

from benchmarks.harness import Case, LoadMeter, Options, Report, run_cases
from benchmarks.process_use import resident
from models.config import STRICT

Positive = Annotated[float, Field(gt=0.0)]

MICRO = 1e-3
"""Nanoseconds to microseconds."""

QUANTILES = (*np.linspace(0.0, 99.0, 100).tolist(), 99.5, 99.8, 99.9, 99.95, 100.0)
"""Percentiles that a case keeps of every subject, for the plot [%]."""


@schema(frozen=True, slots=True, config=STRICT)
class TickBounds:
    """What a whole-body tick is held to; the unit of every value stands in the benchmark's YAML."""

    placo_ratio_max: Positive
    pinocchio_ratio_max: Positive
    tail_ratio_max: Positive
    residual_max: Positive
    memory_time: Positive
    growth_max: Positive
    resident_max: Positive


def tick_limits(bounds: TickBounds) -> dict[str, float]:
    """Largest value of each figure of a whole-body tick that passes."""
    return {
        "ratio_to_placo": bounds.placo_ratio_max,
        "ratio_to_pinocchio_calls": bounds.pinocchio_ratio_max,
        "p99_over_median": bounds.tail_ratio_max,
        "kkt_residual_max": bounds.residual_max,
        "ticks_uncertified": 0.0,
        "allocated_blocks_growth": bounds.growth_max,
        "resident_growth_kib": bounds.resident_max,
    }


@contextmanager
def collector_off() -> Iterator[None]:
    """Freeze what lives and switch the garbage collector off."""
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        gc.unfreeze()


def blocks_growth(seconds: Sequence[int], period: float) -> float:
    """Growth of the process' allocated blocks a tick [1/tick].

    Args:
        seconds: Allocated blocks (``sys.getallocatedblocks``) after every second.
        period: Length of a tick [s].
    """
    return float(np.median(np.diff(seconds))) * period


def resident_growth(run: Callable[[float], None], settle: float, time: float) -> float:
    """Memory that the process grows by, large arrays and compiled code included [KiB].

    Args:
        run: Runs for a simulated time [s], nothing measured.
        settle: Run before that, for what the measurement left behind [s].
        time: Over which the growth is taken [s].
    """
    with collector_off():
        run(settle)
        before = _resident()
        run(time)
        return _resident() - before


def _resident() -> float:
    """Resident memory of this process [KiB]."""
    return 1024.0 * resident("self")


def run_seeds(bench: str, options: Options, measure: Callable[[str, int], Case], limits: Mapping[str, float]) -> Report:
    """Measure every seed, one at a time whatever ``workers`` says.

    There is no progress bar: its thread would allocate, and take the interpreter while ticks are timed.

    Args:
        bench: Name of the benchmark.
        options: Robot and seeds.
        measure: Gives the case of a robot and a seed, with ``figures``, ``preempted_fraction`` among them.
        limits: Largest value of each figure that passes.

    Returns:
        Figures as ``measure`` names them: over several seeds as of ``over_seeds``. It has passed when every seed has.
    """
    load = LoadMeter()
    inputs = [{"robot": options.robot, "seed": seed} for seed in range(options.seeds)]
    cases = run_cases(measure, inputs, bench=bench, options=options, alone=True)
    figures = over_seeds(cases)
    passed, notes = judge(cases, limits)
    notes.append(f"wall-clock time; {figures['preempted_fraction']:.2%} of the ticks were pre-empted and left out")
    return Report(bench, options.robot, options.seeds, figures, cases, passed, load.read(), notes)


def judge(cases: Sequence[Case], limits: Mapping[str, float]) -> tuple[bool, list[str]]:
    """Hold every seed against the limits.

    Args:
        cases: One a seed, with ``seed`` and ``figures``.
        limits: Largest value of each figure that passes.

    Returns:
        Whether every figure of every seed is within its limit, and a line a figure that tells the worst seed.
    """
    passed, lines = True, []
    for name, limit in limits.items():
        values = [case["figures"][name] for case in cases]
        worst = int(np.argmax(values))  # a value that is not a number counts as the largest
        held = bool(values[worst] <= limit)
        passed &= held
        word = "ok    " if held else "FAILED"
        lines.append(f"{word} {name} <= {limit:g}: worst {values[worst]:.4g}, seed {cases[worst]['seed']}")
    return passed, lines


def over_seeds(cases: Sequence[Case]) -> dict[str, float]:
    """Figures of all cases: the median of each, but the worst of tails, residuals, failures and growth."""
    figures = {}
    for name in cases[0]["figures"]:
        values = [case["figures"][name] for case in cases]
        worst = name.endswith(("_max", "_p999", "_uncertified", "growth", "growth_kib"))
        figures[name] = float(np.max(values) if worst else np.median(values))
    return figures


def plot_tails(axes: Axes, subjects: Sequence[str], cases: Sequence[Case]) -> None:
    """Draw how long each subject takes at every percentile of ``QUANTILES``, by the ``quantiles`` of the cases."""
    rank = 1.0 / np.maximum(1.0 - np.array(QUANTILES) / 100.0, 1e-4)  # 1e-4: the slowest of ten thousand
    for name in subjects:
        values = np.median([case["quantiles"][name] for case in cases], axis=0)
        axes.loglog(rank, values, label=name.replace("_", " "))
    axes.set_xlabel("one tick in so many is slower")
    axes.set_ylabel("time, pre-empted ticks included [us]")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
