"""Where cases are measured: in this process, in a pool of processes, or by dask on one machine or many."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from importlib.util import find_spec
from multiprocessing import get_context
from types import TracebackType

from benchmarks.core.measured import Case, Done, Executor, measured
from models.errors import PoiseError
from models.nodes.realtime import die_with_parent
from models.numerics.threads import use_one_thread

DEATHS_ALLOWED = 3  # deaths of workers in a row, without a finished case, that end the sweep


class InProcess:
    """One case after another, here."""

    def __enter__(self) -> InProcess:
        return self

    def __exit__(self, kind: object, error: object, trace: TracebackType | None) -> None:
        pass

    def rest(self) -> None:
        """There are no workers."""

    def run(self, measure: Callable[..., Case], cases: Sequence[Case]) -> Iterator[tuple[int, Done]]:
        """See ``Executor``."""
        for index, case in enumerate(cases):
            yield index, measured(measure, case)


class ProcessPool:
    """Processes of this machine; when one dies, all restart with the remaining cases."""

    def __init__(self, workers: int) -> None:
        self._workers = workers
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> ProcessPool:
        return self

    def __exit__(self, kind: object, error: object, trace: TracebackType | None) -> None:
        self.rest()

    def rest(self) -> None:
        """See ``Executor``."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
            self._pool = None

    def _submit(self, measure: Callable[..., Case], left: Iterable[tuple[int, Case]]) -> dict[Future[Done], int]:
        if self._pool is None:
            use_one_thread()  # for the workers, which inherit it
            self._pool = ProcessPoolExecutor(self._workers, get_context("spawn"), die_with_parent)
        return {self._pool.submit(measured, measure, case): index for index, case in left}

    def run(self, measure: Callable[..., Case], cases: Sequence[Case]) -> Iterator[tuple[int, Done]]:
        """See ``Executor``; ``PoiseError`` when workers die repeatedly."""
        left, deaths = dict(enumerate(cases)), 0
        while left:
            before = len(left)
            try:
                futures = self._submit(measure, left.items())
            except BrokenProcessPool:  # one has died while it had nothing to do, or has just died
                futures = {}
            try:
                for future in as_completed(futures):
                    try:
                        outcome = future.result()
                    except BrokenProcessPool:
                        continue
                    index = futures[future]
                    del left[index]
                    yield index, outcome
            finally:
                for future in futures:
                    future.cancel()
            if left:
                self.rest()
                deaths = 0 if len(left) < before else deaths + 1
                if deaths >= DEATHS_ALLOWED:
                    raise PoiseError(f"worker processes died {deaths} times in a row, {len(left)} cases are left")


def local_executor(workers: int) -> Executor:
    """Measures on this machine; with one worker, in this process."""
    return InProcess() if workers <= 1 else worker_processes(workers)


def worker_processes(workers: int) -> Executor:
    """Measures in other processes of this machine: by dask where it is installed, else by a pool."""
    if find_spec("distributed") is None:
        return ProcessPool(workers)
    from benchmarks.core.dask_executor import DaskWorkers

    return DaskWorkers(workers=workers)


def make_executor(workers: int, scheduler: str = "") -> Executor:
    """Executor of the command line: this machine, or a dask scheduler such as ``tcp://10.0.0.1:8786``.

    Raises:
        PoiseError: A scheduler is named and dask is not installed.
    """
    if not scheduler:
        return local_executor(workers)
    if find_spec("distributed") is None:
        raise PoiseError(f"--scheduler {scheduler}: needs dask: pip install 'poise[bench]'")
    from benchmarks.core.dask_executor import DaskWorkers

    return DaskWorkers(scheduler=scheduler)
