"""A scheduler and workers that somebody started by hand: they die, come, are of another time; no case is lost."""

import os
import shutil
import signal
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from threading import Thread

import pytest

from benchmarks.core.executors import InProcess
from benchmarks.core.harness import Case, Options, Sweep, make_executor, run_cases
from benchmarks.core.results import ResultsFile, read_lines
from models.errors import WorkersError
from tests.dask_cluster import TIMEOUT, Cluster
from tests.ros.cable import staged
from tests.sweep_cases import slow_square, square

pytest.importorskip("distributed")

CASES = 24

STAGE = '''
"""Two machines with one cable, a worker on each, a scheduler and the sweep on the first; prints where cases ran."""
import json
from contextlib import ExitStack
from pathlib import Path

from benchmarks.core.cable import HERE, two_machines
from benchmarks.core.harness import make_executor
from benchmarks.core.harness import Options, Sweep, run_cases
from tests.dask_cluster import Cluster
from tests.sweep_cases import slow_network
import tests.dask_cluster

root = Path(tests.dask_cluster.__file__).parents[1]
with two_machines() as there, ExitStack() as stack:
    cluster = Cluster(Path.cwd(), root, stack)
    cluster.scheduler(host=HERE)
    cluster.worker()
    cluster.worker(machine=there)
    with make_executor(1, cluster.address) as executor:
        cases = [{"seed": seed} for seed in range(16)]
        found = run_cases(slow_network, cases, bench="networks", options=Options(sweep=Sweep(executor)))
print(json.dumps({"address": cluster.address, "cases": found}))
'''


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
        give_up = time.monotonic() + TIMEOUT
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
    # Each death repeats the case that was being measured, and at most one whose outcome was on its way.
    repeated = len([path for path in begun.iterdir() if int(path.name.split(".")[0]) != os.getpid()]) - CASES
    assert repeated <= 4


@pytest.mark.long
def test_a_scheduler_that_dies_is_named_and_the_same_command_goes_on(
    cluster: Cluster, begun: Path, tmp_path: Path
) -> None:
    scheduler = cluster.scheduler()
    cluster.worker()
    path, cases = tmp_path / "cases.jsonl", inputs(begun)[:12]
    act = after(begun, 5, scheduler.kill)
    with ResultsFile(path) as file, pytest.raises(WorkersError, match=f"{cluster.address}: the scheduler has ended"):
        swept(cluster.address, file, cases)
    act.join()
    kept = len(read_lines(path))
    assert 0 < kept < len(cases)
    with ResultsFile(path) as file:
        options = Options(sweep=Sweep(InProcess(), file))
        run_cases(slow_square, cases, bench="squares", options=options)
        assert (file.found, file.added) == (kept, len(cases) - kept)


@pytest.mark.long
def test_a_scheduler_that_gets_no_worker_is_named(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("benchmarks.core.dask_executor.ALONE_TIME", 1.0)
    cluster.scheduler()
    with (
        ResultsFile(tmp_path / "cases.jsonl") as file,
        pytest.raises(WorkersError, match=f"no worker for 1 s; start workers: dask worker {cluster.address}"),
    ):
        swept(cluster.address, file, [{"seed": 1}], square)


def test_who_listens_and_is_no_scheduler_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.core.dask_executor.CONNECT_TIME", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as listener, ResultsFile(tmp_path / "cases.jsonl") as file:
        address = f"tcp://127.0.0.1:{listener.getsockname()[1]}"
        with pytest.raises(
            WorkersError, match=rf"{address}: no connection to a dask scheduler: no answer within 0\.5 s"
        ):
            swept(address, file, [{"seed": 1}], square)


@pytest.mark.long
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


@pytest.mark.long
def test_a_scheduler_needs_no_poise_and_a_worker_does(cluster: Cluster, bare: Path, tmp_path: Path) -> None:
    cluster.scheduler(source=bare)
    nanny, _ = cluster.worker()
    with ResultsFile(tmp_path / "cases.jsonl") as file:
        assert swept(cluster.address, file, [{"seed": 3}], square)[0]["square"] == 9
    nanny.terminate()
    nanny.wait(TIMEOUT)
    cluster.worker(source=bare)
    with (
        ResultsFile(tmp_path / "cases.jsonl") as file,
        pytest.raises(WorkersError, match=r"a worker cannot import poise: No module named 'benchmarks.core'"),
    ):
        swept(cluster.address, file, [{"seed": 1}], square)


@pytest.mark.slow
def test_a_worker_of_another_machine_measures_over_the_network(tmp_path: Path, root: Path) -> None:
    found = staged({"stage.py": STAGE}, [], tmp_path, root)
    assert "127.0.0.1" not in found["address"]
    assert [case["seed"] for case in found["cases"]] == list(range(16))
    assert len({case["network"] for case in found["cases"]}) == 2  # both machines have measured
