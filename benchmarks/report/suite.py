"""Run all benchmarks with common workers and results file, and store the reports as JSON lines.

``reports.jsonl`` is next to ``cases.jsonl`` and refers to its cases by key. A line is the JSON object of a report with
``keys`` instead of cases, ``notes`` and the ``command`` that repeats the measurement. For a benchmark that could not be
run it has ``bench``, ``robot``, ``error``, ``trace`` and ``revision``. A later line of the same bench and robot
replaces an earlier one.
"""

import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from traceback import format_exception

from rich.console import Console

from benchmarks.core.benchmark import Listed, Part, catalogue
from benchmarks.core.harness import Options, Report, Sweep
from benchmarks.core.provenance import source_state
from benchmarks.core.results import Line, ResultsFile, append_line, read_lines
from models.errors import ConfigError, PoiseError, WorkersError

#: Files in a suite's folder, and the folder of tracebacks
CASES, REPORTS, ERRORS = "cases.jsonl", "reports.jsonl", "errors"
Subject = tuple[str, str]  # bench and robot


@dataclass(frozen=True, slots=True)
class SavedReport:
    """Report with its command, machines, source revision, package versions, and total time of its cases [s]."""

    report: Report
    command: str
    machines: tuple[str, ...]
    revision: str
    versions: dict[str, str]
    seconds: float


@dataclass(frozen=True, slots=True)
class Failure:
    """Benchmark that could not be run; ``trace`` is the file of the traceback, empty for an expected error."""

    bench: str
    robot: str
    error: str
    trace: str = ""
    revision: str = ""


def save_report(folder: Path, report: Report, keys: Sequence[str], command: str, *, anew: bool) -> None:
    """Append a report with the ``keys`` of its cases, unless it is stored and no case was measured ``anew``."""
    latest = latest_lines(folder).get((report.bench, report.robot), {})
    if not anew and (latest.get("keys"), latest.get("command")) == (list(keys), command):
        return
    line = {name: value for name, value in report.to_dict().items() if name != "cases"}
    more = {"revision": source_state(), "notes": report.notes, "command": command, "keys": list(keys)}
    append_line(folder / REPORTS, {**line, **more})


def save_failure(folder: Path, bench: str, robot: str, error: Exception) -> Failure:
    """Append a failure to a suite's folder, with the traceback of an unexpected error."""
    trace = ""
    if not isinstance(error, PoiseError):
        trace = f"{ERRORS}/{bench}-{Path(robot).stem}.txt"
        (folder / ERRORS).mkdir(exist_ok=True)
        (folder / trace).write_text("".join(format_exception(error)), encoding="utf-8")
    failure = Failure(bench, robot, f"{type(error).__name__}: {error}", trace, source_state())
    append_line(folder / REPORTS, asdict(failure))
    return failure


def read_reports(folder: Path) -> tuple[list[SavedReport], list[Failure]]:
    """Read reports and failures of a suite's folder; ``ConfigError`` for a damaged line or a missing case."""
    cases = {line["key"]: line for line in read_lines(folder / CASES)}
    saved, failures = [], []
    for line in latest_lines(folder).values():
        try:
            if "error" in line:
                failures.append(Failure(**line))
            else:
                saved.append(_saved(line, cases))
        except (KeyError, TypeError) as error:
            raise ConfigError(f"{folder / REPORTS}: {line.get('bench')}: missing or unknown: {error}") from error
    return saved, failures


def latest_lines(folder: Path) -> dict[Subject, Line]:
    """Return the last line of each bench and robot, in the order of their first lines."""
    return {_subject(line): line for line in read_lines(folder / REPORTS)}


def _saved(line: Line, cases: dict[str, Line]) -> SavedReport:
    kept = {entry.name: line[entry.name] for entry in fields(Report) if entry.name not in ("cases", "contender")}
    mine = [cases[key] for key in line["keys"]]
    report = Report(cases=[case["case"] for case in mine], contender=line.get("contender", ""), **kept)
    seconds = sum(case["seconds"] for case in mine)
    machines = tuple(dict.fromkeys(case["machine"] for case in mine))
    return SavedReport(report, line["command"], machines, line["revision"], line["versions"], seconds)


PLAN = "plan.jsonl"  # file in a suite's folder


@dataclass(frozen=True, slots=True)
class Missing:
    """Unfinished benchmark and robot of a suite."""

    bench: str
    robot: str
    done: int  #: Finished cases
    total: int  #: Cases requested so far; 0 if not begun
    earlier: bool  #: Whether there is a report of another revision or with other cases

    @property
    def state(self) -> str:
        """State as text."""
        state = f"{self.done} of {self.total} cases" if self.total else "not begun"
        return f"{state}; the report shows an earlier measurement" if self.earlier else state


@dataclass(frozen=True, slots=True)
class Progress:
    """Progress of a suite: its name (empty without a plan), number of parts, and unfinished parts."""

    suite: str = ""
    parts: int = 0
    missing: tuple[Missing, ...] = ()

    def __str__(self) -> str:
        begun = [part for part in self.missing if part.total]
        done, total = sum(part.done for part in begun), sum(part.total for part in begun)
        finished = f"partial: {self.parts - len(self.missing)} of {self.parts} parts of --{self.suite} are finished"
        left = f"parts in progress: {done} of {total} cases; parts not begun: {len(self.missing) - len(begun)}"
        return f"{finished}; {left}" if self.missing else ""


