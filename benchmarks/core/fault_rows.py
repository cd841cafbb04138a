"""Common parts of the fault benchmarks: rows, figures, table and plot."""

from pathlib import Path

import numpy as np
from pydantic.dataclasses import dataclass as schema

from benchmarks.core.benchmark import Benchmark, Bound, at_least, saved
from benchmarks.core.harness import Case, Report
from benchmarks.core.results import NOT_RUN
from bridge.analysis.plots import new_figure
from models.config import STRICT, Positive


@schema(frozen=True, slots=True, kw_only=True, config=STRICT)
class AnyRow:
    """Fault of a lockstep or graph benchmark."""

    group: str  #: Heading in the table
    act: str = ""  #: Name of the act; optional with ``faults``
    within: Positive | None = None  #: Maximum time to the expected reaction, for 'damps' and 'stands' [s]
    reason: str = ""  #: Text that the reason must contain
    walk: bool = False  #: Whether the robot walks
    duration: Positive | None = None  #: Observation time after the fault; None for the default [s]
    mode: str = ""  #: Expected mode afterwards; when empty, the initial mode or the mode of ``expect``


def _line(case: Case) -> str:
    limit = "" if case["within"] is None else f" within {case['within']:.2f} s"
    time = "" if case["time"] is None else f" after {case['time']:.3f} s"
    step = f", torque step {case['torque_step']:.2f}" if "torque_step" in case else ""
    silence = "" if case.get("silence") is None else f", drivers after {case['silence']:.4f} s without a command"
    reason = f": {case['reason']}" if case["reason"] else ""
    verdict = "------" if case.get(NOT_RUN) else "ok    " if case["ok"] else "FAILED"
    return f"{verdict} {case['row']:<22} {case['expected']}{limit}; seen: {case['seen']}{time}{step}{silence}{reason}"


class FaultBenchmark(Benchmark):
    """Rows of faults: each must end as expected; rows marked ``not_run`` could not be run here."""

    def figures(self, cases: list[Case]) -> dict[str, float]:
        """Return ``survived``, ``total`` (rows that could be run), ``not_run``, and ``torque_step_max`` if observed."""
        run = [case for case in cases if not case.get(NOT_RUN)]
        figures = {"survived": float(sum(case["ok"] for case in run)), "total": float(len(run))}
        if len(run) < len(cases):
            figures[NOT_RUN] = float(len(cases) - len(run))
        steps = [case["torque_step"] for case in cases if "torque_step" in case]
        return figures | ({"torque_step_max": max(steps)} if steps else {})

    def bounds(self, report: Report) -> dict[str, Bound]:
        """Require all rows that could be run, and at least one."""
        return at_least({"survived": max(report.figures["total"], 1.0)})

    def notes(self, report: Report) -> list[str]:
        return [_line(case) for case in report.cases]

    def survived(self, case: Case) -> tuple[str, bool] | None:
        return None if case.get(NOT_RUN) else (case["group"], bool(case["ok"]))

    def plots(self, report: Report, folder: Path) -> list[Path]:
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
        return [saved(figure, folder / f"{report.bench}-{report.stem}.png")]
