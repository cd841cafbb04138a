"""``poise bench all`` that is killed, interrupted or has a benchmark that fails: what is kept, what the report says."""

import os
import subprocess
import sys
import time
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console
from typer.testing import CliRunner

from benchmarks.cli import app
from benchmarks.core.benchmark import Benchmark, Info, Listed, Part
from benchmarks.core.executors import InProcess
from benchmarks.core.harness import Case, Options, Sweep
from benchmarks.core.results import ResultsFile, read_lines
from benchmarks.report import report_page, suite
from benchmarks.report.suite import CASES, PLAN, REPORTS, command_of, read_progress, save_begun, save_plan
from models.errors import WorkersError
from tests import sweep_cases


class _Sweep(Benchmark):
    """A benchmark whose cases are the function of its name in ``tests/sweep_cases.py``."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.measure = getattr(sweep_cases, name)

    def cases(self, options: Options) -> list[Case]:
        return [{"seed": seed} for seed in range(options.seeds)]

    def figures(self, cases: list[Case]) -> dict[str, float]:
        return {}


class _Listed(Listed):
    def load(self) -> Benchmark:
        return _Sweep(self.name)


def made(*names: str) -> dict[str, Listed]:
    """Benchmarks whose cases are the functions of these names in ``tests/sweep_cases.py``."""
    return {name: _Listed(name, Info(""), "") for name in names}


def suite_of(folder: Path, modules: dict[str, Listed], **parts: Part) -> tuple[bool, str]:
    """Whether a suite passed, and what it said."""
    console = Console(record=True, width=200, file=StringIO())
    with ResultsFile(folder / CASES) as file:
        passed = suite.run_suite(parts, modules, folder, Sweep(InProcess(), file), console, "full")
    return passed, console.export_text()


def test_whatever_a_benchmark_raises_is_reported_and_the_others_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("markdown_it")
    modules = made("refused", "square")
    passed, said = suite_of(tmp_path, modules, refused=Part(("g1",)), square=Part(("g1",)))
    assert not passed and "refused g1: could not be run: KeyError: 0" in said and "square g1: 1 cases, passed" in said
    trace = tmp_path / "errors/refused-g1.txt"
    assert "in refused" in trace.read_text() and str(trace) in said
    report_page.write_report(tmp_path)
    page = (tmp_path / "report.md").read_text()
    assert "refused, g1: KeyError: 0 (`errors/refused-g1.txt`)" in page and "Partial" not in page
    assert "| square | g1 | 1 | 1 |" in page


@pytest.mark.parametrize("error", [KeyboardInterrupt, WorkersError])
def test_who_interrupts_and_who_has_no_workers_ends_the_suite(
    error: type[BaseException], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def ends(seed: int) -> None:
        raise error

    modules = made("refused", "square")
    monkeypatch.setattr("tests.sweep_cases.refused", ends)
    with pytest.raises(error):
        suite_of(tmp_path, modules, refused=Part(("g1",)), square=Part(("g1",)))
    assert str(read_progress(tmp_path)) == (
        "partial: 0 of 2 parts of --full are finished; parts in progress: 0 of 1 cases; parts not begun: 1"
    )


def test_another_revision_or_a_new_beginning_is_missing_until_it_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    modules = made("square")
    assert suite_of(tmp_path, modules, square=Part(("g1",), 2))[0]
    assert not read_progress(tmp_path).missing
    suite_of(tmp_path, modules, square=Part(("g1",), 2))  # has all, and begins nothing
    assert not read_progress(tmp_path).missing and len(read_lines(tmp_path / PLAN)) == 2
    save_begun(tmp_path, ("square", "g1"), [read_lines(tmp_path / CASES)[0]["key"], "more"])
    (part,) = read_progress(tmp_path).missing
    assert part.state == "1 of 2 cases; the report shows an earlier measurement"
    assert suite_of(tmp_path, modules, square=Part(("g1",), 2))[0]
    assert not read_progress(tmp_path).missing
    save_plan(tmp_path, "full", {("square", "g1"): "of more seeds"})  # as --full after --quick
    assert read_progress(tmp_path).missing
    monkeypatch.setattr("benchmarks.report.suite.source_state", lambda: "later")
    save_plan(
        tmp_path,
        "full",
        {("square", "g1"): command_of(Part(("g1",), 2), modules["square"], "g1"), ("stand", "g1"): ""},
    )
    assert [part.state for part in read_progress(tmp_path).missing] == [
        "not begun; the report shows an earlier measurement", "not begun",
    ]  # fmt: skip


def test_a_part_with_a_case_that_cannot_be_run_here_is_finished_however_often(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    modules = made("lacking")
    for _ in range(2):  # the second run tries it again
        assert suite_of(tmp_path, modules, lacking=Part(("g1",), 2))[0]
        assert not read_progress(tmp_path).missing
    assert [line["seed"] for line in read_lines(tmp_path / CASES)] == [0]


def test_cases_that_were_measured_again_are_reported_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    modules = made("square")
    for _ in range(2):
        (tmp_path / CASES).unlink(missing_ok=True)
        assert suite_of(tmp_path, modules, square=Part(("g1",), 2))[0]
        assert not read_progress(tmp_path).missing
    assert len(read_lines(tmp_path / REPORTS)) == 2


CASES_OF_ALL = 6

COMMAND = """
import sys
from benchmarks.report import suite
from benchmarks.core.benchmark import Part
from benchmarks.cli import app

