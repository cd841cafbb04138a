"""Run cases with dask.distributed, on the workers of a scheduler on any machines.

The nanny restarts a worker that dies, and the scheduler reassigns its case; each result is used once. The sweep ends
when the scheduler dies.
"""

# Annotations stay text: a worker must be able to load the sent function without the classes of this project.
from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterator, Sequence
from itertools import islice

from distributed import Client, Future, Security, as_completed
from distributed.core import rpc
from distributed.scheduler import KilledWorker

from benchmarks.core.executors import Case, Done, Executor
from benchmarks.core.provenance import source_state, versions
from models.errors import PoiseError, WorkersError

AHEAD = 4  # cases queued at the scheduler per core, so that no worker waits
AT_LEAST = 64  # minimum number of queued cases: workers may join at any time
CONNECT_TIME = 10.0  # maximum wait for the scheduler [s]
ALONE_TIME = 120.0  # maximum wait without any worker, at the start or later [s]
LOOK = 1.0  # period of the check for workers [s]
POLL = 0.02  # period of the check for finished cases [s]


async def _ask(address: str) -> None:
    async with rpc(address, connection_args=Security().get_connection_args("client")) as scheduler:
        await scheduler.identity(n_workers=0)


def _sent() -> Callable[..., Done]:
    """Return the function that is sent as code: a worker without poise can load it and report what is missing."""

    def measured_there(module: str, name: str, case: Case, asked: tuple[str, dict[str, str]]) -> Done:
        from benchmarks.core.executors import measured_elsewhere

        return measured_elsewhere(module, name, case, asked)

    return measured_there


class DaskWorkers(Executor):
    """Workers of a ``scheduler``; they keep running after the sweep."""

    def __init__(self, scheduler: str) -> None:
        self._address, self._name = scheduler, f"--scheduler {scheduler}"
        self._client: Client | None = None

    def stop_workers(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None

    def client(self) -> Client:
        """Return the connection, made by the first call; ``WorkersError`` when the scheduler does not answer."""
        if self._client is not None:
            return self._client
        try:  # `Client` waits without limit for a server that is not a scheduler
            asyncio.run(asyncio.wait_for(_ask(self._address), CONNECT_TIME))
            self._client = Client(self._address, timeout=CONNECT_TIME)
        except Exception as error:  # any server may answer, with any error
            why = str(error) or f"no answer within {CONNECT_TIME:g} s"
            raise WorkersError(f"{self._name}: no connection to a dask scheduler: {why}") from error
        return self._client

    def run(self, measure: Callable[..., Case], cases: Sequence[Case]) -> Iterator[tuple[int, Done]]:
        """See ``Executor``; ``WorkersError`` without usable workers, ``PoiseError`` when a case kills several."""
        if not cases:
            return
        client = self.client()
        indices: dict[Future[Done], int] = {}
        left, asked, sent = iter(enumerate(cases)), (source_state(), versions()), _sent()

        def submit(count: int) -> list[Future[Done]]:
            futures = []
            for index, case in islice(left, max(count, 0)):
                named = measure.__module__, measure.__qualname__
                future = client.submit(sent, *named, case, asked, pure=False)
                indices[future] = index
                futures.append(future)
            return futures

        look = seen = time.monotonic()
        try:
            finished = as_completed(submit(AT_LEAST), loop=client.loop, with_results=True, raise_errors=False)
            while indices:
                now = time.monotonic()
                if now >= look:
                    look, cores = now + LOOK, self._cores(client)
                    finished.update(submit(AHEAD * cores - len(indices)))
                    seen = now if cores else seen
                    self._refuse_to_wait(now - seen)
                if not finished.has_ready():
                    time.sleep(POLL)
                    continue
                future, done = next(finished)
                index = indices.pop(future)
                future.release()  # otherwise dask recomputes the case when the worker dies
                yield index, self._taken(done)
                finished.update(submit(1))
        finally:
            if client.status == "running":
                client.cancel(list(indices))

    def _cores(self, client: Client) -> int:
        try:
            if client.status == "running":
                return sum(client.ncores().values())
        except OSError as error:
            raise self._lost() from error
        raise self._lost()

    def _lost(self) -> WorkersError:
        kept = "finished cases are in the file of --results, or of the suite; the same command resumes from them"
        return WorkersError(f"{self._name}: the scheduler has ended or is unreachable; {kept}")

    def _refuse_to_wait(self, alone: float) -> None:
        if alone > ALONE_TIME:
            start = f"start workers: dask worker {self._address} --nworkers 2 --nthreads 1"
            raise WorkersError(f"{self._name}: no worker for {ALONE_TIME:.0f} s; {start}")

    def _taken(self, done: object) -> Done:
        """Return the outcome, or raise the error in (type, error, traceback) or the loss of the connection."""
        if isinstance(done, Done):
            return done
        if not isinstance(done, tuple):
            raise self._lost()
        error = done[1]
        if isinstance(error, KilledWorker):
            raise PoiseError(f"several workers ended while they ran the same case: {error}") from error
        if isinstance(error, ImportError) and "benchmarks" in str(error.name):
            raise WorkersError(
                f"{self._name}: a worker cannot import poise: {error}; start it in the environment of this command"
            ) from error
        raise error.with_traceback(done[2])