def save_plan(folder: Path, suite: str, commands: Mapping[Subject, str]) -> None:
    """Append the plan of a suite (commands of all parts, in order), unless it equals the latest plan."""
    parts = [[*subject, command] for subject, command in commands.items()]
    line = {"suite": suite, "revision": source_state(), "parts": parts}
    plans = [found for found in read_lines(folder / PLAN) if "parts" in found]
    if plans[-1:] != [line]:
        append_line(folder / PLAN, line)


def save_begun(folder: Path, subject: Subject, keys: Sequence[str]) -> None:
    """Append the start of a benchmark on a robot, with the keys of all its cases known so far."""
    (bench, robot), reports = subject, len(read_lines(folder / REPORTS))
    found = {"bench": bench, "robot": robot, "revision": source_state(), "keys": list(keys), "reports": reports}
    append_line(folder / PLAN, found)


def read_progress(folder: Path) -> Progress:
    """Return the progress of the suite that was started last; ``ConfigError`` for a damaged line."""
    lines = read_lines(folder / PLAN)
    plans = [line for line in lines if "parts" in line]
    if not plans:
        return Progress()
    plan = plans[-1]
    begun = {_subject(line): line for line in lines if "keys" in line and line["revision"] == plan["revision"]}
    reported = {_subject(line): (number, line) for number, line in enumerate(read_lines(folder / REPORTS))}
    measured = {line["key"] for line in read_lines(folder / CASES) if "key" in line}
    missing = []
    for bench, robot, command in plan["parts"]:
        number, report = reported.get((bench, robot), (-1, {}))
        start = begun.get((bench, robot), {"keys": [], "reports": 0})
        other = report.get("revision") != plan["revision"] or report.get("command", command) != command
        if other or number < start["reports"]:
            done = sum(key in measured for key in start["keys"])
            missing.append(Missing(bench, robot, done, len(start["keys"]), "figures" in report))
    return Progress(plan["suite"], len(plan["parts"]), tuple(missing))


def _subject(line: Line) -> Subject:
    return line.get("bench", ""), line.get("robot", "")


def parts_of(suite: str) -> dict[str, Part]:
    """Return the parts of ``--quick`` or ``--full`` by report name, in order."""
    parts = {name: listed.info.quick if suite == "quick" else listed.info.full for name, listed in catalogue().items()}
    return {name: part for name, part in parts.items() if part is not None}


def command_of(part: Part, listed: Listed, robot: str) -> str:
    """Return the command that runs one benchmark of a suite on one robot."""
    words = ["poise", "bench", listed.command, "--robot", robot, "--seeds", str(part.seeds)]
    if listed.command != listed.name:
        words += ["--mode", listed.info.mode]
    return " ".join([*words, *(f"--{listed.info.choice} {shlex.quote(each)}" for each in part.scenarios)])


def run_suite(
    parts: Mapping[str, Part],
    known: Mapping[str, Listed],
    folder: Path,
    sweep: Sweep,
    console: Console,
    suite: str = "quick",
) -> bool:
    """Run every benchmark, save its report, and return whether all passed; only ``WorkersError`` ends it early."""
    if sweep.results is None:
        raise ConfigError("a suite needs a file of finished cases")
    runs = [(bench, robot, part) for bench, part in parts.items() for robot in part.robots]
    commands = {(bench, robot): command_of(part, known[bench], robot) for bench, robot, part in runs}
    save_plan(folder, suite, commands)
    passed = True
    for bench, robot, part in runs:
        subject = bench, robot
        sweep.results.requested.clear()
        recorded = replace(sweep, began=_recorder(folder, subject, sweep.results))
        options = Options(robot, part.seeds, scenarios=part.scenarios, sweep=recorded)
        try:
            report = known[bench].load().run(options)
        except WorkersError:
            raise
        except Exception as error:
            passed = False
            failure = save_failure(folder, bench, robot, error)
            where = f" ({folder / failure.trace})" if failure.trace else ""
            line = f"{bench} {robot}: could not be run: {failure.error}{where}"
            console.print(line, style="red", markup=False, soft_wrap=True)
            continue
        keys = sweep.results.requested.get(report.bench, [])
        anew = subject in [(missing.bench, missing.robot) for missing in read_progress(folder).missing]
        save_report(folder, report, keys, commands[subject], anew=anew)
        passed = passed and report.passed
        verdict = "[green]passed[/green]" if report.passed else "[red]not passed[/red]"
        console.print(f"{bench} {robot}: {len(report.cases)} cases, {verdict}")
    return passed


def _recorder(folder: Path, subject: Subject, results: ResultsFile) -> Callable[[Sequence[str]], None]:
    """Return a callback that records the requested cases of a benchmark, unless all of them are finished."""
    asked: list[str] = []

    def began(keys: Sequence[str]) -> None:
        asked.extend(keys)
        if not results.has(keys):
            save_begun(folder, subject, asked)

    return began
