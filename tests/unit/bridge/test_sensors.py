"""Sensor noise: what it depends on, and how large it is."""

from copy import copy
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from bridge.plants.sensors import SensorErrors, SensorNoise
from models.errors import ConfigError, JointNameError
from models.robot_model import RobotModel
from models.types import SensorData

DT = 0.001


def with_sensors(robot: RobotModel, **groups: dict[str, float]) -> RobotModel:
    """The robot with other figures in some groups of its sensors."""
    sensors = robot.profile.sensors
    changed = {name: replace(getattr(sensors, name), **values) for name, values in groups.items()}
    result = copy(robot)
    result.profile = replace(robot.profile, sensors=replace(sensors, **changed))
    return result


def plain(robot: RobotModel) -> RobotModel:
    """The robot without gains, rounding, encoder offsets and jitter: what its sensors say is x + bias + noise."""
    gains = ("misalignment", "gyro_scale", "accel_scale", "gyro_resolution", "accel_resolution")
    imu, feet = dict.fromkeys(gains, 0.0), dict.fromkeys(("gain", "crosstalk"), 0.0)
    feet |= dict.fromkeys(("force_resolution", "torque_resolution"), 0.0)
    return with_sensors(robot, imu=imu, feet=feet, encoders={"offset": 0.0}, latency={"jitter": 0.0})


def quiet(robot: RobotModel) -> RobotModel:
    """The plain robot without noise and biases either."""
    imu = dict.fromkeys(
        ("gyro_noise_density", "accel_noise_density", "gyro_bias", "accel_bias", "gyro_bias_walk", "accel_bias_walk"),
        0.0,
    )
    feet = dict.fromkeys(("force_noise", "torque_noise", "force_offset", "torque_offset"), 0.0)
    encoders = dict.fromkeys(("resolution", "velocity_noise", "torque_noise"), 0.0)
    return with_sensors(plain(robot), imu=imu, feet=feet, encoders=encoders)


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
    still, moving = (SensorNoise(plain(g1), period=DT, seed=1) for _ in range(2))
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
    rows = run(SensorNoise(plain(robot), period=DT, seed=0, scale=scale), 4000)
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
    fast = replace(
        plain(g1).profile.sensors.imu,
        gyro_bias_walk=0.01,
        accel_bias_walk=0.1,
        gyro_noise_density=0.0,
        accel_noise_density=0.0,
    )
    robot = copy(g1)
    robot.profile = replace(plain(g1).profile, sensors=replace(plain(g1).profile.sensors, imu=fast))
    at = slice(3 * g1.nj, 3 * g1.nj + 6)
    drifts = []
    for seed in range(40):
        rows = run(SensorNoise(robot, period=0.01, seed=seed), 401)[:, at]
        drifts.append(rows[400] - rows[0])
    np.testing.assert_allclose(np.std(drifts, axis=0), np.repeat([0.01, 0.1], 3) * np.sqrt(4.0), rtol=0.4)


def test_positions_are_rounded_to_the_encoder(g1: RobotModel) -> None:
    noise = SensorNoise(plain(g1), period=DT, seed=0)
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


def test_encoder_offsets_are_drawn_per_joint_and_seed(g1: RobotModel) -> None:
    robot = with_sensors(g1, encoders={"offset": 0.01, "resolution": 0.0})
    offsets = np.array([run(SensorNoise(robot, period=DT, seed=s), 1)[0, : g1.nj] for s in range(40)])
    np.testing.assert_allclose(offsets.std(), 0.01, rtol=0.1)
    assert len(np.unique(offsets)) == offsets.size
    noise = SensorNoise(robot, period=DT, seed=3)
    assert np.ptp(run(noise, 5)[:, : g1.nj], axis=0).max() == 0.0


def test_misalignment_turns_gyro_and_accelerometer_alike(g1: RobotModel) -> None:
    turn = np.array([0.02, -0.01, 0.03])
    noise = SensorNoise(g1, period=DT, seed=0, scale=0.0, errors=SensorErrors(misalignment=turn))
    exact = np.zeros(noise.size)
    at = 3 * g1.nj
    exact[at : at + 3], exact[at + 3 : at + 6] = [1.0, 2.0, 3.0], [4.0, 5.0, 6.0]
    sample = noise.measure(0.0, exact.copy())
    np.testing.assert_allclose(pin.exp3(turn) @ sample.gyro, [1.0, 2.0, 3.0], atol=1e-14)
    np.testing.assert_allclose(pin.exp3(turn) @ sample.accel, [4.0, 5.0, 6.0], atol=1e-14)


