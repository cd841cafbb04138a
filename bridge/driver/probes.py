"""Times of the stages of a tick on the monotonic clock, in the driver and in the control process."""

import time
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

SAMPLES_KEPT = 64  #: Newest samples for which an answer is matched
ANSWERS_KEPT = 5000  #: Newest latencies in the statistics of ``AnswerTimes``
CAPACITY = 600_000  #: Largest number of recorded ticks: ten minutes at 1 kHz; later ones are dropped

#: Values that the driver records per tick, and their types
LATENCIES = {
    "published": np.int64,  # Start of publishing the sensors [ns]; 0 if not published
    "sent": np.int64,  # Time at which the last sensor message was passed to the middleware [ns]; 0 if not recorded
    "arrived": np.int64,  # Delivery of the command with this tick's stamp by the middleware [ns]; 0 without one
    "received": np.int64,  # Time at which the drivers had accepted it [ns]; 0 if not accepted
    "late": np.float64,  # Delay after the deadline [s]
    "skipped": np.int64,  # Periods lost before the step
    "active": np.bool_,  # Whether the drivers executed commands
}


class LatencyProbe:
    """Stores one row per tick in preallocated arrays, named as in ``LATENCIES``."""

    def __init__(self) -> None:
        self._rows: dict[str, NDArray[Any]] = {name: np.zeros(CAPACITY, kind) for name, kind in LATENCIES.items()}
        self._count = self._arrival = 0

    def publish(self, tick: int, late: float, active: bool) -> None:
        """Record the start of publishing the sensors of a tick, ``late`` after its deadline [s]."""
        if tick < CAPACITY:
            self._rows["published"][tick] = time.monotonic_ns()
            self._rows["late"][tick] = late
            self._rows["active"][tick] = active
            self._count = tick + 1

    def send(self, tick: int) -> None:
        """Record that the sensors of a tick were passed to the middleware."""
        if tick < CAPACITY:
            self._rows["sent"][tick] = time.monotonic_ns()

    def arrive(self) -> None:
        """Record the arrival of a command, before it is decoded."""
        self._arrival = time.monotonic_ns()

    def receive(self, tick: int) -> None:
        """Record that the drivers accepted the first command for a tick."""
        if 0 <= tick < self._count and self._rows["received"][tick] == 0:
            self._rows["arrived"][tick] = self._arrival
            self._rows["received"][tick] = time.monotonic_ns()

    def skip(self, tick: int, ticks: int) -> None:
        """Record the periods lost before the step of a tick."""
        if tick < CAPACITY:
            self._rows["skipped"][tick] = ticks

    def save(self, path: Path) -> None:
        """Write the rows as a NumPy archive."""
        np.savez(path, allow_pickle=False, **self.rows())

    def rows(self) -> dict[str, NDArray[Any]]:
        """Filled part of each array, by name."""
        return {name: values[: self._count] for name, values in self._rows.items()}


#: Stamp of the sensors; joints received; state estimated; gait planned; whole-body tick done; command sent [ns]
COLUMNS = ("stamp", "arrived", "estimated", "planned", "solved", "commanded")
STAMP, ARRIVED, ESTIMATED, PLANNED, SOLVED, COMMANDED = range(len(COLUMNS))

LEFT, RIGHT = 1, 2  #: Bits of ``contacts``


class StageProbe:
    """Times by ``COLUMNS`` (n, 6) [ns], 0 where not reached, and ``contacts`` (n,); one preallocated row per sample."""

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
        """Record the end of the estimation for a stamp [ns]."""
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
        """Filled rows as ``stages`` and ``contacts``."""
        count = min(self._row + 1, len(self.table))
        return {"stages": self.table[:count], "contacts": self.contacts[:count]}

    def save(self, path: Path) -> None:
        """Write the rows as a NumPy archive."""
        np.savez(path, allow_pickle=False, **self.rows())


def cost(ticks: int = 20_000) -> float:
    """Duration of recording one tick, measured in a loop [s]."""
    probe = StageProbe(ticks)
    begin = time.perf_counter()
    for stamp in range(ticks):
        probe.begin()
        probe.state(stamp)
        for column in (PLANNED, PLANNED, SOLVED, COMMANDED):
            probe.note(column)
        probe.touch((True, True))
    return (time.perf_counter() - begin) / ticks


#: Diagnostics keys of ``AnswerTimes``: median, 99th percentile and maximum
ANSWER_VALUES = {name: f"sample to command {name} [ms]" for name in ("p50", "p99", "max")}


class AnswerTimes:
    """Latency of a real robot, from the arrival of a sample at the driver to sending the command computed from it."""

    def __init__(self) -> None:
        self._arrived: deque[tuple[int, float]] = deque(maxlen=SAMPLES_KEPT)
        self._times: deque[float] = deque(maxlen=ANSWERS_KEPT)
        self._answered = 0

    def arrive(self, stamp: int) -> None:
        """Record the arrival of a sample with a stamp [ns]."""
        self._arrived.append((stamp, time.monotonic()))

    def send(self, stamp: int) -> None:
        """Record that the command for the sample with a stamp [ns] was sent; repetitions are ignored."""
        if stamp <= self._answered:
            return
        self._answered = stamp
        arrived = next((at for each, at in self._arrived if each == stamp), None)
        if arrived is not None:
            self._times.append(time.monotonic() - arrived)

    @property
    def values(self) -> dict[str, str]:
        """Values of ``ANSWER_VALUES`` for the diagnostics; empty before the first command."""
        if not self._times:
            return {}
        figures = 1e3 * np.percentile(np.array(self._times), (50.0, 99.0, 100.0))
        return {key: f"{value:.1f}" for key, value in zip(ANSWER_VALUES.values(), figures, strict=True)}
