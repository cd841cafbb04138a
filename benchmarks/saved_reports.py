"""What a suite found, as JSON lines: ``reports.jsonl`` beside the ``cases.jsonl`` whose cases it names by key.

A line of ``reports.jsonl`` is the one JSON object of a benchmark, with ``keys`` instead of its cases, with its
``notes`` and the ``command`` that measures it again; of a benchmark that could not be run it is ``bench``, ``robot``,
``error``, ``trace`` and ``revision``. A later line of the same bench and robot replaces an earlier one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from traceback import format_exception

from benchmarks.harness import Report
from benchmarks.provenance import source_state
from benchmarks.results import Line, append_line, read_lines
from models.errors import ConfigError, PoiseError

CASES, REPORTS, ERRORS = "cases.jsonl", "reports.jsonl", "errors"
"""Files in a suite's folder, and the folder of tracebacks."""


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
        trace: File with where in the source that was, in the suite's folder; empty where poise says so on purpose.
        revision: Of the source.
    """

    bench: str
    robot: str
    error: str
    trace: str = ""
    revision: str = ""


def save_report(folder: Path, report: Report, keys: Sequence[str], command: str, *, anew: bool) -> None:
    """Add what a benchmark found to a suite's folder, unless the same cases said it before: the load was that of then.

    Args:
        folder: Of the suite.
        report: What it found.
        keys: Of its cases in ``cases.jsonl``, in their order.
        command: That measures it again.
        anew: Whether any case was measured, or tried, since the last report.
    """
    latest = _latest(folder).get((report.bench, report.robot), {})
    if not anew and (latest.get("keys"), latest.get("command")) == (list(keys), command):
        return
    line = {name: value for name, value in report.to_dict().items() if name != "cases"}
    more = {"revision": source_state(), "notes": report.notes, "command": command, "keys": list(keys)}
    append_line(folder / REPORTS, {**line, **more})


def save_failure(folder: Path, bench: str, robot: str, error: Exception) -> Failure:
    """Add that a benchmark could not be run to a suite's folder, with the traceback of what nobody foresaw."""
    trace = ""
    if not isinstance(error, PoiseError):
        trace = f"{ERRORS}/{bench}-{Path(robot).stem}.txt"
        (folder / ERRORS).mkdir(exist_ok=True)
        (folder / trace).write_text("".join(format_exception(error)), encoding="utf-8")
    failure = Failure(bench, robot, f"{type(error).__name__}: {error}", trace, source_state())
    append_line(folder / REPORTS, asdict(failure))
    return failure


def read_reports(folder: Path) -> tuple[list[SavedReport], list[Failure]]:
    """What a suite's folder holds.

    Args:
        folder: Of the suite.

    Raises:
        ConfigError: A line is damaged, or a case is missing.
    """
    latest = latest_lines(folder)
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
    kept = {entry.name: line[entry.name] for entry in fields(Report) if entry.name not in ("cases", "contender")}
    mine = [cases[key] for key in line["keys"]]
    report = Report(cases=[case["case"] for case in mine], contender=line.get("contender", ""), **kept)
    seconds = sum(case["seconds"] for case in mine)
    machines = tuple(dict.fromkeys(case["machine"] for case in mine))
    return SavedReport(report, line["command"], machines, line["revision"], line["versions"], seconds)