def test_spread_of_gains_misalignment_and_crosstalk(g1: RobotModel) -> None:
    drawn = np.array([SensorNoise(g1, period=DT, seed=s).gains for s in range(60)]) - np.eye(18)
    imu, feet = g1.profile.sensors.imu, g1.profile.sensors.feet
    off = [(0, 1), (0, 2), (1, 2), (3, 4), (3, 5), (4, 5)]
    np.testing.assert_allclose(np.std([drawn[:, i, j] for i, j in off]), imu.misalignment, rtol=0.15)
    np.testing.assert_allclose(drawn[:, range(3), range(3)].std(), imu.gyro_scale, rtol=0.15)
    np.testing.assert_allclose(drawn[:, range(3, 6), range(3, 6)].std(), imu.accel_scale, rtol=0.15)
    np.testing.assert_allclose(drawn[:, range(6, 18), range(6, 18)].std(), feet.gain, rtol=0.15)
    assert feet.force_range is not None and feet.torque_range is not None
    ratio = feet.torque_range / feet.force_range
    np.testing.assert_allclose(drawn[:, 6:9, 9:12].std(), feet.crosstalk / ratio, rtol=0.2)
    np.testing.assert_allclose(drawn[:, 9:12, 6:9].std(), feet.crosstalk * ratio, rtol=0.2)
    assert not drawn[:, :6, 6:].any() and not drawn[:, 6:12, 12:].any() and not drawn[:, :3, 3:6].any()


def test_inertial_unit_and_feet_are_rounded_and_saturate(g1: RobotModel) -> None:
    noise = SensorNoise(g1, period=DT, seed=0)
    imu, feet = g1.profile.sensors.imu, g1.profile.sensors.feet
    sample = noise.measure(0.0, np.random.default_rng(0).uniform(-5.0, 5.0, noise.size))
    for values, step in (
        (sample.gyro, imu.gyro_resolution),
        (sample.accel, imu.accel_resolution),
        (sample.wrenches[:, :3], feet.force_resolution),
        (sample.wrenches[:, 3:], feet.torque_resolution),
    ):
        assert step > 0.0
        np.testing.assert_allclose(values / step, np.rint(values / step), atol=1e-6)
    sample = noise.measure(0.0, np.full(noise.size, 1e6))
    assert (sample.wrenches[:, :3] == feet.force_range).all() and (sample.wrenches[:, 3:] == feet.torque_range).all()


def test_jitter_is_the_age_of_the_sample(g1: RobotModel) -> None:
    """A ramp reads up to jitter / tick too little, in one group as much as in another on average."""
    robot = with_sensors(quiet(g1), latency={"jitter": 0.5 * DT})
    noise = SensorNoise(robot, period=DT, seed=0)
    lag = []
    for k in range(2000):
        lag.append(k - channels(noise.measure(k * DT, np.full(noise.size, 1e-3 * k))) / 1e-3)
        noise.advance()
    ages = np.array(lag[1:])[:, [0, 3 * g1.nj, 3 * g1.nj + 6]]
    assert ages.min() >= -1e-9 and ages.max() <= 0.5 + 1e-9
    np.testing.assert_allclose(ages.mean(axis=0), 0.25, rtol=0.05)
    assert np.abs(np.corrcoef(ages.T) - np.eye(3)).max() < 0.1
    np.testing.assert_allclose(lag[0], 0.0, atol=1e-12)


def test_given_errors_add_to_the_drawn_ones(g1: RobotModel) -> None:
    name = g1.joint_names[4]
    errors = SensorErrors(
        gyro_bias=[0.1, 0.2, 0.3], accel_bias=0.5, encoder_offsets={name: 0.03}, force_offsets=[[1, 2, 3], [4, 5, 6]],
        torque_offsets=0.7, wrench_gains=0.1,
    )  # fmt: skip
    exact = SensorNoise(g1, period=DT, seed=0, scale=0.0, errors=errors)
    sample = exact.measure(0.0, np.ones(exact.size))
    np.testing.assert_allclose(sample.gyro, [1.1, 1.2, 1.3])
    np.testing.assert_allclose(sample.accel, 1.5)
    np.testing.assert_allclose(sample.q, np.where(np.arange(g1.nj) == 4, 1.03, 1.0))
    np.testing.assert_allclose(sample.wrenches[:, :3], 1.1 + np.array([[1, 2, 3], [4, 5, 6]]))
    np.testing.assert_allclose(sample.wrenches[:, 3:], 1.8)
    drawn = SensorNoise(g1, period=DT, seed=2).bias
    both = SensorNoise(g1, period=DT, seed=2, errors=errors).bias
    np.testing.assert_allclose((both - drawn)[3 * g1.nj :][:3], [0.1, 0.2, 0.3], atol=1e-12)


@pytest.mark.parametrize(
    ("errors", "match"),
    [
        (SensorErrors(gyro_bias=[1.0, 2.0]), "gyro_bias"),
        (SensorErrors(encoder_offsets=np.nan), "encoder_offsets"),
        (SensorErrors(force_offsets="much"), "force_offsets"),
        (SensorErrors(encoder_offsets={"tail": 0.1}), "tail"),
    ],
)
def test_bad_errors_are_refused_by_name(g1: RobotModel, errors: SensorErrors, match: str) -> None:
    with pytest.raises((ConfigError, JointNameError), match=match):
        SensorNoise(g1, period=DT, seed=0, errors=errors)
