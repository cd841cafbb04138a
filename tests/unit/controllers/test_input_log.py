"""Inputs of the control stack are recorded at their tick, and read back bit for bit."""

import numpy as np
import pytest

from controllers.input_log import InputLog, TickInputs
from models.calibration import Calibration
from models.errors import MessageError
from models.types import SensorData


def sample() -> SensorData:
    return SensorData(
        0.1 + 0.2, np.array([1 / 3, -0.0]), np.zeros(2), np.zeros(2), np.zeros(3), np.zeros(3), np.full((2, 6), np.nan)
    )


def test_a_tick_without_news_has_no_note() -> None:
    assert InputLog().take(1) == ""


def test_before_and_after_the_estimate() -> None:
    log = InputLog()
    log.note("stop_motion")
    log.estimated()
    log.note("reset")
    first = TickInputs.read(log.take(5_000_000))
    log.note("stop")
    second = TickInputs.read(log.take(5_000_000, again=True))
    assert first == TickInputs(5_000_000, 0, (("stop_motion",),), (("reset",),))
    assert second == TickInputs(5_000_000, 1, (("stop",),), (), again=True)
    assert log.take(6_000_000) == ""


def test_only_changes_and_all_of_them_anew_after_a_start() -> None:
    log = InputLog()
    for dt in (0.001, 0.001, 0.002, 0.002):
        log.note_change("dt", dt)
    assert TickInputs.read(log.take(1)).before == (("dt", 0.001), ("dt", 0.002))
    log.begin("g1", sample(), None)
    log.note_change("dt", 0.002)
    assert TickInputs.read(log.take(2)).value("dt") == 0.002


def test_a_start_is_read_back_to_the_last_bit() -> None:
    log = InputLog()
    calibration = Calibration("g1", np.full(3, 0.1), np.zeros(3), np.zeros(2), np.zeros((2, 6)), np.ones(2))
    log.begin("g1", sample(), calibration, after=7)
    start = TickInputs.read(log.take(1)).value("start")
    assert (start["robot"], start["after"], start["steps"]) == ("g1", 7, False)
    assert start["sample"]["t"] == sample().t
    assert np.array(start["sample"]["q"]).tobytes() == sample().q.tobytes()
    assert np.isnan(start["sample"]["wrenches"]).all()
    assert start["calibration"]["gyro_bias"] == [0.1, 0.1, 0.1]


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"stamp": 1}', '{"stamp": 1, "number": 0, "before": 3, "after": []}']
)
def test_another_text_is_refused(text: str) -> None:
    with pytest.raises(MessageError, match="not a record"):
        TickInputs.read(text)
