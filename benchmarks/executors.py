"""Where cases are measured: in this process, in a pool of processes, or by dask on one machine or many."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from multiprocessing import get_context
from types import TracebackType
from typing import Any, Protocol

from benchmarks.provenance import difference, machine, source_state, versions
from models.errors import PoiseError, WorkersError
from models.nodes.realtime import die_with_parent
from models.threads import use_one_thread

Case = dict[str, Any]
"""One measured case: its inputs (seed, direction, ...) and what came out, as plain JSON values."""

DEATHS_ALLOWED = 3
"""How often in a row workers may die without any case having been finished, before the sweep ends."""


@dataclass(frozen=True, slots=True)
class Done:
    """One finished case, as the process that measured it tells.

    Attributes:
        outcome: What came out.
        seconds: How long it took [s].
        cpu_seconds: Processor time of the process meanwhile, that of its children left out [s].
        load: Load average of its machine afterwards [-].
        machine: Which kind that is, of ``provenance.machine``.
        revision: Of ``provenance.source_state`` there.
        versions: Of the packages there.
        host: Its name, for messages; no file holds it.
    """

    outcome: Case
    seconds: float
    cpu_seconds: float
    load: float
    machine: str
    revision: str
    versions: dict[str, str]
    host: str


class Clock:
    """Times a case of this process, from when it is made."""

    def __init__(self) -> None:
        self._wall, self._cpu = time.monotonic(), time.process_time()

    def done(self, outcome: Case) -> Done:
        """The case, just finished."""
        seconds, cpu = time.monotonic() - self._wall, time.process_time() - self._cpu
        load = round(os.getloadavg()[0], 2)
        where = machine(), source_state(), versions(), socket.gethostname()
        return Done(outcome, round(seconds, 3), round(cpu, 3), load, *where)


def measured(measure: Callable[..., Case], case: Case) -> Done:
    """Measure one case in this process."""
    clock = Clock()
    return clock.done(measure(**case))


def measured_elsewhere(module: str, name: str, case: Case, asked: tuple[str, dict[str, str]]) -> Done:
    """Measure one case for another machine, or refuse before anything is measured.

    Args:
        module: Where the function is; a name, because a scheduler that reads a function imports all that it needs.
        name: Of the function.
        case: What it is called with.
        asked: ``source_state`` and ``versions`` of the process that asks.

    Raises:
        WorkersError: Those here are others.
    """
    if told := difference((source_state(), versions()), asked):
        raise WorkersError(f"a worker on {socket.gethostname()} {told}")
    return measured(getattr(import_module(module), name), case)


class Executor(AbstractContextManager["Executor"], Protocol):
    """Measures cases; workers are started when the first ones are asked for and end with the context."""

    def run(self, measure: Callable[..., Case], cases: Sequence[Case]) -> Iterator[tuple[int, Done]]:
        """Measure every case once.

        Args:
            measure: Function of a module (it is sent to other processes by name); called with a case's entries.
            cases: Keyword arguments of each call.

        Yields:
            Index of a case, as soon as it is finished, in any order.
        """
        ...

    def rest(self) -> None:
        """End the workers, and what of this process looks after them, until the next cases are asked for."""
        ...


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
    """Processes of this machine; where one dies, all begin anew with the cases that are left.

    Args:
        workers: How many.
    """

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
        """See ``Executor``.

        Raises:
            PoiseError: Workers die again and again.
        """
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
    """Measures on this machine.

    Args:
        workers: How many processes; with 1 everything happens in this one.
    """
    return InProcess() if workers <= 1 else worker_processes(workers)


def worker_processes(workers: int) -> Executor:
    """Measures in other processes of this machine: by dask where it is installed, by a pool where not.

    Args:
        workers: How many.
    """
    if find_spec("distributed") is None:
        return ProcessPool(workers)
    from benchmarks.dask_executor import DaskWorkers

    return DaskWorkers(workers=workers)


def make_executor(workers: int, scheduler: str = "") -> Executor:
    """What the command line asks for.

    Args:
        workers: Processes of this machine, where no scheduler is named.
        scheduler: Address of a dask scheduler, such as ``tcp://10.0.0.1:8786``.

    Raises:
        PoiseError: A scheduler is named and dask is not installed.
    """
    if not scheduler:
        return local_executor(workers)
    if find_spec("distributed") is None:
        raise PoiseError(f"--scheduler {scheduler}: needs dask: pip install 'poise[bench]'")
    from benchmarks.dask_executor import DaskWorkers

    return DaskWorkers(scheduler=scheduler)
