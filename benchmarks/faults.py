"""Faults of sensors, motors, solver, users and world in lockstep: what the robot must do, and what it does."""

from __future__ import annotations

from pathlib import Path

from benchmarks.fault_margins import margin
from benchmarks.fault_rows import config
from benchmarks.fault_table import draw, report_rows
from benchmarks.fault_trial import trial
from benchmarks.harness import Case, LoadMeter, Options, Report, chosen, run_cases


def measure(robot: str, seed: int, row: str) -> Case:
    """Do one row, or look for one margin.

    Args:
        robot: Name of a profile.
        seed: Of the sensor noise.
        row: Name of the row or margin.

    Returns:
        What ``trial`` or ``margin`` gives.
    """
    given = config()
    return margin(robot, seed, row) if row in given.margins else trial(robot, seed, given.rows[row])


def run(options: Options) -> Report:
    """Do every row and look for every margin, or do those chosen, with every seed.

    Args:
        options: Robot, seeds, workers, and rows or margins.

    Raises:
        ConfigError: A chosen row is unknown.
    """
    rows = chosen("faults", options.scenarios, [*config().rows, *config().margins])
    load = LoadMeter()
    inputs = [{"robot": options.robot, "seed": seed, "row": row} for row in rows for seed in range(options.seeds)]
    results = run_cases(measure, inputs, bench="faults", options=options)
    report = report_rows("faults", options, results, load)
    for row in [name for name in rows if name in config().margins]:
        report.figures[f"{row}_s"] = min(case["margin"] for case in results if case["row"] == row)
    return report


def plot(report: Report, folder: Path) -> list[Path]:
    """Draw the time that each reaction took, beside its limit; see ``fault_table.draw``."""
    return draw(report, folder)
