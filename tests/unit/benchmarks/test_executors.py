"""Workers that die are replaced, and every case comes back exactly once."""

import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Thread
from threading import enumerate as enumerate_threads
from unittest.mock import patch

import pytest

from benchmarks.core import executors, harness
from benchmarks.core.executors import Executor, InProcess, ProcessPool
from benchmarks.core.harness import Options, Sweep, make_executor, run_cases
from benchmarks.core.results import ResultsFile, read_lines
from models.errors import PoiseError, WorkersError
from models.numerics.threads import THREAD_VARIABLES
from tests.sweep_cases import deadly, refused, slow_square, square

CASES = 8


@pytest.fixture(scope="module")
def dask() -> Iterator[Callable[[], Executor]]:
    """Two workers of dask, started again when they die."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, memory_limit=None, dashboard_address=None) as made:
        yield lambda: make_executor(2, made.scheduler_address)


@pytest.fixture(params=["pool", pytest.param("dask", marks=pytest.mark.long)])
def make(request: pytest.FixtureRequest) -> Callable[[], Executor]:
    """Both kinds of workers."""
    if request.param == "dask":
        return request.getfixturevalue("dask")
    return lambda: make_executor(2)


def kill_first(folder: Path) -> None:
    """Kill the first worker that has begun a case."""
    give_up = time.monotonic() + 60.0
    while time.monotonic() < give_up:
        for file in folder.iterdir():
            os.kill(int(file.name.split(".")[0]), signal.SIGKILL)
            return
        time.sleep(0.005)


@pytest.mark.long
def test_a_worker_that_is_killed_loses_and_repeats_no_case(make: Callable[[], Executor], tmp_path: Path) -> None:
    started = tmp_path / "started"
    started.mkdir()
    killer = Thread(target=kill_first, args=(started,))
    killer.start()
    inputs = [{"seed": seed, "folder": str(started)} for seed in range(CASES)]
    with ResultsFile(tmp_path / "cases.jsonl") as file, make() as executor:
        options = Options(sweep=Sweep(executor, file))
        results = run_cases(slow_square, inputs, bench="squares", options=options)
        # The same workers, whole again, measure on.
        more = run_cases(square, [{"seed": 9}], bench="squares", options=options)
    killer.join()
    assert [case["square"] for case in results] == [seed * seed for seed in range(CASES)]
    assert more[0]["square"] == 81
    begun = list(started.iterdir())
    assert len(begun) > CASES  # the case of the killed worker has begun twice
    lines = read_lines(tmp_path / "cases.jsonl")
    assert sorted(line["seed"] for line in lines) == [*range(CASES), 9]
    assert len({line["key"] for line in lines}) == CASES + 1


def test_workers_are_other_processes_on_one_thread_and_go(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in THREAD_VARIABLES:
        monkeypatch.delenv(name, raising=False)
    with make_executor(2) as executor:
        cases = [{"seed": seed} for seed in range(4)]
        results = run_cases(square, cases, bench="squares", options=Options(sweep=Sweep(executor)))
    pids = {case["pid"] for case in results}
    assert os.getpid() not in pids
    assert all(case["threads"] == ["1", "1", "1", "1"] for case in results)
    give_up = time.monotonic() + 20.0
    while any(Path(f"/proc/{pid}").exists() for pid in pids) and time.monotonic() < give_up:
        time.sleep(0.05)
    assert not any(Path(f"/proc/{pid}").exists() for pid in pids)


def test_workers_rest_while_something_is_timed() -> None:
    with make_executor(2) as executor:
        options = Options(sweep=Sweep(executor))
        (first,) = run_cases(square, [{"seed": 1}], bench="squares", options=options)
        threads = {thread.name for thread in enumerate_threads()}
        (timed,) = run_cases(square, [{"seed": 2}], bench="squares", options=options, alone=True)
        assert timed["pid"] == os.getpid() != first["pid"]
        assert not Path(f"/proc/{first['pid']}").exists()
        assert {thread.name for thread in enumerate_threads()} < threads
        assert run_cases(square, [{"seed": 3}], bench="squares", options=options)[0]["pid"] != os.getpid()


def test_a_case_that_fails_ends_the_sweep(make: Callable[[], Executor]) -> None:
    with make() as executor, pytest.raises(KeyError):
        run_cases(refused, [{"seed": 0}], bench="fails", options=Options(sweep=Sweep(executor)))


def test_a_case_that_kills_every_worker_ends_the_sweep(make: Callable[[], Executor]) -> None:
    with make() as executor, pytest.raises(PoiseError, match=r"died|killed"):
        run_cases(deadly, [{"seed": 0}], bench="kills", options=Options(sweep=Sweep(executor)))


def test_a_worker_of_another_revision_is_refused(tmp_path: Path) -> None:
    with (
        patch.object(executors, "source_state", lambda: "elsewhere"),
        patch.object(harness, "source_state", lambda: "here"),
        ResultsFile(tmp_path / "cases.jsonl") as file,
        pytest.raises(WorkersError, match=r"a worker on \S+ runs revision elsewhere, not here"),
    ):
        run_cases(square, [{"seed": 0}], bench="squares", options=Options(sweep=Sweep(InProcess(), file)))
    assert not read_lines(tmp_path / "cases.jsonl")


def test_without_dask_a_scheduler_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(harness, "find_spec", lambda name: None)
    assert isinstance(make_executor(2), ProcessPool)
    assert isinstance(make_executor(1), InProcess)
    with pytest.raises(PoiseError, match="needs dask"):
        make_executor(1, "tcp://127.0.0.1:8786")


def test_a_scheduler_that_does_not_answer_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    dask_executor = pytest.importorskip("benchmarks.core.dask_executor")
    monkeypatch.setattr(dask_executor, "CONNECT_TIME", 0.5)
    with (
        make_executor(1, "tcp://127.0.0.1:9") as executor,
        pytest.raises(PoiseError, match=r"127\.0\.0\.1:9: no connection"),
    ):
        run_cases(square, [{"seed": 0}], bench="squares", options=Options(sweep=Sweep(executor)))
