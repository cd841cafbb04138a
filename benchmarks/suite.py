"""All benchmarks, one after another, with the same workers and the same file of finished cases."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass as schema
from rich.console import Console

from benchmarks.harness import Options, Report, Sweep
from benchmarks.results import ResultsFile
from benchmarks.saved_reports import save_failure, save_report
from benchmarks.suite_plan import Part, read_progress, save_begun, save_plan
from models.config import STRICT, default_config
from models.errors import ConfigError, WorkersError


@schema(frozen=True, slots=True, config=STRICT)
class Entry:
    """One benchmark of a suite.

    Attributes:
        bench: Its name, as its report bears it.
        robots: Who is measured, one after another.
        seeds: How many.
        scenarios: Chosen ones; all that are usual when empty.
    """

    bench: str
    robots: tuple[str, ...]
    seeds: Annotated[int, Field(ge=1)] = 1
    scenarios: tuple[str, ...] = ()


@schema(frozen=True, slots=True, config=STRICT)
class SuiteConfig:
    """The suites, and which figures a report shows; see ``benchmarks/config/suite.yaml``.

    Attributes:
        quick: What takes minutes.
        full: What takes hours.
        keys: Of each bench, the figures of the report's summary, and what they are in words.
        figures: Of each bench, the figures of the report's table.
    """

    quick: tuple[Entry, ...]
    full: tuple[Entry, ...]
    keys: dict[str, dict[str, str]]
    figures: dict[str, tuple[str, ...]]


@cache
def suite_config() -> SuiteConfig:
    """The packaged suites."""
    return default_config(SuiteConfig, "benchmarks", "suite")


def _command_and_mode(bench: str) -> tuple[str, str]:
    """Name of the command that runs a benchmark, and its mode; empty where it has none."""
    return ("push", bench.removeprefix("push_")) if bench.startswith("push_") else (bench, "")


def command_of(entry: Entry, robot: str) -> str:
    """Command that measures one benchmark of a suite on one robot."""
    name, mode = _command_and_mode(entry.bench)
    words = ["poise", "bench", name, "--robot", robot, "--seeds", str(entry.seeds)]
    option = "--direction" if name == "push" else "--scenario"
    return " ".join([*words, *(["--mode", mode] if mode else []), *(f"{option} {each}" for each in entry.scenarios)])


def run_suite(
    entries: Sequence[Entry],
    modules: Mapping[str, str],
    folder: Path,
    sweep: Sweep,
    console: Console,
    suite: str = "quick",
) -> bool:
    """Run every benchmark and keep what it found.

    Args:
        entries: What is run.
        modules: Module of each benchmark, by the name that its reports bear.
        folder: Where the lines go; it holds the file of finished cases too.
        sweep: Workers, and the file of finished cases.
        console: Where it is told what is done.
        suite: Its name, for the report of an unfinished one.

    Returns:
        Whether all of them passed. One that cannot be run here or fails has not, and the next one is run.

    Raises:
        ConfigError: A benchmark is unknown, or there is no file of finished cases.
        WorkersError: There is nobody to measure: the next one would not fare better.
    """
    if sweep.results is None:
        raise ConfigError("a suite needs a file of finished cases")
    passed = True
    for entry in entries:
        if entry.bench not in modules:
            raise ConfigError(f"suite: unknown benchmark '{entry.bench}'; known: {', '.join(modules)}")
    parts = {(entry.bench, robot): command_of(entry, robot) for entry in entries for robot in entry.robots}
    save_plan(folder, suite, parts)
    for entry in entries:
        _, mode = _command_and_mode(entry.bench)
        for robot in entry.robots:
            sweep.results.taken.clear()
            noted = replace(sweep, began=_noting(folder, (entry.bench, robot), sweep.results))
            options = Options(robot, entry.seeds, scenarios=entry.scenarios, mode=mode, sweep=noted)
            try:
                report: Report = import_module(f"benchmarks.{modules[entry.bench]}").run(options)
            except WorkersError:
                raise
            except Exception as error:
                passed = False
                told = save_failure(folder, entry.bench, robot, error)
                where = f" ({folder / told.trace})" if told.trace else ""
                line = f"{entry.bench} {robot}: could not be run: {told.error}{where}"
                console.print(line, style="red", markup=False, soft_wrap=True)
                continue
            keys = sweep.results.taken.get(report.bench, [])
            anew = (entry.bench, robot) in [(part.bench, part.robot) for part in read_progress(folder).missing]
            save_report(folder, report, keys, command_of(entry, robot), anew=anew)
            passed = passed and report.passed
            verdict = "[green]passed[/green]" if report.passed else "[red]not passed[/red]"
            console.print(f"{entry.bench} {robot}: {len(report.cases)} cases, {verdict}")
    return passed


def _noting(folder: Path, part: Part, results: ResultsFile) -> Callable[[Sequence[str]], None]:
    """Notes the cases of a part as it asks for them, unless all of them are there."""
    asked: list[str] = []

    def began(keys: Sequence[str]) -> None:
        asked.extend(keys)
        if not results.has(keys):
            save_begun(folder, part, asked)

    return began
