"""Sensor noise: what it depends on, and how large it is."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from bridge.sensors import SensorNoise
from models.errors import ConfigError
from models.robot_model import RobotModel
from models.types import SensorData

DT = 0.001


def channels(sample: SensorData) -> NDArray[np.float64]:
    return np.concatenate([sample.q, sample.v, sample.tau, sample.gyro, sample.accel, sample.wrenches.ravel()])


def run(noise: SensorNoise, n: int) -> NDArray[np.float64]:
    rows = np.empty((n, noise.size))
    for i in range(n):
        rows[i] = channels(noise.measure(i * DT, np.zeros(noise.size)))
        noise.advance()
    return rows


def test_same_seed_same_noise_and_reset_starts_over(g1: RobotModel) -> None:
    noise = SensorNoise(g1, period=DT, seed=4)
    first = run(noise, 20)
    np.testing.assert_array_equal(first, run(SensorNoise(g1, period=DT, seed=4), 20))
    noise.reset()
    np.testing.assert_array_equal(first, run(noise, 20))
    assert np.any(first != run(SensorNoise(g1, period=DT, seed=5), 20))
    noise.reset(5)
    assert np.any(first != run(noise, 20))


def test_noise_depends_only_on_seed_and_tick(g1: RobotModel) -> None:
    """Neither the motion nor reading more often changes the noise of a tick."""
    still, moving = (SensorNoise(g1, period=DT, seed=1) for _ in range(2))
    velocities = slice(g1.nj, 2 * g1.nj)
    rng = np.random.default_rng(0)
    for k in range(10):
        exact = rng.uniform(-1.0, 1.0, still.size)
        moving.measure(k * DT, exact.copy())
        a = channels(still.measure(k * DT, np.zeros(still.size)))[velocities]
        b = channels(moving.measure(k * DT, exact.copy()))[velocities] - exact[velocities]
        np.testing.assert_allclose(a, b, atol=1e-14)
        still.advance()
        moving.advance()


def test_zero_scale_is_exact(g1: RobotModel) -> None:
    noise = SensorNoise(g1, period=DT, seed=0, scale=0.0)
    exact = np.random.default_rng(0).standard_normal(noise.size)
    np.testing.assert_array_equal(channels(noise.measure(0.0, exact.copy())), exact)


@pytest.mark.parametrize("scale", [1.0, 3.0])
def test_size_of_the_noise(robot: RobotModel, scale: float) -> None:
    rows = run(SensorNoise(robot, period=DT, seed=0, scale=scale), 4000)
    imu, encoders, feet = (getattr(robot.profile.sensors, name) for name in ("imu", "encoders", "feet"))
    nj = robot.nj
    spread = rows.std(axis=0)
    assert not rows[:, :nj].any()
    np.testing.assert_allclose(spread[nj : 2 * nj], scale * encoders.velocity_noise, rtol=0.06)
    np.testing.assert_allclose(spread[2 * nj : 3 * nj], scale * encoders.torque_noise * robot.tau_max, rtol=0.06)
    at = 3 * nj
    np.testing.assert_allclose(spread[at : at + 3], scale * imu.gyro_noise_density / np.sqrt(DT), rtol=0.06)
    np.testing.assert_allclose(spread[at + 3 : at + 6], scale * imu.accel_noise_density / np.sqrt(DT), rtol=0.06)
    wrench = np.tile([feet.force_noise] * 3 + [feet.torque_noise] * 3, 2)
    np.testing.assert_allclose(spread[at + 6 :], scale * wrench, rtol=0.06)


def test_turn_on_biases_are_constant_and_drawn_per_seed(g1: RobotModel) -> None:
    at = 3 * g1.nj
    imu, feet = g1.profile.sensors.imu, g1.profile.sensors.feet
    sigma = np.array(
        [imu.gyro_bias] * 3 + [imu.accel_bias] * 3 + 2 * ([feet.force_offset] * 3 + [feet.torque_offset] * 3)
    )
    biases = np.array([run(SensorNoise(g1, period=DT, seed=s), 400)[:, at:].mean(axis=0) / sigma for s in range(60)])
    assert 0.7 < biases.std(axis=0).min() and biases.std(axis=0).max() < 1.35
    assert np.abs(biases.mean(axis=0)).max() < 0.5


def test_biases_of_the_imu_walk(g1: RobotModel) -> None:
    """After 4 s, over many seeds, the mean of the last 0.4 s has drifted by about walk sqrt(t)."""
    imu = g1.profile.sensors.imu
    fast = replace(imu, gyro_bias_walk=0.01, accel_bias_walk=0.1, gyro_noise_density=0.0, accel_noise_density=0.0)
    robot = copy(g1)
    robot.profile = replace(g1.profile, sensors=replace(g1.profile.sensors, imu=fast))
    at = slice(3 * g1.nj, 3 * g1.nj + 6)
    drifts = []
    for seed in range(40):
        rows = run(SensorNoise(robot, period=0.01, seed=seed), 401)[:, at]
        drifts.append(rows[400] - rows[0])
    np.testing.assert_allclose(np.std(drifts, axis=0), np.repeat([0.01, 0.1], 3) * np.sqrt(4.0), rtol=0.4)


def test_positions_are_rounded_to_the_encoder(g1: RobotModel) -> None:
    noise = SensorNoise(g1, period=DT, seed=0)
    exact = np.zeros(noise.size)
    exact[: g1.nj] = np.random.default_rng(0).uniform(-1.0, 1.0, g1.nj)
    step = g1.profile.sensors.encoders.resolution
    q = noise.measure(0.0, exact.copy()).q
    assert np.abs(q - exact[: g1.nj]).max() <= 0.5 * step + 1e-15
    np.testing.assert_allclose(q / step, np.rint(q / step), atol=1e-6)


def test_imu_saturates(g1: RobotModel) -> None:
    noise = SensorNoise(g1, period=DT, seed=0)
    exact = np.zeros(noise.size)
    exact[3 * g1.nj : 3 * g1.nj + 6] = [1e3, -1e3, 0.0, -1e4, 1e4, 0.0]
    sample = noise.measure(0.0, exact)
    imu = g1.profile.sensors.imu
    np.testing.assert_array_equal(sample.gyro[:2], [imu.gyro_range, -imu.gyro_range])
    np.testing.assert_array_equal(sample.accel[:2], [-imu.accel_range, imu.accel_range])


@pytest.mark.parametrize("scale", [-1.0, np.nan, np.inf])
def test_bad_scale_is_refused(g1: RobotModel, scale: float) -> None:
    with pytest.raises(ConfigError, match="sensor_noise"):
        SensorNoise(g1, period=DT, seed=0, scale=scale)


def test_negative_seed_is_refused(g1: RobotModel) -> None:
    with pytest.raises(ConfigError, match="seed"):
        SensorNoise(g1, period=DT, seed=-1)
