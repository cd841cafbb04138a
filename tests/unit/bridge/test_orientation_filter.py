"""Complementary filter of the IMU: what it finds out at rest, in motion, and what it refuses."""

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from bridge.closed_loop import ClosedLoop
from controllers.estimation.orientation_filter import OrientationFilter
from models.constants import GRAVITY
from models.errors import MessageError
from models.robot_model import RobotModel

DT = 0.001
UP = np.array([0.0, 0.0, GRAVITY])
BIAS = np.array([0.05, -0.04, 0.03])


def _angle(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.linalg.norm(pin.log3(a.T @ b)))


def _tilt(a: np.ndarray, b: np.ndarray) -> float:
    """Angle between the verticals."""
    return math.acos(min(float(a[2] @ b[2]), 1.0))


@pytest.mark.parametrize("rpy", [(0.3, -0.4, 0.5), (math.pi - 0.2, 0.1, -1.0), (0.0, 0.5 * math.pi - 0.01, 0.0)])
def test_it_starts_where_gravity_says(rpy: tuple[float, float, float]) -> None:
    rotation = pin.rpy.rpyToMatrix(*rpy)
    law = OrientationFilter()
    law.reset(BIAS, rotation.T @ UP, yaw=rpy[2])
    assert _angle(law.rotation, rotation) < 1e-9
    np.testing.assert_allclose(pin.Quaternion(law.quaternion).matrix(), rotation, atol=1e-12)
    np.testing.assert_array_equal(law.bias, BIAS)


def test_a_wrong_tilt_decays_at_kp() -> None:
    """Small, without bias terms: e obeys de/dt = -kp e."""
    config = replace(OrientationFilter().config, ki=0.0, rest_gyro=1e-9)
    law = OrientationFilter(config)
    law.reset(np.zeros(3), pin.rpy.rpyToMatrix(0.02, 0.0, 0.0).T @ UP)
    for _ in range(2000):
        law.step(np.zeros(3), UP, DT)
    assert _tilt(law.rotation, np.eye(3)) == pytest.approx(0.02 * math.exp(-2.0 * config.kp), rel=0.01)
    np.testing.assert_array_equal(law.bias, 0.0)


def test_a_bias_is_learnt_at_rest_about_every_axis() -> None:
    law = OrientationFilter()
    rng = np.random.default_rng(0)
    law.reset(np.zeros(3), UP)
    drift = 0.02 * BIAS / np.abs(BIAS).max()  # below rest_gyro
    for _ in range(8000):
        law.step(drift + rng.normal(scale=0.008, size=3), UP + rng.normal(scale=0.05, size=3), DT)
    assert law.resting
    assert np.abs(law.bias - drift).max() < 0.002
    yaw = math.atan2(law.rotation[1, 0], law.rotation[0, 0])
    for _ in range(5000):
        law.step(drift, UP, DT)
    assert abs(math.atan2(law.rotation[1, 0], law.rotation[0, 0]) - yaw) < 0.001  # 0.06 with the bias


@pytest.mark.long
def test_a_bias_of_roll_and_pitch_is_learnt_in_motion_from_gravity() -> None:
    """The unit rocks once a second: it never rests."""
    law = OrientationFilter()
    rotation, bias = np.eye(3), np.array([0.01, -0.01, 0.0])
    law.reset(np.zeros(3), UP)
    for k in range(60_000):
        rate = 2.0 * math.cos(2.0 * math.pi * DT * k) * np.array([0.8, 0.6, 0.0])
        law.step(rate + bias, rotation.T @ UP, DT)
        whole_period = k % 1000 == 999
        rotation = np.eye(3) if whole_period else rotation @ pin.exp3(rate * DT)
    assert not law.resting
    assert np.abs(law.bias[:2] - bias[:2]).max() < 0.001
    assert _tilt(law.rotation, rotation) < 0.003


def test_forces_far_from_gravity_do_not_tilt_it() -> None:
    law = OrientationFilter()
    law.reset(np.zeros(3), UP)
    for _ in range(1000):
        law.step(np.zeros(3), np.array([0.8 * GRAVITY, 0.0, GRAVITY]), DT)
    np.testing.assert_allclose(law.rotation, np.eye(3), atol=1e-12)
    law.step(np.zeros(3), np.zeros(3), DT)  # free fall: no direction at all
    assert np.isfinite(law.rotation).all()


def test_yaw_is_the_integral_of_the_rate() -> None:
    law = OrientationFilter()
    law.reset(np.zeros(3), UP)
    for _ in range(2000):
        law.step(np.array([0.0, 0.0, 0.5]), UP, DT)
    assert math.atan2(law.rotation[1, 0], law.rotation[0, 0]) == pytest.approx(1.0, abs=1e-6)


def test_no_bias_beyond_what_is_believed() -> None:
    law = OrientationFilter()
    law.reset(np.zeros(3), UP)
    for _ in range(10_000):
        law.step(np.array([3.0, 0.0, 0.0]), UP, DT)  # a gyro that is broken
        assert np.abs(law.bias).max() <= law.config.bias_max


@pytest.mark.parametrize(
    ("gyro", "accel", "culprit"),
    [
        ((0.0, 0.3, 0.0), (0.0, 0.0, GRAVITY), "turns at 0.3 rad/s"),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.5 * GRAVITY), "specific force is 0.5 g"),
        ((0.0, 0.0, math.nan), (0.0, 0.0, GRAVITY), "not at rest"),
    ],
)
def test_no_start_in_motion(gyro: tuple[float, ...], accel: tuple[float, ...], culprit: str) -> None:
    with pytest.raises(MessageError, match=culprit):
        OrientationFilter().reset(np.array(gyro), np.array(accel))


@pytest.mark.long
def test_tilt_of_a_robot_that_waves_and_squats(g1: RobotModel) -> None:
    """Noise, bias and vibration of the simulated unit; the truth is the plant's."""
    loop = ClosedLoop(g1, seed=3, record=False)
    law, worst = OrientationFilter(), 0.0
    frame = g1.frame_id("imu")
    first, data = loop.plant.read(), g1.data()
    law.reset(np.clip(first.gyro, -0.1, 0.1), GRAVITY * first.accel / np.linalg.norm(first.accel))

    def run(seconds: float) -> None:
        nonlocal worst
        for _ in range(round(seconds / DT)):
            loop.run(DT)
            sensors = loop.plant.read()
            law.step(sensors.gyro, sensors.accel, DT)
            pin.framesForwardKinematics(g1.pin, data, loop.truth.q)
            worst = max(worst, _tilt(law.rotation, data.oMf[frame].rotation))

    run(1.0)
    worst = 0.0
    for motion in ("wave", "squat"):
        loop.command(motion)
        run(2.5)
    assert worst < 0.015  # [rad]
