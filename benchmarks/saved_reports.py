"""What a suite found, as JSON lines: ``reports.jsonl`` beside the ``cases.jsonl`` whose cases it names by key.

A line of ``reports.jsonl`` is the one JSON object of a benchmark, with ``keys`` instead of its cases, with its
``notes`` and the ``command`` that measures it again; of a benchmark that could not be run it is ``bench``, ``robot``
and ``error``. A later line of the same bench and robot replaces an earlier one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

from benchmarks.harness import Report
from benchmarks.provenance import source_state
from benchmarks.results import Line, append_line, read_lines
from models.errors import ConfigError

CASES, REPORTS = "cases.jsonl", "reports.jsonl"
"""Files in a suite's folder."""


@dataclass(frozen=True, slots=True)
class SavedReport:
    """What one benchmark found on one robot.

    Attributes:
        report: As it was then.
        command: That measures it again.
        machines: That measured its cases, in general terms.
        revision: Of the source.
        versions: Of the packages.
        seconds: That its cases took, all workers together [s].
    """

    report: Report
    command: str
    machines: tuple[str, ...]
    revision: str
    versions: dict[str, str]
    seconds: float


@dataclass(frozen=True, slots=True)
class Failure:
    """A benchmark that could not be run.

    Attributes:
        bench: Its name.
        robot: On which robot.
        error: Why.
    """

    bench: str
    robot: str
    error: str


def save_report(folder: Path, report: Report, keys: Sequence[str], command: str) -> None:
    """Add what a benchmark found to a suite's folder, unless the same cases said it before: the load was that of then.

    Args:
        folder: Of the suite.
        report: What it found.
        keys: Of its cases in ``cases.jsonl``, in their order.
        command: That measures it again.
    """
    if _latest(folder).get((report.bench, report.robot), {}).get("keys") == list(keys):
        return
    line = {name: value for name, value in report.to_dict().items() if name != "cases"}
    more = {"revision": source_state(), "notes": report.notes, "command": command, "keys": list(keys)}
    append_line(folder / REPORTS, {**line, **more})


def save_failure(folder: Path, failure: Failure) -> None:
    """Add that a benchmark could not be run to a suite's folder."""
    append_line(folder / REPORTS, {name.name: getattr(failure, name.name) for name in fields(Failure)})


def read_reports(folder: Path) -> tuple[list[SavedReport], list[Failure]]:
    """What a suite's folder holds.

    Args:
        folder: Of the suite.

    Raises:
        ConfigError: Nothing is finished there, a line is damaged, or a case is missing.
    """
    latest = latest_lines(folder)
    if not latest:
        raise ConfigError(f"{folder}: no benchmark is finished there; run: poise bench all --quick --out {folder}")
    cases = {line["key"]: line for line in read_lines(folder / CASES)}
    saved, failures = [], []
    for line in latest:
        try:
            if "error" in line:
                failures.append(Failure(**line))
            else:
                saved.append(_saved(line, cases))
        except (KeyError, TypeError) as error:
            raise ConfigError(f"{folder / REPORTS}: {line.get('bench')}: missing or unknown: {error}") from error
    return saved, failures


def _latest(folder: Path) -> dict[tuple[str, str], Line]:
    """The last line of each bench and robot."""
    return {(line.get("bench", ""), line.get("robot", "")): line for line in read_lines(folder / REPORTS)}


def latest_lines(folder: Path) -> list[Line]:
    """The last line of each bench and robot of a suite's folder, in the order in which they were first measured."""
    return list(_latest(folder).values())


def _saved(line: Line, cases: dict[str, Line]) -> SavedReport:
    kept = {entry.name: line[entry.name] for entry in fields(Report) if entry.name != "cases"}
    mine = [cases[key] for key in line["keys"]]
    report = Report(cases=[case["case"] for case in mine], **kept)
    seconds = sum(case["seconds"] for case in mine)
    machines = tuple(dict.fromkeys(case["machine"] for case in mine))
    return SavedReport(report, line["command"], machines, line["revision"], line["versions"], seconds)
