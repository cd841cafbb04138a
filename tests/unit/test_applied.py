"""What the laws are told is noted at its tick, and read back bit for bit."""

from __future__ import annotations

import numpy as np
import pytest

from models.applied import Applied, TickNote
from models.calibration import Calibration
from models.errors import MessageError
from models.types import SensorData


def sample() -> SensorData:
    return SensorData(
        0.1 + 0.2, np.array([1 / 3, -0.0]), np.zeros(2), np.zeros(2), np.zeros(3), np.zeros(3), np.full((2, 6), np.nan)
    )


def test_a_tick_without_news_has_no_note() -> None:
    assert Applied().take(1) == ""


def test_before_and_after_the_estimate() -> None:
    applied = Applied()
    applied.note("stop_motion")
    applied.estimated()
    applied.note("reset")
    first = TickNote.read(applied.take(5_000_000))
    applied.note("stop")
    second = TickNote.read(applied.take(5_000_000, again=True))
    assert first == TickNote(5_000_000, 0, (("stop_motion",),), (("reset",),))
    assert second == TickNote(5_000_000, 1, (("stop",),), (), again=True)
    assert applied.take(6_000_000) == ""


def test_only_changes_and_all_of_them_anew_after_a_start() -> None:
    applied = Applied()
    for dt in (0.001, 0.001, 0.002, 0.002):
        applied.note_change("dt", dt)
    assert TickNote.read(applied.take(1)).before == (("dt", 0.001), ("dt", 0.002))
    applied.begin("g1", sample())
    applied.note_change("dt", 0.002)
    assert TickNote.read(applied.take(2)).value("dt") == 0.002


def test_a_start_is_read_back_to_the_last_bit() -> None:
    applied = Applied()
    calibration = Calibration("g1", np.full(3, 0.1), np.zeros(3), np.zeros(2), np.zeros((2, 6)), np.ones(2))
    applied.begin("g1", sample(), calibration=calibration, after=7)
    start = TickNote.read(applied.take(1)).value("start")
    assert (start["robot"], start["after"], start["steps"]) == ("g1", 7, False)
    assert start["sample"]["t"] == sample().t
    assert np.array(start["sample"]["q"]).tobytes() == sample().q.tobytes()
    assert np.isnan(start["sample"]["wrenches"]).all()
    assert start["calibration"]["gyro_bias"] == [0.1, 0.1, 0.1]


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"stamp": 1}', '{"stamp": 1, "number": 0, "before": 3, "after": []}']
)
def test_another_text_is_refused(text: str) -> None:
    with pytest.raises(MessageError, match="not a note"):
        TickNote.read(text)
