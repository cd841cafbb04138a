"""Samples of several topics become one tick, whatever their order, age and stamps."""

import itertools

import numpy as np
import pytest

from controllers.estimation.assembler import SampleAssembler, mean_sample
from models.errors import MessageError
from models.types import SensorData

MS = 1_000_000
ZERO = np.zeros(3)
WRENCH = np.zeros(6)


def _assembler(*, strict: bool = False) -> SampleAssembler:
    return SampleAssembler(age_max_ns=5 * MS, gap_max_ns=50 * MS, strict=strict)


def _add(assembler: SampleAssembler, source: str, stamp: int) -> SensorData | None:
    value = float(stamp)
    if source == "joints":
        return assembler.add_joints(stamp, ZERO + value, ZERO, ZERO)
    if source == "imu":
        return assembler.add_imu(stamp, ZERO + value, ZERO)
    return assembler.add_foot(int(source), stamp, WRENCH + value)


@pytest.mark.parametrize("order", list(itertools.permutations(("joints", "imu", "0", "1"))))
def test_one_tick_for_each_complete_set(order: tuple[str, ...]) -> None:
    assembler = _assembler()
    for stamp in (MS, 2 * MS, 3 * MS):
        emitted = [_add(assembler, source, stamp) for source in order]
        assert [sample is not None for sample in emitted] == [False, False, False, True]
        sample = emitted[-1]
        assert sample is not None
        assert sample.t == pytest.approx(stamp * 1e-9)
        assert sample.q[0] == sample.gyro[0] == sample.wrenches[0, 0] == sample.wrenches[1, 0] == stamp
    assert assembler.incomplete == 0


def test_lost_inertial_sample_is_bridged_by_the_last_one() -> None:
    assembler = _assembler()
    for source in ("imu", "0", "1", "joints"):
        _add(assembler, source, MS)
    for stamp in (2 * MS, 3 * MS):
        for source in ("0", "1"):
            _add(assembler, source, stamp)
        sample = _add(assembler, "joints", stamp)
    assert sample is not None  # the second of two incomplete ticks is not waited for
    assert sample.gyro[0] == MS
    assert assembler.incomplete == 1
    assert assembler.mixed == {"imu": MS}  # a replay has to know
    for stamp in range(4 * MS, 9 * MS, MS):
        for source in ("0", "1", "joints"):
            _add(assembler, source, stamp)
    assert assembler.mixed == {"imu": None}  # too old to be used
    for stamp in (9 * MS, 10 * MS):
        for source in ("imu", "0", "1", "joints"):
            _add(assembler, source, stamp)
    assert assembler.mixed == {}


def test_strict_waits_for_the_complete_set() -> None:
    assembler = _assembler(strict=True)
    for stamp in (MS, 2 * MS, 3 * MS):
        assert _add(assembler, "joints", stamp) is None


@pytest.mark.parametrize("silent", ["imu", "0", "1"])
def test_values_of_a_silent_source_are_no_numbers(silent: str) -> None:
    assembler = _assembler()
    sources, sample = ("imu", "0", "1"), None
    for source in (*sources, "joints"):
        _add(assembler, source, MS)
    for stamp in range(2 * MS, 21 * MS, MS):
        for source in sources:
            if source != silent:
                _add(assembler, source, stamp)
        emitted = _add(assembler, "joints", stamp)
        sample = sample if emitted is None else emitted
    assert sample is not None
    assert sample.t == pytest.approx(0.020)
    assert (assembler.incomplete, assembler.silent, assembler.dropped) == (2, 14, 0)  # it is not waited for
    assert not assembler.whole
    values = {"imu": np.concatenate([sample.gyro, sample.accel]), "0": sample.wrenches[0], "1": sample.wrenches[1]}
    assert {source for source in sources if np.isnan(values[source]).all()} == {silent}
    assert all(np.isfinite(values[source]).all() for source in sources if source != silent)
    for source in (*sources, "joints"):
        sample = _add(assembler, source, 21 * MS)
    assert sample is not None
    assert assembler.whole
    assert np.isfinite(sample.wrenches).all()


def test_a_plant_that_waits_may_repeat_its_samples() -> None:
    assembler = SampleAssembler(age_max_ns=5 * MS, gap_max_ns=50 * MS, repeats=True)
    sources = ("imu", "0", "1", "joints")
    assert [_add(assembler, source, MS) is not None for source in sources] == [False, False, False, True]
    assert [_add(assembler, source, MS) for source in sources] == [None] * 4
    assert [_add(assembler, source, 2 * MS) is not None for source in sources] == [False, False, False, True]


@pytest.mark.parametrize("strict", [False, True])
def test_a_robot_without_foot_sensors_waits_for_none(strict: bool) -> None:
    assembler = SampleAssembler(age_max_ns=5 * MS, gap_max_ns=50 * MS, strict=strict, feet=False)
    assert _add(assembler, "joints", MS) is None
    sample = _add(assembler, "imu", MS)
    assert sample is not None
    assert np.isnan(sample.wrenches).all()
    assert np.isfinite(sample.gyro).all()
    assert assembler.whole
    assert assembler.silent == assembler.dropped == assembler.incomplete == 0


def test_nothing_before_every_source_has_spoken() -> None:
    assembler = _assembler()
    for stamp in range(MS, 10 * MS, MS):
        for source in ("0", "1"):
            _add(assembler, source, stamp)
        assert _add(assembler, "joints", stamp) is None
    assert assembler.dropped > 0


@pytest.mark.parametrize(
    ("stamp", "reason"), [(MS, "repeats"), (MS - 1, "is before"), (0, "is before"), (10**12, "jumps ahead")]
)
@pytest.mark.parametrize("source", ["joints", "imu", "0", "1"])
def test_stale_backward_and_leaping_stamps_are_refused(source: str, stamp: int, reason: str) -> None:
    assembler = _assembler()
    _add(assembler, source, MS)
    with pytest.raises(MessageError, match=reason):
        _add(assembler, source, stamp)
    _add(assembler, source, 2 * MS)  # the true source goes on undisturbed


def test_source_that_goes_on_after_a_gap_is_believed() -> None:
    assembler = _assembler()
    _add(assembler, "imu", MS)
    with pytest.raises(MessageError, match="jumps ahead"):
        _add(assembler, "imu", 500 * MS)
    _add(assembler, "imu", 501 * MS)


def test_mean_sample() -> None:
    samples = [SensorData(t, ZERO + t, ZERO, ZERO, ZERO, ZERO, np.full((2, 6), t)) for t in (1.0, 3.0)]
    mean = mean_sample(samples)
    assert mean.t == 3.0
    assert mean.q[0] == mean.wrenches[1, 5] == 2.0
