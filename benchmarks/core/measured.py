"""One case, measured by any process: what comes back, and what measures many of them."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from importlib import import_module
from operator import attrgetter
from typing import Any, Protocol

from benchmarks.core.provenance import difference, machine, source_state, versions
from models.errors import WorkersError

Case = dict[str, Any]  # one measured case: its inputs (seed, direction, ...) and outcome, as plain JSON values


@dataclass(frozen=True, slots=True)
class Done:
    """One finished case from the process that measured it.

    ``seconds`` is wall time, ``cpu_seconds`` processor time without children [s], ``load`` the load average afterwards;
    ``machine`` and ``revision`` are those of ``provenance``; ``host`` is for messages only.
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
    """Measure one case on another machine; ``WorkersError`` when revision or packages differ from those ``asked`` for.

    The function is passed by module and name, because a scheduler that unpickles a function imports all its
    dependencies.
    """
    if why := difference((source_state(), versions()), asked):
        raise WorkersError(f"a worker on {socket.gethostname()} {why}")
    return measured(attrgetter(name)(import_module(module)), case)


class Executor(AbstractContextManager["Executor"], Protocol):
    """Measures cases; workers start with the first ones and end with the context."""

    def run(self, measure: Callable[..., Case], cases: Sequence[Case]) -> Iterator[tuple[int, Done]]:
        """Measure every case once; yields the index of each as soon as it is finished, in any order.

        ``measure`` is a function of a module, sent to other processes by name, and called with a case's entries.
        """
        ...

    def rest(self) -> None:
        """End the workers and their helpers until the next cases."""
        ...
