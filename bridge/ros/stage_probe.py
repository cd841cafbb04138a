"""When each stage of a tick ended in the process of the laws, on the monotonic clock."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bridge.ros.latency_probe import CAPACITY

COLUMNS = ("stamp", "arrived", "estimated", "planned", "solved", "commanded")
"""Of a row: stamp of the sensors; joints out of the middleware; state estimated; reference of the gait there;
whole-body tick done; command handed to the middleware. All [ns], each after the one before."""

STAMP, ARRIVED, ESTIMATED, PLANNED, SOLVED, COMMANDED = range(len(COLUMNS))

LEFT, RIGHT = 1, 2
"""Bits of ``contacts``."""


class StageProbe:
    """Keeps one row per joint sample in arrays allocated beforehand; when they are full, nothing more.

    Attributes:
        table: Times by ``COLUMNS`` (n, 6) [ns]; 0 where a tick did not come so far.
        contacts: Feet that the tick's reference has in contact (n,), as ``LEFT`` and ``RIGHT``.
    """

    def __init__(self, capacity: int = CAPACITY) -> None:
        self.table = np.zeros((capacity, len(COLUMNS)), dtype=np.int64)
        self.contacts = np.zeros(capacity, dtype=np.uint8)
        self._row = -1

    def begin(self) -> None:
        """Note that a joint sample has come out of the middleware."""
        now = time.monotonic_ns()
        if self._row + 1 < len(self.table):
            self._row += 1
            self.table[self._row, ARRIVED] = now
        else:
            self._row = len(self.table)

    def state(self, stamp: int) -> None:
        """Note that the state of a stamp [ns] has been estimated."""
        if 0 <= self._row < len(self.table):
            self.table[self._row, STAMP] = stamp
            self.table[self._row, ESTIMATED] = time.monotonic_ns()

    def note(self, column: int) -> None:
        """Note that a stage of the present tick has ended; a later word on the same stage counts."""
        if 0 <= self._row < len(self.table):
            self.table[self._row, column] = time.monotonic_ns()

    def touch(self, contacts: tuple[bool, bool] | None) -> None:
        """Note the contacts of the present tick's reference."""
        if contacts is not None and 0 <= self._row < len(self.table):
            self.contacts[self._row] = LEFT * contacts[0] + RIGHT * contacts[1]

    def rows(self) -> dict[str, NDArray[np.int64] | NDArray[np.uint8]]:
        """``stages`` and ``contacts``, as far as they were filled."""
        count = min(self._row + 1, len(self.table))
        return {"stages": self.table[:count], "contacts": self.contacts[:count]}

    def save(self, path: Path) -> None:
        """Write the rows as a NumPy archive."""
        np.savez(path, allow_pickle=False, **self.rows())


def cost(ticks: int = 20_000) -> float:
    """What the rows of one tick cost here, measured in a loop [s]."""
    probe = StageProbe(ticks)
    begin = time.perf_counter()
    for stamp in range(ticks):
        probe.begin()
        probe.state(stamp)
        for column in (PLANNED, PLANNED, SOLVED, COMMANDED):
            probe.note(column)
        probe.touch((True, True))
    return (time.perf_counter() - begin) / ticks
