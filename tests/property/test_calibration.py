"""A calibration undoes what it describes, and survives its file."""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from models.calibration import Calibration, apply_calibration
from models.calibration_store import CalibrationStore
from models.robot_model import RobotModel
from models.types import SensorData

seeds = st.integers(0, 2**32 - 1)
scales = st.floats(1e-12, 1.0)


def draw(model: RobotModel, seed: int, scale: float) -> Calibration:
    rng = np.random.default_rng(seed)
    return Calibration(
        model.name,
        gyro_bias=scale * rng.uniform(-0.2, 0.2, 3),
        accel_bias=scale * rng.uniform(-1.0, 1.0, 3),
        encoder_offsets=scale * rng.uniform(-0.1, 0.1, model.nj),
        wrench_offsets=scale * rng.uniform(-10.0, 10.0, (2, 6)),
        force_gains=1.0 + scale * rng.uniform(-0.3, 0.3, 2),
    )


@given(seed=seeds, scale=scales)
@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_calibration_undoes_the_errors_it_describes(g1: RobotModel, seed: int, scale: float) -> None:
    rng, calibration = np.random.default_rng(seed), draw(g1, seed, scale)
    nj = g1.nj
    true = SensorData(
        1.0, rng.normal(size=nj), rng.normal(size=nj), rng.normal(size=nj), rng.normal(size=3), rng.normal(size=3),
        100.0 * rng.normal(size=(2, 6)),
    )  # fmt: skip
    wrenches = true.wrenches.copy()
    wrenches[:, 2] /= calibration.force_gains
    measured = SensorData(
        true.t, true.q + calibration.encoder_offsets, true.v, true.tau, true.gyro + calibration.gyro_bias,
        true.accel + calibration.accel_bias, wrenches + calibration.wrench_offsets,
    )  # fmt: skip
    before = measured.wrenches.copy()
    corrected = apply_calibration(measured, calibration)
    for name in ("q", "v", "tau", "gyro", "accel", "wrenches"):
        np.testing.assert_allclose(getattr(corrected, name), getattr(true, name), rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(measured.wrenches, before)


@given(seed=seeds, scale=scales)
@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_calibration_survives_its_file(g1: RobotModel, tmp_path: Path, seed: int, scale: float) -> None:
    store, calibration = CalibrationStore(g1, tmp_path), draw(g1, seed, scale)
    store.save(calibration, now=datetime(2030, 1, 1, tzinfo=UTC))
    loaded, refused = store.load()
    assert refused == ()
    for name in ("gyro_bias", "accel_bias", "encoder_offsets", "wrench_offsets", "force_gains"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(calibration, name))
