import time

import pytest

from models.nodes.realtime import MEDIAN, TAIL, WINDOW, TickTimer


def test_percentiles_of_the_last_ticks(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0]
    monkeypatch.setattr(time, "perf_counter_ns", lambda: now[0])
    timer = TickTimer()
    assert timer.values() == {}
    for tick in range(2 * WINDOW):
        with timer:
            now[0] += 500_000 if tick < WINDOW else (1_000_000 if tick % 50 == 0 else 100_000)
    assert timer.values() == {MEDIAN: "100", TAIL: "1000"}  # the slow ticks before the window are forgotten
