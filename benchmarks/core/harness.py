"""Common parts of all benchmarks: seeded cases in worker processes, the JSON report (``Report.to_dict``), the table."""

import json
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from rich import progress
from rich.console import Console
from rich.table import Table

from benchmarks.core.executors import Case as Case
from benchmarks.core.executors import Done, Executor, InProcess, ProcessPool
from benchmarks.core.provenance import (
    configuration,
    difference,
    machine,
    revision,
    source_state,
    usable_cores,
    versions,
)
from benchmarks.core.results import NOT_RUN, ResultsFile, case_key, line_of, plain, with_nan, with_null
from models.errors import ConfigError, PoiseError, WorkersError

__all__ = ["Case"]  # re-exported for the benchmarks


@dataclass(frozen=True, slots=True)
class Sweep:
    """Executor and results file that all benchmarks of a run share."""

    executor: Executor | None = None  #: Measures the cases; None: each benchmark starts workers
    results: ResultsFile | None = None  #: Finished cases; optional
    #: Called with the keys of a benchmark's cases before the first one is measured
    began: Callable[[Sequence[str]], None] = lambda keys: None

    def stop_workers(self) -> None:
        """Stop the workers and the thread that serves them, which would disturb timing; the next cases restart them."""
        if self.executor is not None:
            self.executor.stop_workers()


@dataclass(frozen=True, slots=True)
class Options:
    """Command-line options of every benchmark."""

    robot: str = "g1"  #: Robot profile, by name or path
    seeds: int = 1  #: Number of seeds
    first_seed: int | None = None  #: First seed; the default of the benchmark when None
    workers: int = 1  #: Number of worker processes; with 1, cases run in this process
    scenarios: tuple[str, ...] = ()  #: Selected scenarios; the default ones if empty
    directions: str = ""  #: Grid of headings as ``COUNT`` or ``COUNT+DEGREES``; the default grid if empty
    size: float = 0.0  #: Impulse over mass of the only push tried [m/s]; 0 searches the largest push
    contender: str = ""  #: Controller under test, by the name of ``contender.load``; poise if empty
    sweep: Sweep = field(default_factory=Sweep)  #: Executor and results file

    def each_seed(self, usual: int = 0) -> range:
        """Return the seeds, starting at ``first_seed`` or the default first seed."""
        first = usual if self.first_seed is None else self.first_seed
        return range(first, first + self.seeds)


def chosen(bench: str, scenarios: Sequence[str], known: Sequence[str], usual: Sequence[str] | None = None) -> list[str]:
    """Return the selected scenarios, else ``usual``, else all ``known``; ``ConfigError`` lists the known ones."""
    unknown = [name for name in scenarios if name not in known]
    if unknown:
        raise ConfigError(f"bench {bench}: unknown scenario '{unknown[0]}'; known: {', '.join(known)}")
    return list(scenarios or (known if usual is None else usual))


