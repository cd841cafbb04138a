"""Measure cases in this process, in a pool of processes, or with dask on several machines."""

import gc
import os
import socket
import time
from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager
from dataclasses import dataclass
from importlib import import_module
from multiprocessing import get_context
from operator import attrgetter
from typing import Any

from benchmarks.core.provenance import difference, machine, source_state, versions
from models.errors import PoiseError, WorkersError
from models.nodes.realtime import die_with_parent
from models.numerics.threads import use_one_thread

Case = dict[str, Any]  #: Measured case: inputs (seed, direction, ...) and outcome, as plain JSON values


@dataclass(frozen=True, slots=True)
class Done:
    """Finished case: wall and processor time without child processes [s], load average after it, and environment."""

    outcome: Case
    seconds: float
    cpu_seconds: float
    load: float
    machine: str
    revision: str
    versions: dict[str, str]
    host: str


class Clock:
    """Measures wall and processor time of a case in this process, from construction."""

    def __init__(self) -> None:
        self._wall, self._cpu = time.monotonic(), time.process_time()

    def done(self, outcome: Case) -> Done:
        """Return the record of the case that has just finished."""
        seconds, cpu = time.monotonic() - self._wall, time.process_time() - self._cpu
        load = round(os.getloadavg()[0], 2)
        where = machine(), source_state(), versions(), socket.gethostname()
        return Done(outcome, round(seconds, 3), round(cpu, 3), load, *where)


def measured(measure: Callable[..., Case], case: Case) -> Done:
    """Measure one case in this process."""
    gc.collect()  # frees the loop of the last case, a reference cycle with some 10 MB of log
    clock = Clock()
    return clock.done(measure(**case))


def measured_elsewhere(module: str, name: str, case: Case, expected: tuple[str, dict[str, str]]) -> Done:
    """Measure one case, given module and function by name; ``WorkersError`` when revision or packages differ."""
    if why := difference((source_state(), versions()), expected):
        raise WorkersError(f"a worker on {socket.gethostname()} {why}")
    return measured(attrgetter(name)(import_module(module)), case)


class Executor(AbstractContextManager["Executor"]):
    """Measures cases; workers start with the first case and end with the context."""

    def __exit__(self, *_: object) -> None:
        self.stop_workers()

    @abstractmethod
    def run(self, measure: Callable[..., Case], cases: Sequence[Case]) -> Iterator[tuple[int, Done]]:
        """Measure every case once with a module-level function; yields index and outcome of each as it finishes."""

    def stop_workers(self) -> None:
        """Stop the workers and their helpers; the next cases start them again."""


DEATHS_ALLOWED = 3  #: Consecutive deaths of workers without a finished case after which the sweep ends


class InProcess(Executor):
    """Measures cases one after another in this process."""

    def run(self, measure: Callable[..., Case], cases: Sequence[Case]) -> Iterator[tuple[int, Done]]:
        for index, case in enumerate(cases):
            yield index, measured(measure, case)


class ProcessPool(Executor):
    """Processes on this machine; when one dies, all restart with the remaining cases."""

    def __init__(self, workers: int) -> None:
        self._workers = workers
        self._pool: ProcessPoolExecutor | None = None

    def stop_workers(self) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
            self._pool = None

    def _submit(self, measure: Callable[..., Case], left: Iterable[tuple[int, Case]]) -> dict[Future[Done], int]:
        if self._pool is None:
            use_one_thread()  # inherited by the workers
            self._pool = ProcessPoolExecutor(self._workers, get_context("spawn"), die_with_parent)
        return {self._pool.submit(measured, measure, case): index for index, case in left}

    def run(self, measure: Callable[..., Case], cases: Sequence[Case]) -> Iterator[tuple[int, Done]]:
        left, deaths = dict(enumerate(cases)), 0
        while left:
            before = len(left)
            try:
                futures = self._submit(measure, left.items())
            except BrokenProcessPool:  # a worker died earlier or just now
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
                self.stop_workers()
                deaths = 0 if len(left) < before else deaths + 1
                if deaths >= DEATHS_ALLOWED:
                    raise PoiseError(f"worker processes died {deaths} times in a row, {len(left)} cases are left")
