"""What every benchmark shares: seeded cases run by worker processes, one JSON schema, one table.

A benchmark is a module ``benchmarks/<name>.py`` with

    ``run(options: Options) -> Report``        measures and judges
    ``plot(report: Report, folder: Path)``     draws what the report holds; returns the files written

The JSON that ``Report.to_dict`` gives is ``{"bench", "robot", "seeds", "figures", "cases", "versions", "revision",
"load", "passed"}``; ``figures`` maps flat names to numbers, ``load`` holds the load averages before and after.
"""

from __future__ import annotations

import json
import math
import os
import platform
import subprocess
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from models.errors import ConfigError
from models.threads import use_one_thread

Case = dict[str, Any]
"""One measured case: its inputs (seed, direction, ...) and what came out, as plain JSON values."""

MEASURED_PACKAGES = (
    *("poise", "pin", "placo", "mujoco", "daqp", "quadprog", "numba", "numpy", "ros-rclpy"),
    *("qpsolvers", "osqp", "proxsuite", "piqp", "clarabel", "pin-pink", "mink"),
)
"""Packages whose versions decide a figure."""


@dataclass(frozen=True, slots=True)
class Options:
    """What the command line of every benchmark takes.

    Attributes:
        robot: Name of a profile, or path of one.
        seeds: How many seeds; they are 0 .. seeds - 1.
        workers: How many processes measure cases at the same time.
        scenarios: Which ones of a benchmark that has several; all of them when empty.
        mode: Which kind of a benchmark that has several.
        contender: Controller to test instead of poise's own, as ``module:Class``; see ``benchmarks/contender.py``.
    """

    robot: str = "g1"
    seeds: int = 1
    workers: int = 1
    scenarios: tuple[str, ...] = ()
    mode: str = ""
    contender: str = ""


def chosen(bench: str, scenarios: Sequence[str], known: Sequence[str], usual: Sequence[str] | None = None) -> list[str]:
    """Scenarios that the user has chosen, or the usual ones.

    Args:
        bench: What is run, for the message.
        scenarios: The user's choice; empty for none.
        known: Those there are.
        usual: Those without a choice; all that are known when None.

    Raises:
        ConfigError: One is unknown; the known ones are listed.
    """
    unknown = [name for name in scenarios if name not in known]
    if unknown:
        raise ConfigError(f"bench {bench}: unknown scenario '{unknown[0]}'; known: {', '.join(known)}")
    return list(scenarios or (known if usual is None else usual))


@dataclass(frozen=True, slots=True)
class Report:
    """What a benchmark found.

    Attributes:
        bench: Name of the benchmark.
        robot: Name of the robot.
        seeds: How many seeds.
        figures: Flat name to number; the unit is the last part of the name.
        cases: One entry per case.
        passed: Whether every bound of the benchmark holds.
        load: Load averages before and after, and the number of cores [-].
        notes: Remarks for the reader of the table, such as which bound failed.
    """

    bench: str
    robot: str
    seeds: int
    figures: dict[str, float]
    cases: list[Case]
    passed: bool
    load: dict[str, Any]
    notes: list[str] = field(default_factory=list)

    def to_dict(self) -> dict[str, Any]:
        """The one JSON object that every benchmark writes."""
        return {
            "bench": self.bench,
            "robot": self.robot,
            "seeds": self.seeds,
            "figures": self.figures,
            "cases": self.cases,
            "versions": versions(),
            "revision": revision(),
            "load": self.load,
            "passed": self.passed,
        }


class LoadMeter:
    """Notes the machine's load average when made and when asked."""

    def __init__(self) -> None:
        self._before = os.getloadavg()

    def read(self) -> dict[str, Any]:
        """Load averages over 1, 5 and 15 minutes before and now, and the cores this process may use."""
        return {
            "before": [round(x, 2) for x in self._before],
            "after": [round(x, 2) for x in os.getloadavg()],
            "cores": usable_cores(),
        }


def usable_cores() -> int:
    """How many cores this process may run on."""
    return len(os.sched_getaffinity(0))


