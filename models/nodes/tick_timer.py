"""How long the last ticks of a law took, in an array allocated beforehand."""

from __future__ import annotations

import time

import numpy as np

WINDOW = 4096
"""Ticks that are remembered: about four seconds at 1 kHz."""

MEDIAN, TAIL = "tick p50 [us]", "tick p99 [us]"
"""Keys of the diagnostics that carry the figures."""


class TickTimer:
    """Times a law; a context manager around each of its ticks."""

    def __init__(self) -> None:
        self._durations = np.zeros(WINDOW)  # [us]
        self._count = 0
        self._begin = 0

    def __enter__(self) -> None:
        self._begin = time.perf_counter_ns()

    def __exit__(self, *error: object) -> None:
        self._durations[self._count % WINDOW] = 1e-3 * (time.perf_counter_ns() - self._begin)
        self._count += 1

    @property
    def last(self) -> float:
        """Duration of the last tick [s]; 0 before the first."""
        return 1e-6 * float(self._durations[(self._count - 1) % WINDOW])

    def values(self) -> dict[str, str]:
        """Median and 99th percentile of the remembered ticks [us], for diagnostics; empty before the first tick."""
        if self._count == 0:
            return {}
        p50, p99 = np.percentile(self._durations[: min(self._count, WINDOW)], [50.0, 99.0])
        return {MEDIAN: f"{p50:.0f}", TAIL: f"{p99:.0f}"}
