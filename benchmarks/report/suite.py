"""All benchmarks, one after another, with the same workers and the same file of finished cases."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console

from benchmarks.core.benchmark import Listed, catalogue
from benchmarks.core.harness import Options, Sweep
from benchmarks.core.results import ResultsFile
from benchmarks.report.saved_reports import Part, read_progress, save_begun, save_failure, save_plan, save_report
from models.errors import ConfigError, WorkersError


@dataclass(frozen=True, slots=True)
class Entry:
    """One benchmark of a suite: name of its reports, robots, number of seeds, chosen scenarios (the usual if empty)."""

    bench: str
    robots: tuple[str, ...]
    seeds: int = 1
    scenarios: tuple[str, ...] = ()


def entries_of(suite: str) -> list[Entry]:
    """Benchmarks of ``--quick`` or ``--full``, from their descriptions."""
    parts = {name: listed.info.quick if suite == "quick" else listed.info.full for name, listed in catalogue().items()}
    return [Entry(name, part.robots, part.seeds, part.scenarios) for name, part in parts.items() if part is not None]


def command_of(entry: Entry, listed: Listed, robot: str) -> str:
    """Command that measures one benchmark of a suite on one robot."""
    words = ["poise", "bench", listed.command, "--robot", robot, "--seeds", str(entry.seeds)]
    if listed.command != listed.name:
        words += ["--mode", listed.info.mode]
    return " ".join([*words, *(f"--{listed.info.choice} {each}" for each in entry.scenarios)])


def run_suite(
    entries: Sequence[Entry],
    known: Mapping[str, Listed],
    folder: Path,
    sweep: Sweep,
    console: Console,
    suite: str = "quick",
) -> bool:
    """Run every benchmark, keep its report, and return whether all passed; one that fails does not stop the others.

    Raises:
        ConfigError: A benchmark is unknown, or there is no file of finished cases.
        WorkersError: No worker measures.
    """
    if sweep.results is None:
        raise ConfigError("a suite needs a file of finished cases")
    for entry in entries:
        if entry.bench not in known:
            raise ConfigError(f"suite: unknown benchmark '{entry.bench}'; known: {', '.join(known)}")
    parts = {
        (entry.bench, robot): command_of(entry, known[entry.bench], robot)
        for entry in entries
        for robot in entry.robots
    }
    save_plan(folder, suite, parts)
    passed = True
    for entry in entries:
        for robot in entry.robots:
            part = entry.bench, robot
            sweep.results.taken.clear()
            recorded = replace(sweep, began=_recorder(folder, part, sweep.results))
            options = Options(robot, entry.seeds, scenarios=entry.scenarios, sweep=recorded)
            try:
                report = known[entry.bench].load().run(options)
            except WorkersError:
                raise
            except Exception as error:
                passed = False
                failure = save_failure(folder, entry.bench, robot, error)
                where = f" ({folder / failure.trace})" if failure.trace else ""
                line = f"{entry.bench} {robot}: could not be run: {failure.error}{where}"
                console.print(line, style="red", markup=False, soft_wrap=True)
                continue
            keys = sweep.results.taken.get(report.bench, [])
            anew = part in [(missing.bench, missing.robot) for missing in read_progress(folder).missing]
            save_report(folder, report, keys, parts[part], anew=anew)
            passed = passed and report.passed
            verdict = "[green]passed[/green]" if report.passed else "[red]not passed[/red]"
            console.print(f"{entry.bench} {robot}: {len(report.cases)} cases, {verdict}")
    return passed


def _recorder(folder: Path, part: Part, results: ResultsFile) -> Callable[[Sequence[str]], None]:
    """Records the cases of a part as it asks for them, unless all of them are there."""
    asked: list[str] = []

    def began(keys: Sequence[str]) -> None:
        asked.extend(keys)
        if not results.has(keys):
            save_begun(folder, part, asked)

    return began
