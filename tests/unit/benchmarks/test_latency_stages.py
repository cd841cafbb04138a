"""The arithmetic of the latency benchmark: stages add up to the whole, what was not answered is missed."""

from typing import Any

import numpy as np
import pytest

from benchmarks.core.timed_run import spread
from benchmarks.speed.latency import STAGES, answered, split, tails
from bridge.driver.probes import (
    ANSWER_VALUES,
    COMMANDED,
    LEFT,
    PLANNED,
    RIGHT,
    SOLVED,
    AnswerTimes,
    LatencyProbe,
    StageProbe,
    cost,
)

MS, US = 1_000_000, 1_000
PARTS = np.array([100, 60, 90, 5, 80, 40, 70, 30])
"""What each stage takes in the made-up rows [us]."""


def rows(ticks: int = 20) -> tuple[dict[str, Any], dict[str, Any]]:
    """Both processes' rows of ticks of which every one is answered in time."""
    number = np.arange(ticks)
    begin = 5_000_000_000 + number * MS
    ends = begin[:, None] + np.cumsum(PARTS) * US  # (ticks, 8)
    bridge = {
        "published": begin,
        "sent": ends[:, 0].copy(),
        "arrived": ends[:, 6].copy(),
        "received": ends[:, 7].copy(),
        "late": np.zeros(ticks),
        "skipped": np.zeros(ticks, dtype=np.int64),
        "active": np.ones(ticks, dtype=bool),
    }
    laws = {
        "stages": np.column_stack((number * MS, ends[:, 1:6])),
        "contacts": np.where(number % 2 == 0, LEFT | RIGHT, LEFT).astype(np.uint8),
    }
    laws["stages"][0, 0] = 0  # the stamp of tick 0, which no graph has
    return bridge, laws


def test_stages_are_what_they_took_and_add_up() -> None:
    bridge, laws = rows()
    ticks = split(bridge, laws, 2, MS)
    assert len(ticks.total) == 17  # without the warm-up and the last
    np.testing.assert_allclose(ticks.stages, np.tile(PARTS, (17, 1)))
    np.testing.assert_allclose(ticks.stages.sum(axis=1), ticks.total)
    assert len(STAGES) == len(PARTS)
    assert ticks.contacts[0] == LEFT | RIGHT and ticks.contacts[1] == LEFT


def test_what_arrives_before_its_publication_returns_still_adds_up() -> None:
    bridge, laws = rows()
    bridge["sent"] += 90 * US  # 30 us after the arrival
    laws["stages"][:, COMMANDED] += 100 * US
    ticks = split(bridge, laws, 2, MS)
    assert (ticks.stages >= 0.0).all()
    np.testing.assert_allclose(ticks.stages.sum(axis=1), ticks.total)
    np.testing.assert_allclose(ticks.stages[:, 1], 0.0)
    np.testing.assert_allclose(ticks.stages[:, 6], 0.0)


def test_ticks_that_the_laws_did_not_finish_are_left_out() -> None:
    bridge, laws = rows()
    laws["stages"][7, COMMANDED] = 0
    laws["stages"] = np.delete(laws["stages"], 9, axis=0)  # its joints never came
    laws["contacts"] = np.delete(laws["contacts"], 9)
    ticks = split(bridge, laws, 2, MS)
    assert len(ticks.total) == 15
    np.testing.assert_allclose(ticks.stages, np.tile(PARTS, (15, 1)))


def test_unanswered_and_skipped_ticks_are_missed() -> None:
    bridge, _ = rows(22)
    bridge["received"][5] = 0
    bridge["skipped"][8] = 3
    ticks, late, missed = answered(bridge, 1)
    assert 5 not in ticks and len(ticks) == 19 and len(late) == 20
    assert missed == pytest.approx((1 + 3) / (20 + 3))


def test_at_a_lower_rate_a_skipped_period_of_the_plant_is_a_part_of_a_tick() -> None:
    bridge, _ = rows(101)
    bridge["active"][np.arange(101) % 5 != 0] = False  # 200 Hz
    bridge["skipped"][12] = 5  # between two samples
    ticks, _, missed = answered(bridge, 0)
    assert ticks.tolist() == list(range(0, 100, 5))
    assert missed == pytest.approx(1 / 21)


def test_a_robot_that_never_stood_has_missed_everything() -> None:
    bridge, _ = rows()
    bridge["active"][:] = False
    ticks, _, missed = answered(bridge, 0)
    assert len(ticks) == 0 and missed == 1.0
    assert all(np.isnan(value) for value in tails([spread(np.zeros(0))], "a_").values())


def test_percentiles_have_the_names_that_others_rely_on() -> None:
    found = tails([spread(np.arange(1001.0))], "")
    assert found == pytest.approx({"p50_us": 500.0, "p99_us": 990.0, "p999_us": 999.0, "max_us": 1000.0})


def test_a_probe_keeps_the_order_of_a_tick() -> None:
    probe = StageProbe(3)
    for stamp in (MS, 2 * MS, 3 * MS, 4 * MS):
        probe.begin()
        probe.state(stamp)
        for column in (PLANNED, SOLVED, COMMANDED):
            probe.note(column)
        probe.touch((True, False))
    found = probe.rows()
    assert found["stages"][:, 0].tolist() == [MS, 2 * MS, 3 * MS]  # full: the fourth is not kept
    assert (np.diff(found["stages"][:, 1:], axis=1) >= 0).all()
    assert found["contacts"].tolist() == [LEFT] * 3


def test_an_empty_probe_has_no_rows_and_notes_nothing_before_a_tick() -> None:
    probe = StageProbe(3)
    probe.note(SOLVED)
    probe.touch((True, True))
    assert len(probe.rows()["stages"]) == 0 and not probe.table.any()
    assert cost(100) > 0.0


def test_the_arrival_of_a_command_that_is_refused_is_no_arrival() -> None:
    probe = LatencyProbe()
    probe.publish(1, 0.0, True)
    probe.send(1)
    probe.arrive()
    assert not probe.rows()["arrived"].any()
    probe.receive(1)
    found = probe.rows()
    assert found["published"][1] <= found["sent"][1] <= found["arrived"][1] <= found["received"][1]


def test_answers_count_once_from_the_arrival_of_their_sample(monkeypatch: pytest.MonkeyPatch) -> None:
    now = iter([0.0, 0.002, 0.0045, 0.0065])
    monkeypatch.setattr("bridge.driver.probes.time.monotonic", lambda: next(now))
    times = AnswerTimes()
    assert times.values == {}
    times.arrive(1)
    times.arrive(2)
    times.send(1)  # after 4.5 ms
    times.send(1)  # repeated
    times.send(3)  # of a sample that it has not seen
    times.send(2)  # older than the last
    times.arrive(4)
    assert list(times.values) == list(ANSWER_VALUES.values())
    assert set(times.values.values()) == {"4.5"}
