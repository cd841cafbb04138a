"""Cases measured by dask.distributed: a cluster of this machine, or the workers of a scheduler on any machines.

A worker that dies is started again by its nanny, and the scheduler gives its case to another: the case is independent,
so nothing is lost, and it is taken once, whoever measured it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from types import TracebackType

from distributed import Client, Future, LocalCluster, as_completed
from distributed.scheduler import KilledWorker

from benchmarks.executors import Case, Done, measured
from models.errors import PoiseError
from models.threads import use_one_thread

AHEAD = 4
"""Cases that are at the scheduler for each core there is, so that no worker waits for the next one."""

AT_LEAST = 64
"""Cases that are at the scheduler whatever it has: workers may come at any time."""

CONNECT_TIME = 10.0
"""Longest wait for the scheduler [s]."""


class DaskWorkers:
    """Workers of dask; those started here take one case at a time, with numerical libraries on one thread.

    Args:
        workers: How many are started on this machine, on its loopback interface.
        scheduler: Address of a scheduler that has workers already, instead.
    """

    def __init__(self, *, workers: int = 0, scheduler: str = "") -> None:
        self._workers, self._address = workers, scheduler
        self._cluster: LocalCluster | None = None
        self._client: Client | None = None

    def __enter__(self) -> DaskWorkers:
        return self

    def __exit__(self, kind: object, error: object, trace: TracebackType | None) -> None:
        self.rest()

    def rest(self) -> None:
        """See ``Executor``; the workers of a scheduler elsewhere stay there."""
        for part in (self._client, self._cluster):
            if part is not None:
                part.close()
        self._client = self._cluster = None

    def client(self) -> Client:
        """The connection, made by the first call.

        Raises:
            PoiseError: The scheduler does not answer.
        """
        if self._client is not None:
            return self._client
        use_one_thread()  # for the workers, which inherit it
        if not self._address:
            self._cluster = LocalCluster(
                n_workers=self._workers,
                threads_per_worker=1,
                memory_limit=None,
                dashboard_address=None,
                silence_logs=logging.CRITICAL,
            )
        try:
            self._client = Client(self._cluster or self._address, timeout=CONNECT_TIME)
        except OSError as error:
            raise PoiseError(f"--scheduler {self._address}: no answer: {error}") from error
        return self._client

    def run(self, measure: Callable[..., Case], cases: Sequence[Case]) -> Iterator[tuple[int, Done]]:
        """See ``Executor``.

        Raises:
            PoiseError: The scheduler does not answer, or a case has killed several workers.
        """
        client, indices = self.client(), {}
        left = iter(enumerate(cases))

        def submit(count: int) -> list[Future[Done]]:
            futures = []
            for index, case in islice(left, count):
                future = client.submit(measured, measure, case, pure=False)
                indices[future.key] = index
                futures.append(future)
            return futures

        ahead = max(AHEAD * sum(client.ncores().values()), AT_LEAST)
        finished = as_completed(submit(ahead), with_results=True)
        try:
            for future, outcome in finished:
                yield indices.pop(future.key), outcome
                finished.update(submit(1))
        except KilledWorker as error:
            raise PoiseError(f"a case has killed worker after worker: {error}") from error
        finally:
            client.cancel(list(finished.futures))