@dataclass(frozen=True, slots=True)
class Report:
    """Result of a benchmark on one robot."""

    bench: str
    robot: str
    seeds: int
    figures: dict[str, float]  #: Values by flat name; the last part of the name is the unit
    cases: list[Case]  #: One entry per case
    passed: bool  #: Whether every bound holds
    load: dict[str, Any]  #: Load averages before and after, and number of cores [-]
    notes: list[str] = field(default_factory=list)  #: Remarks for the reader of the table, such as failed bounds
    contender: str = ""  #: Controller under test; empty for poise

    @property
    def who(self) -> str:
        """Subject of the figures, for titles: the robot, and the contender if any."""
        return f"{self.robot}, contender {self.contender}" if self.contender else self.robot

    @property
    def stem(self) -> str:
        """Robot name for file names: the profile without folder and suffix."""
        return Path(self.robot).stem

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object that every benchmark writes."""
        kept = {entry.name: getattr(self, entry.name) for entry in fields(self) if entry.name != "notes"}
        return kept | {"versions": versions(), "revision": revision()}


class LoadMeter:
    """Records the load average of the machine at construction and at reading."""

    def __init__(self) -> None:
        self._before = os.getloadavg()

    def read(self) -> dict[str, Any]:
        """Return load averages over 1, 5 and 15 minutes, before and now, and the number of usable cores."""
        return {
            "before": [round(x, 2) for x in self._before],
            "after": [round(x, 2) for x in os.getloadavg()],
            "cores": usable_cores(),
        }


def percentiles(samples: ArrayLike, name: str) -> dict[str, float]:
    """Return ``<name>_p50``, ``_p99``, ``_p999`` and ``_max`` of samples (n,); ``ValueError`` without samples."""
    values = np.asarray(samples, dtype=np.float64)
    if values.size == 0:
        raise ValueError(f"{name}: no samples to take percentiles of")
    p50, p99, p999 = np.percentile(values, [50.0, 99.0, 99.9])
    tail = {"p50": p50, "p99": p99, "p999": p999, "max": values.max()}
    return {f"{name}_{part}": float(value) for part, value in tail.items()}


def collect(
    produce: Callable[[Sequence[Case]], Iterator[tuple[int, Done]]],
    cases: Sequence[Mapping[str, Any]],
    *,
    bench: str,
    options: Options,
    alone: bool = False,
    silent: bool = False,
) -> list[Case]:
    """Read finished cases from the results file, measure the others, and write each one when it finishes.

    ``produce`` receives the inputs of the remaining cases and yields index and outcome of each. ``alone``: the cases
    are timed in this process. Then results of other machines do not count, and there is no progress bar because its
    thread would disturb the timing. ``silent`` also omits the bar. Returns inputs and outcome of each case, in the
    given order. Raises ``WorkersError`` for a worker with another revision or other packages.
    """
    file = options.sweep.results
    config = configuration(options.robot, options.contender) if file else ""
    environment = versions() | ({"machine": machine()} if alone else {})
    keys = [case_key(bench, config, source_state(), environment, case) for case in cases]
    inputs = {key: dict(case) for key, case in zip(keys, cases, strict=True)}
    known = {key: file.case(key) for key in inputs} if file else {}
    results = {key: case for key, case in known.items() if case is not None}
    options.sweep.began(keys)
    remaining = [key for key in inputs if key not in results]
    shown = (progress.MofNCompleteColumn(), progress.TimeElapsedColumn(), progress.TimeRemainingColumn())
    columns = (progress.TextColumn("{task.description}"), progress.BarColumn(), *shown)
    with progress.Progress(*columns, console=Console(stderr=True), disable=alone or silent) as bar:
        name = " ".join([bench, options.robot, *_shared(cases)])
        task = bar.add_task(name, total=len(inputs), completed=len(results))
        for index, done in produce([inputs[key] for key in remaining]):
            key = remaining[index]
            results[key] = plain({**inputs[key], **done.outcome})
            if why := difference((done.revision, done.versions), (source_state(), versions())):
                raise WorkersError(f"bench {bench}: a worker on {done.host} {why}")
            if file is not None and not results[key].get(NOT_RUN):
                file.add(line_of(key, bench, options.robot, config, inputs[key], results[key], done))
            failed = sum(not (case.get("survived", True) or case.get(NOT_RUN)) for case in results.values())
            bar.update(task, advance=1, description=f"{name}, {failed} failed" if failed else name)
    if file is not None:
        file.requested.setdefault(bench, []).extend(key for key in keys if not results[key].get(NOT_RUN))
    return [dict(results[key]) for key in keys]


def _shared(cases: Sequence[Mapping[str, Any]]) -> list[str]:
    """Scenario and level that all cases have in common, for the progress bar."""
    values = [cases[0].get(name) for name in ("scenario", "level") if len({str(each.get(name)) for each in cases}) == 1]
    return [f"{value:g}" if isinstance(value, float) else str(value) for value in values if value is not None]


def run_cases(
    measure: Callable[..., Case],
    cases: Sequence[Mapping[str, Any]],
    *,
    bench: str,
    options: Options,
    alone: bool = False,
    silent: bool = False,
) -> list[Case]:
    """Measure the cases without a result with a module-level function; ``alone``: in this process, for timing.

    ``silent`` omits the progress bar, as ``alone`` does.
    """

    def produce(remaining: Sequence[Case]) -> Iterator[tuple[int, Done]]:
        executor = options.sweep.executor
        if alone:
            if remaining:
                options.sweep.stop_workers()
            executor = InProcess()
        if executor is not None:
            yield from executor.run(measure, remaining)
            return
        with make_executor(options.workers) as executor:
            yield from executor.run(measure, remaining)

    return collect(produce, cases, bench=bench, options=options, alone=alone, silent=silent)


def write_json(report: Report, path: Path) -> None:
    """Write the report; NaN and infinity become null because JSON lacks them."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(with_null(plain(report.to_dict())), indent=1) + "\n", encoding="utf-8")


def read_json(path: Path) -> Report:
    """Read a report of ``write_json``; null becomes NaN, notes are dropped; ``ConfigError`` for any other file."""
    try:
        found = with_nan(json.loads(path.read_text(encoding="utf-8")))
        kept = ("bench", "robot", "seeds", "figures", "cases", "passed", "load")
        return Report(**{name: found[name] for name in kept}, contender=found.get("contender", ""))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"{path}: not a report of a benchmark: {error!r}") from error


def print_report(report: Report, console: Console) -> None:
    """Print the figures as a table, followed by the notes and the verdict."""
    table = Table(title=f"{report.bench}: {report.who}, seeds {report.seeds}", title_justify="left")
    table.add_column("figure")
    table.add_column("value", justify="right")
    for name, value in report.figures.items():
        table.add_row(name, f"{value:.4g}" if math.isfinite(value) else "-")
    console.print(table)
    load = report.load
    console.print(f"load average {load['before'][0]} before, {load['after'][0]} after, {load['cores']} cores")
    for note in report.notes:
        console.print(note, markup=False, soft_wrap=True)
    console.print("[green]passed[/green]" if report.passed else "[red]not passed[/red]")


def make_executor(workers: int, scheduler: str = "") -> Executor:
    """Create the executor: dask scheduler, process pool, or this process (one worker); ``PoiseError`` without dask."""
    if not scheduler:
        return InProcess() if workers <= 1 else ProcessPool(workers)
    if find_spec("distributed") is None:
        raise PoiseError(f"--scheduler {scheduler}: needs dask: pip install 'poise[bench]'")
    from benchmarks.core.dask_executor import DaskWorkers

    return DaskWorkers(scheduler)
