"""A scheduler and workers that somebody started by hand: they die, come, are of another time; no case is lost."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from threading import Thread

import pytest

from benchmarks.executors import InProcess, make_executor
from benchmarks.harness import Case, Options, Sweep, run_cases
from benchmarks.results import ResultsFile, read_lines
from models.errors import WorkersError
from tests.sweep_cases import slow_square, square

pytest.importorskip("distributed")

CASES = 24


PATIENCE = 60.0
"""Longest wait for a process [s]."""


class Cluster:
    """Processes of dask, each started as the documentation says, that end with the test.

    Args:
        folder: For what they say.
        root: Of the checkout, from which they run.
        stack: Ends them.
    """

    def __init__(self, folder: Path, root: Path, stack: ExitStack) -> None:
        self._folder, self._root, self._stack, self._count = folder, root, stack, 0
        self.address = ""

    def start(self, *words: str, source: Path | None = None) -> tuple[subprocess.Popen[bytes], Path]:
        """Start a program of dask; its process, and the file of what it says."""
        self._count += 1
        told = self._folder / f"dask-{self._count}.log"
        environment = dict(os.environ) | {"PYTHONPATH": str(source or self._root)}
        command = [sys.executable, "-m", "dask", *words, "--no-dashboard"]
        with told.open("wb") as file:
            process = subprocess.Popen(command, cwd=self._folder, env=environment, stdout=file, stderr=file)
        self._stack.callback(_end, process)
        return process, told

    def scheduler(self, source: Path | None = None) -> subprocess.Popen[bytes]:
        """Start a scheduler on a free port and note its address."""
        process, told = self.start("scheduler", "--host", "127.0.0.1", "--port", "0", source=source)
        found = _said(told, r"Scheduler at:\s+(tcp://\S+)")
        self.address = found.group(1)
        return process

    def worker(self, source: Path | None = None) -> tuple[subprocess.Popen[bytes], int]:
        """Start a nanny with one worker, and wait until it is known; the nanny, and the worker's process."""
        nanny, told = self.start("worker", self.address, "--nworkers", "1", "--nthreads", "1", source=source)
        _said(told, r"Registered to:")
        return nanny, _children(nanny.pid)[-1]


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(10.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _said(file: Path, pattern: str) -> re.Match[str]:
    give_up = time.monotonic() + PATIENCE
    while time.monotonic() < give_up:
        if found := re.search(pattern, file.read_text(errors="replace")):
            return found
        time.sleep(0.05)
    raise AssertionError(f"'{pattern}' was not said:\n{file.read_text(errors='replace')}")


def _children(pid: int) -> list[int]:
    """Workers of a nanny, the resource tracker of multiprocessing left out."""
    found = subprocess.run(["pgrep", "-P", str(pid), "-f", "spawn_main"], capture_output=True, text=True, check=True)
    return [int(word) for word in found.stdout.split()]


@pytest.fixture
def cluster(tmp_path: Path, root: Path) -> Iterator[Cluster]:
    with ExitStack() as stack:
        yield Cluster(tmp_path, root, stack)


@pytest.fixture
def begun(tmp_path: Path) -> Path:
    """Folder in which each case leaves a file as it begins."""
    (tmp_path / "begun").mkdir()
    return tmp_path / "begun"


def inputs(folder: Path) -> list[Case]:
    return [{"seed": seed, "folder": str(folder)} for seed in range(CASES)]


def swept(address: str, file: ResultsFile, cases: list[Case], measure: Callable[..., Case] = slow_square) -> list[Case]:
    with make_executor(1, address) as executor:
        return run_cases(measure, cases, bench="squares", options=Options(sweep=Sweep(executor, file)))


def after(begun: Path, count: int, act: Callable[[], object]) -> Thread:
    """Do something in a thread as soon as so many cases have begun."""

    def wait() -> None:
        give_up = time.monotonic() + PATIENCE
        while len(list(begun.iterdir())) < count and time.monotonic() < give_up:
            time.sleep(0.005)
        act()

    thread = Thread(target=wait)
    thread.start()
    return thread


@pytest.mark.slow
def test_workers_die_and_come_and_every_case_is_there_once(cluster: Cluster, begun: Path, tmp_path: Path) -> None:
    cluster.scheduler()
    _, first = cluster.worker()
    nanny, second = cluster.worker()
    with ResultsFile(tmp_path / "cases.jsonl") as file:
        acts = [
            after(begun, 4, lambda: os.kill(first, signal.SIGKILL)),  # its nanny starts another
            after(begun, 9, nanny.kill),  # and with it its worker, for good
            after(begun, 12, cluster.worker),
        ]
        results = swept(cluster.address, file, inputs(begun))
        for act in acts:
            act.join()
    with ResultsFile(tmp_path / "here.jsonl") as file:
        options = Options(sweep=Sweep(InProcess(), file))
        assert results == run_cases(slow_square, inputs(begun), bench="squares", options=options)
    there, here = ({line["key"]: line["case"] for line in read_lines(tmp_path / f"{name}.jsonl")}
                   for name in ("cases", "here"))  # fmt: skip
    assert there == here and len(there) == CASES
    assert len(read_lines(tmp_path / "cases.jsonl")) == CASES
    pids = {int(path.name.split(".")[0]) for path in begun.iterdir()} - {os.getpid()}
    assert {first, second} < pids and len(pids) >= 3


def test_a_scheduler_that_dies_is_named_and_the_same_command_goes_on(
    cluster: Cluster, begun: Path, tmp_path: Path
) -> None:
    scheduler = cluster.scheduler()
    cluster.worker()
    path = tmp_path / "cases.jsonl"
    act = after(begun, 5, scheduler.kill)
    with ResultsFile(path) as file, pytest.raises(WorkersError, match=f"{cluster.address}: the scheduler has ended"):
        swept(cluster.address, file, inputs(begun))
    act.join()
    kept = len(read_lines(path))
    assert 0 < kept < CASES
    with ResultsFile(path) as file:
        options = Options(sweep=Sweep(InProcess(), file))
        run_cases(slow_square, inputs(begun), bench="squares", options=options)
        assert (file.found, file.added) == (kept, CASES - kept)


def test_a_scheduler_that_gets_no_worker_is_named(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("benchmarks.dask_executor.ALONE_TIME", 1.0)
    cluster.scheduler()
    with (
        ResultsFile(tmp_path / "cases.jsonl") as file,
        pytest.raises(WorkersError, match=f"no worker for 1 s; start some: dask worker {cluster.address}"),
    ):
        swept(cluster.address, file, [{"seed": 1}], square)


def test_a_worker_of_another_revision_measures_nothing(
    cluster: Cluster, root: Path, begun: Path, tmp_path: Path
) -> None:
    copied = tmp_path / "elsewhere"  # no checkout: it has a version only
    for name in ("models", "planners", "controllers", "bridge", "benchmarks", "tests"):
        shutil.copytree(root / name, copied / name, ignore=shutil.ignore_patterns("__pycache__", "*.nbi", "*.nbc"))
    cluster.scheduler()
    cluster.worker(source=copied)
    with (
        ResultsFile(tmp_path / "cases.jsonl") as file,
        pytest.raises(WorkersError, match=r"a worker on \S+ runs revision version \S+, not \w+"),
    ):
        swept(cluster.address, file, inputs(begun))
    assert not list(begun.iterdir()) and not read_lines(tmp_path / "cases.jsonl")


@pytest.fixture
def bare(tmp_path: Path) -> Path:
    """An environment without poise: its empty package comes before any that is installed."""
    (tmp_path / "bare/benchmarks").mkdir(parents=True)
    (tmp_path / "bare/benchmarks/__init__.py").touch()
    return tmp_path / "bare"


def test_a_scheduler_needs_no_poise_and_a_worker_does(cluster: Cluster, bare: Path, tmp_path: Path) -> None:
    cluster.scheduler(source=bare)
    cluster.worker()
    with ResultsFile(tmp_path / "cases.jsonl") as file:
        assert swept(cluster.address, file, [{"seed": 3}], square)[0]["square"] == 9
    cluster.scheduler()
    cluster.worker(source=bare)
    with (
        ResultsFile(tmp_path / "cases.jsonl") as file,
        pytest.raises(WorkersError, match=r"a worker has not this poise: No module named 'benchmarks.executors'"),
    ):
        swept(cluster.address, file, [{"seed": 1}], square)
