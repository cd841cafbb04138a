"""The IMU falls silent while the robot stands: a short drop-out is bridged, a long one damps."""

import math

import pytest

from bridge.closed_loop import ClosedLoop
from bridge.plants.fault_plan import Fault
from models.types import Mode


def _silence(loop: ClosedLoop, duration: float) -> None:
    """Let the IMU measure nothing for a time [s] from now."""
    loop.inject(Fault("imu", "wrong", value=math.nan, end=duration))


def test_drop_out_of_20_ms_is_bridged() -> None:
    loop = ClosedLoop(robot="g1", seed=3)
    loop.run(1.0)
    height = loop.truth.q[2]
    _silence(loop, 0.02)
    loop.run(1.5)
    assert loop.estimator.health.invalid_imu == 20
    assert loop.mode is Mode.STAND
    assert not loop.fallen
    assert loop.truth.q[2] == pytest.approx(height, abs=0.002)
    assert max(loop.foot_slip) < 0.001  # [m]


def test_drop_out_of_100_ms_damps_and_names_the_imu() -> None:
    loop = ClosedLoop(robot="g1", seed=3)
    loop.run(1.0)
    _silence(loop, 0.1)
    loop.run(0.1)
    assert loop.mode is Mode.DAMP
    reason = "; ".join(loop.faults)
    assert "IMU" in reason and "more than 0.050 s" in reason