def versions() -> dict[str, str]:
    """Versions of Python and of every package that decides a figure; packages that are absent are left out."""
    found = {"python": platform.python_version(), "machine": platform.machine()}
    for name in MEASURED_PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def revision() -> str:
    """Git revision of the checkout, with ``+`` when it has changes; ``unknown`` outside of a checkout."""
    root = Path(__file__).resolve().parents[1]

    def git(*arguments: str) -> str:
        return subprocess.run(
            ["git", "-C", str(root), *arguments], capture_output=True, text=True, check=True, timeout=20
        ).stdout.strip()

    try:
        if Path(git("rev-parse", "--show-toplevel")).resolve() != root:
            return "unknown"
        return git("rev-parse", "HEAD") + ("+" if git("status", "--porcelain", "--untracked-files=no") else "")
    except (OSError, subprocess.SubprocessError):
        return "unknown"


def percentiles(samples: ArrayLike, name: str) -> dict[str, float]:
    """Median, tail and worst of a sample, as figures.

    Args:
        samples: Measured values (n,), any unit.
        name: Prefix of the figures' names, such as ``tick_us``.

    Returns:
        ``<name>_p50``, ``<name>_p99``, ``<name>_p999`` and ``<name>_max``.

    Raises:
        ValueError: There is no sample.
    """
    values = np.asarray(samples, dtype=np.float64)
    if values.size == 0:
        raise ValueError(f"{name}: no samples to take percentiles of")
    p50, p99, p999 = np.percentile(values, [50.0, 99.0, 99.9])
    tail = {"p50": p50, "p99": p99, "p999": p999, "max": values.max()}
    return {f"{name}_{part}": float(value) for part, value in tail.items()}


def run_cases(
    measure: Callable[..., Case],
    cases: Sequence[Mapping[str, Any]],
    *,
    title: str,
    workers: int = 1,
    console: Console | None = None,
) -> list[Case]:
    """Measure every case, in worker processes, with a progress bar.

    A case depends on its own inputs only, so the order of completion does not matter.

    Args:
        measure: Function of a module (it is sent to other processes by name); called with a case's entries.
        cases: Keyword arguments of each call.
        title: Label of the progress bar.
        workers: Processes; with 1 the cases run in this process.
        console: Where the progress bar goes; standard error by default.

    Returns:
        For each case, in the order given, its inputs and what ``measure`` returned.
    """
    results: list[Case | None] = [None] * len(cases)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console or Console(stderr=True)) as progress:
        task = progress.add_task(title, total=len(cases))
        if workers <= 1:
            for index, case in enumerate(cases):
                results[index] = {**case, **measure(**case)}
                progress.advance(task)
        else:
            use_one_thread()  # for the workers, which inherit it
            with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
                futures = {pool.submit(measure, **case): index for index, case in enumerate(cases)}
                for future in as_completed(futures):
                    index = futures[future]
                    results[index] = {**cases[index], **future.result()}
                    progress.advance(task)
    return [result for result in results if result is not None]


def write_json(report: Report, path: Path) -> None:
    """Write the report; numbers that JSON has no word for (NaN, infinity) become null."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(_plain(report.to_dict()), indent=1) + "\n", encoding="utf-8")


def read_json(path: Path) -> Report:
    """Read what ``write_json`` wrote; null becomes NaN, notes are not kept.

    Raises:
        ConfigError: The file is not a report.
    """
    try:
        found = _with_nan(json.loads(path.read_text(encoding="utf-8")))
        kept = ("bench", "robot", "seeds", "figures", "cases", "passed", "load")
        return Report(**{name: found[name] for name in kept})
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"{path}: not a report of a benchmark: {error!r}") from error


def _with_nan(value: Any) -> Any:
    """The value with NaN where JSON had no word for it."""
    if isinstance(value, dict):
        return {key: _with_nan(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_with_nan(entry) for entry in value]
    return math.nan if value is None else value


def _plain(value: Any) -> Any:
    """The value as JSON knows it."""
    if isinstance(value, dict):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, np.bool_):
        return bool(value)
    if isinstance(value, np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value


def print_report(report: Report, console: Console) -> None:
    """Print the figures as a table, with the verdict below."""
    table = Table(title=f"{report.bench}: {report.robot}, seeds {report.seeds}", title_justify="left")
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
