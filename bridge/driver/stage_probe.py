"""End time of each stage of a tick in the process of the laws, on the monotonic clock."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bridge.driver.latency_probe import CAPACITY

#: Stamp of the sensors; joints received; state estimated; gait planned; whole-body tick done; command sent [ns]
COLUMNS = ("stamp", "arrived", "estimated", "planned", "solved", "commanded")
STAMP, ARRIVED, ESTIMATED, PLANNED, SOLVED, COMMANDED = range(len(COLUMNS))

LEFT, RIGHT = 1, 2  #: Bits of ``contacts``


class StageProbe:
    """Stores one row per joint sample in preallocated arrays; nothing more when they are full.

    Attributes:
        table: Times by ``COLUMNS`` (n, 6) [ns]; 0 for stages that a tick did not reach.
        contacts: Feet in contact by the tick's reference (n,), as ``LEFT`` and ``RIGHT``.
    """

    def __init__(self, capacity: int = CAPACITY) -> None:
        self.table = np.zeros((capacity, len(COLUMNS)), dtype=np.int64)
        self.contacts = np.zeros(capacity, dtype=np.uint8)
        self._row = -1

    def begin(self) -> None:
        """Record the arrival of a joint sample from the middleware."""
        now = time.monotonic_ns()
        if self._row + 1 < len(self.table):
            self._row += 1
            self.table[self._row, ARRIVED] = now
        else:
            self._row = len(self.table)

    def state(self, stamp: int) -> None:
        """Record the end of the estimation of a stamp [ns]."""
        if 0 <= self._row < len(self.table):
            self.table[self._row, STAMP] = stamp
            self.table[self._row, ESTIMATED] = time.monotonic_ns()

    def note(self, column: int) -> None:
        """Record the end of a stage of the present tick; a later call for the same stage replaces it."""
        if 0 <= self._row < len(self.table):
            self.table[self._row, column] = time.monotonic_ns()

    def touch(self, contacts: tuple[bool, bool] | None) -> None:
        """Record the contacts of the present tick's reference."""
        if contacts is not None and 0 <= self._row < len(self.table):
            self.contacts[self._row] = LEFT * contacts[0] + RIGHT * contacts[1]

    def rows(self) -> dict[str, NDArray[np.int64] | NDArray[np.uint8]]:
        """``stages`` and ``contacts`` of the filled rows."""
        count = min(self._row + 1, len(self.table))
        return {"stages": self.table[:count], "contacts": self.contacts[:count]}

    def save(self, path: Path) -> None:
        """Write the rows as a NumPy archive."""
        np.savez(path, allow_pickle=False, **self.rows())


def cost(ticks: int = 20_000) -> float:
    """Time that the rows of one tick cost, measured in a loop [s]."""
    probe = StageProbe(ticks)
    begin = time.perf_counter()
    for stamp in range(ticks):
        probe.begin()
        probe.state(stamp)
        for column in (PLANNED, PLANNED, SOLVED, COMMANDED):
            probe.note(column)
        probe.touch((True, True))
    return (time.perf_counter() - begin) / ticks
