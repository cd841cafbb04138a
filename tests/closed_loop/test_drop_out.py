"""The inertial unit falls silent while the robot stands: a short drop-out is bridged, a long one damps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bridge.closed_loop import ClosedLoop
from models.types import Mode, SensorData


def _silence(loop: ClosedLoop, monkeypatch: pytest.MonkeyPatch, duration: float) -> None:
    """Let the inertial unit measure nothing for a time [s] from now."""
    plant = loop._lockstep.plant
    read, end = plant.read, plant.t + duration

    def spoilt() -> SensorData:
        sensors = read()
        nothing = np.full(3, np.nan)
        return replace(sensors, gyro=nothing, accel=nothing) if plant.t < end - 1e-9 else sensors

    monkeypatch.setattr(plant, "read", spoilt)


def test_drop_out_of_20_ms_is_bridged(monkeypatch: pytest.MonkeyPatch) -> None:
    loop = ClosedLoop(robot="g1", seed=3)
    loop.run(1.0)
    height = loop.truth.q[2]
    _silence(loop, monkeypatch, 0.02)
    loop.run(1.5)
    assert loop.estimator.health.invalid_imu == 20
    assert loop.mode is Mode.STAND
    assert not loop.fallen
    assert loop.truth.q[2] == pytest.approx(height, abs=0.002)
    assert max(loop.foot_slip) < 0.001  # [m]


def test_drop_out_of_100_ms_damps_and_names_the_imu(monkeypatch: pytest.MonkeyPatch) -> None:
    loop = ClosedLoop(robot="g1", seed=3)
    loop.run(1.0)
    _silence(loop, monkeypatch, 0.1)
    loop.run(0.1)
    assert loop.mode is Mode.DAMP
    reason = "; ".join(loop._lockstep.supervisor.faults)
    assert "IMU" in reason and "more than 0.050 s" in reason