parts = {"faults": Part(("g1",), 6, ("stamp_in_the_future",)), "stand": Part(("unknown",))}
suite.parts_of = lambda name: parts
app(["all", "--full", "--out", sys.argv[1], "--workers", "2"])
"""
"""``poise bench all`` with a tiny suite."""


@pytest.mark.slow
def test_a_suite_that_is_killed_goes_on_without_a_case_lost_or_repeated(tmp_path: Path, root: Path) -> None:
    pytest.importorskip("markdown_it")
    folder = tmp_path / "bench"
    cases, plan = folder / CASES, folder / PLAN
    command = [sys.executable, "-c", COMMAND, str(folder)]
    environment = dict(os.environ) | {"PYTHONPATH": str(root)}
    give_up = time.monotonic() + 300.0  # the first run compiles
    with subprocess.Popen(command, cwd=tmp_path, env=environment) as killed:
        while (not cases.is_file() or cases.read_bytes().count(b"\n") < 2) and time.monotonic() < give_up:
            time.sleep(0.02)
        found = subprocess.run(["pgrep", "-P", str(killed.pid)], stdout=subprocess.PIPE, text=True, check=True)
        killed.kill()
    give_up = time.monotonic() + 20.0
    workers = [Path(f"/proc/{pid}") for pid in found.stdout.split()]
    while any(worker.exists() for worker in workers) and time.monotonic() < give_up:
        time.sleep(0.05)
    assert workers and not any(worker.exists() for worker in workers)  # or they would measure beside the next ones
    whole, kept = cases.read_bytes(), len(read_lines(cases))
    assert 2 <= kept < CASES_OF_ALL
    for file in (cases, plan):
        file.write_bytes(file.read_bytes() + b'{"key": "cut o')

    assert CliRunner().invoke(app, ["report", str(folder)]).exit_code == 0
    page = (folder / "report.md").read_text()
    begun = f"parts in progress: {kept} of 6 cases"
    line = f"Partial: 0 of 2 parts of --full are finished; {begun}; parts not begun: 1"
    assert line in page
    assert f"| faults | g1 | {kept} of 6 cases |" in page and "Not begun: stand unknown." in page

    again = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert f"{kept} cases already finished, {CASES_OF_ALL - kept} measured" in again.stdout, again.stderr
    assert cases.read_bytes().startswith(whole[: whole.rfind(b"\n") + 1])
    assert sorted(line["seed"] for line in read_lines(cases)) == list(range(CASES_OF_ALL))
    assert "Partial" not in (folder / "report.md").read_text()
