"""The table and the picture that all benchmarks of faults share."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.harness import Case, LoadMeter, Options, Report
from benchmarks.results import NOT_RUN
from bridge.plots import new_figure


def report_rows(bench: str, options: Options, results: list[Case], load: LoadMeter) -> Report:
    """Judge: every row must have gone as expected.

    Args:
        bench: Name of the benchmark.
        options: Robot and seeds.
        results: ``row``, ``expected``, ``within`` [s], ``seen``, ``reason``, ``time`` [s], ``ok``, and where they
            were watched ``torque_step`` [-] and ``silence`` of the drivers [s]; ``not_run`` where that was impossible.
        load: Since the beginning.

    Returns:
        Figures ``survived`` of ``total``, and ``torque_step_max`` where it was watched; a line for each row. Rows that
        could not be run here count for neither; ``not_run`` says how many they are.
    """
    lines = [f"{_verdict(case)} {_line(case)}" for case in results]
    run = [case for case in results if not case.get(NOT_RUN)]
    figures = {"survived": float(sum(case["ok"] for case in run)), "total": float(len(run))}
    if len(run) < len(results):
        figures[NOT_RUN] = float(len(results) - len(run))
    steps = [case["torque_step"] for case in results if "torque_step" in case]
    if steps:
        figures["torque_step_max"] = max(steps)
    passed = all(case["ok"] for case in run)
    return Report(bench, options.robot, options.seeds, figures, results, passed, load.read(), lines)


def _verdict(case: Case) -> str:
    return "------" if case.get(NOT_RUN) else "ok    " if case["ok"] else "FAILED"


def _line(case: Case) -> str:
    """One row of the table."""
    limit = "" if case["within"] is None else f" within {case['within']:.2f} s"
    time = "" if case["time"] is None else f" after {case['time']:.3f} s"
    step = f", torque step {case['torque_step']:.2f}" if "torque_step" in case else ""
    silence = "" if case.get("silence") is None else f", drivers after {case['silence']:.4f} s without a command"
    told = f": {case['reason']}" if case["reason"] else ""
    return f"{case['row']:<22} {case['expected']}{limit}; seen: {case['seen']}{time}{step}{silence}{told}"


def draw(report: Report, folder: Path) -> list[Path]:
    """Draw the time that each reaction took, beside its limit.

    Args:
        report: What ``report_rows`` gave.
        folder: Where the picture goes.

    Returns:
        The file written.
    """
    timed = [case for case in report.cases if case["time"] is not None]
    figure = new_figure(7.0, 1.0 + 0.28 * max(len(timed), 1))
    axes = figure.subplots()
    at = np.arange(len(timed))
    axes.barh(at, [case["time"] for case in timed], color=["C0" if case["ok"] else "C3" for case in timed])
    limits = [np.nan if case["within"] is None else case["within"] for case in timed]
    axes.plot(limits, at, "k|", markersize=12, label="limit")
    axes.set_yticks(at, [case["row"] for case in timed], fontsize=7)
    axes.set_xlabel("from the fault to the expected mode [s]")
    axes.legend(fontsize=8)
    file = folder / f"{report.bench}-{report.robot}.png"
    figure.savefig(file, dpi=110)
    return [file]
