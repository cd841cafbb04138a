"""Time from publishing a tick's sensors to receiving the command that answers them, on the monotonic clock."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

CAPACITY = 600_000
"""Ticks that are kept: ten minutes at 1 kHz; later ones are not recorded."""


class LatencyProbe:
    """Keeps one row per tick in arrays allocated beforehand.

    Attributes:
        published: When the sensors of each tick were about to be published (n,) [ns]; 0 where they were not.
        sent: When the last of them had been handed to the middleware (n,) [ns]; 0 where nobody noted it.
        arrived: When the command with that tick's stamp came out of the middleware (n,) [ns]; 0 where none did.
        received: When the drivers had taken it (n,) [ns]; 0 where they did not.
        late: How long after its deadline each tick began (n,) [s].
        skipped: Periods that were lost before the step of each tick (n,).
        active: Whether the drivers were executing commands (n,).
    """

    def __init__(self) -> None:
        self.published = np.zeros(CAPACITY, dtype=np.int64)
        self.sent = np.zeros(CAPACITY, dtype=np.int64)
        self.arrived = np.zeros(CAPACITY, dtype=np.int64)
        self.received = np.zeros(CAPACITY, dtype=np.int64)
        self.late = np.zeros(CAPACITY)
        self.skipped = np.zeros(CAPACITY, dtype=np.int64)
        self.active = np.zeros(CAPACITY, dtype=np.bool_)
        self._count = self._arrival = 0

    def publish(self, tick: int, late: float, active: bool) -> None:
        """Note that the sensors of a tick are about to be published, so late after its deadline [s]."""
        if tick < CAPACITY:
            self.published[tick] = time.monotonic_ns()
            self.late[tick] = late
            self.active[tick] = active
            self._count = tick + 1

    def send(self, tick: int) -> None:
        """Note that the sensors of a tick have been handed to the middleware."""
        if tick < CAPACITY:
            self.sent[tick] = time.monotonic_ns()

    def arrive(self) -> None:
        """Note that a command has come, before anybody looks into it."""
        self._arrival = time.monotonic_ns()

    def receive(self, tick: int) -> None:
        """Note that the drivers have taken the command for a tick; only the first one counts."""
        if 0 <= tick < self._count and self.received[tick] == 0:
            self.arrived[tick] = self._arrival
            self.received[tick] = time.monotonic_ns()

    def skip(self, tick: int, ticks: int) -> None:
        """Note that so many periods were lost before the step of a tick."""
        if tick < CAPACITY:
            self.skipped[tick] = ticks

    def save(self, path: Path) -> None:
        """Write the rows as a NumPy archive."""
        np.savez(path, allow_pickle=False, **self.rows())

    def rows(self) -> dict[str, NDArray[Any]]:
        """Every attribute by name, as far as it was filled."""
        names = ("published", "sent", "arrived", "received", "late", "skipped", "active")
        return {name: getattr(self, name)[: self._count] for name in names}
