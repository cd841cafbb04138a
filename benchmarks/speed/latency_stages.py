"""Splits the way from sensors to command into stages, by the rows of both processes; pure arithmetic."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.core.timed_run import Spread, percentiles_of
from bridge.driver.probes import ARRIVED, COMMANDED, ESTIMATED, PLANNED, SOLVED, STAMP
from models.types import Matrix, Vector

STAGES = (
    "sensors",
    "sensor_transport",
    "estimator",
    "planner",
    "qp",
    "command",
    "command_transport",
    "driver",
)
"""Stages of a tick, one after the other without a gap:

sensors: reading, encoding and publishing them; sensor_transport: until the joints come out of the middleware in the
process of the laws; estimator: until the state is handed over, the wait for samples that were overtaken included;
planner: until the gait's reference is there (standing, the hand-over alone); qp: the rest of the law's tick; command:
encoding and publishing it; command_transport: until it comes out of the middleware in the bridge; driver: until the
drivers have taken it."""

MICRO = 1e-3  # nanoseconds to microseconds


@dataclass(frozen=True, slots=True)
class Ticks:
    """Ticks of a run that were recorded from end to end."""

    total: Vector  #: From just before the sensors are published until the drivers have the command (n,) [us]
    stages: Matrix  #: Parts of it by ``STAGES`` (n, 8) [us]
    contacts: NDArray[np.uint8]  #: Feet in contact (n,), bits of ``bridge/driver/probes.py``


def answered(rows: Mapping[str, NDArray[Any]], skip: int) -> tuple[NDArray[np.int64], Vector, float]:
    """Judge the rows of ``LatencyProbe`` after the first ``skip`` ticks.

    Returns:
        Answered ticks (n,), lateness of every tick (m,) [us], and the missed fraction: skipped periods and ticks
        without an answer.
    """
    active = np.flatnonzero(rows["active"])[skip:]
    active = active[:-1]  # the last tick's answer may have come after the end
    if len(active) == 0:
        return active, np.zeros(0), 1.0
    good = rows["received"][active] > 0
    # Sensors may be published every so many ticks only; a whole period of theirs is one that is missed.
    period = max(round(float(np.median(np.diff(active)))), 1) if len(active) > 1 else 1
    skipped = int(rows["skipped"][active[0] : active[-1] + 1].sum()) / period
    missed = (np.count_nonzero(~good) + skipped) / (len(active) + skipped)
    return active[good], rows["late"][active] * 1e6, float(missed)


def split(bridge: Mapping[str, NDArray[Any]], laws: Mapping[str, NDArray[Any]], skip: int, period_ns: int) -> Ticks:
    """Join the rows of ``LatencyProbe`` and ``StageProbe`` by the sensors' stamp; the tick is ``period_ns`` [ns].

    Where a message is received before the call that published it has returned, the overlap counts to the publishing.
    """
    ticks, _, _ = answered(bridge, skip)
    table = laws["stages"]
    whole = np.flatnonzero(table[:, STAMP : COMMANDED + 1].all(axis=1))
    of_tick = np.full(len(bridge["published"]), -1, dtype=np.int64)
    numbers = table[whole, STAMP] // period_ns
    inside = (numbers >= 0) & (numbers < len(of_tick))
    of_tick[numbers[inside]] = whole[inside]
    ticks = ticks[of_tick[ticks] >= 0]
    row = table[of_tick[ticks]]
    begin, end, came = (bridge[name][ticks] for name in ("published", "received", "arrived"))
    moments = np.column_stack(
        (
            begin,
            np.minimum(bridge["sent"][ticks], row[:, ARRIVED]),
            row[:, ARRIVED],
            row[:, ESTIMATED],
            row[:, PLANNED],
            row[:, SOLVED],
            np.minimum(row[:, COMMANDED], came),
            came,
            end,
        )
    )
    return Ticks((end - begin) * MICRO, np.diff(moments, axis=1) * MICRO, laws["contacts"][of_tick[ticks]])


def tails(spreads: Sequence[Spread], prefix: str) -> dict[str, float]:
    """Median, 99th and 99.9th percentile and largest of some times, as figures ``<prefix>p50_us`` and so on [us]."""
    percents = {"p50": 50.0, "p99": 99.0, "p999": 99.9, "max": 100.0}
    found = percentiles_of(spreads, list(percents.values()))
    return {f"{prefix}{label}_us": float(value) for label, value in zip(percents, found, strict=True)}
