"""Foot sensors against leg torques and motion; slips; samples at full scale."""

import numpy as np
import pytest
from msgspec.structs import replace

from controllers.estimation.config import EstimatorConfig
from controllers.estimation.estimator import StateEstimator
from controllers.estimation.feet import (
    NOT_FINITE,
    UNKNOWN,
    FootSensorMonitor,
    FootSensorState,
    SlipMonitor,
    judge_sensors,
    watch_slips,
)
from controllers.estimation.samples import BAD_IMU, SATURATED_FEET, SATURATED_IMU, SensorBuffer
from models.config import default_config
from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.types import SensorData

DT, WEIGHT = 0.001, 300.0
CONFIG = default_config(EstimatorConfig, "controllers", "estimator")
LIMITS = CONFIG.foot_sensors
SOUND, ABSENT, CONTRADICTED = FootSensorState.SOUND, FootSensorState.ABSENT, FootSensorState.CONTRADICTED


class Feet:
    """A monitor, fed with loads as shares of the weight."""

    def __init__(self) -> None:
        self.monitor = FootSensorMonitor(LIMITS, WEIGHT, fitted=True)
        self._rng = np.random.default_rng(0)
        self.monitor.reset(np.zeros(2), self.wrenches(0.5, 0.5), self.wrenches(0.5, 0.5))

    def wrenches(self, left: float, right: float, noise: float = 0.0) -> np.ndarray:
        result = noise * self._rng.normal(size=(2, 6))
        result[:, 2] += np.array([left, right]) * WEIGHT
        return result

    def feel(
        self,
        read: tuple[float, float],
        torques: tuple[float, float],
        duration: float,
        *,
        total: float | None = None,
        expected: tuple[float, float] = (UNKNOWN, UNKNOWN),
        samples: tuple[float, float] = (0.0, 0.0),
        torques_good: bool = True,
        noise: float = 0.1,
    ) -> tuple[FootSensorState, FootSensorState]:
        for _ in range(round(duration / DT)):
            judge_sensors(
                np.array(samples),
                self.wrenches(*read, noise=noise),
                self.wrenches(*read),
                self.wrenches(*torques),
                WEIGHT * (sum(torques) if total is None else total),
                torques_good,
                np.array(expected),
                DT,
                self.monitor.memory,
            )
        return self.monitor.states

    @property
    def doubtful(self) -> bool:
        return bool(self.monitor.memory.doubt[0] > 0.0)


@pytest.mark.parametrize("lie", [0.5, 0.0, 2.0], ids=["on", "off", "saturated"])
def test_a_sensor_that_contradicts_torques_and_motion_is_out(lie: float) -> None:
    feet, truth = Feet(), (0.0, 1.0) if lie else (0.6, 0.4)
    read = (lie, truth[1])
    assert feet.feel(read, truth, 0.8 * LIMITS.fault_time) == (SOUND, SOUND)
    assert feet.doubtful
    assert feet.feel(read, truth, 0.4 * LIMITS.fault_time) == (CONTRADICTED, SOUND)
    assert feet.monitor.counts.tolist() == [1.0, 0.0]
    np.testing.assert_allclose(feet.monitor.used[:, 2], np.array(truth) * WEIGHT, atol=1.0)


def test_the_schedule_that_sides_with_the_torques_makes_it_quicker() -> None:
    time = 0.5 * (LIMITS.scheduled_time + LIMITS.fault_time)
    assert Feet().feel((0.5, 1.0), (0.0, 1.0), time, expected=(0.0, 1.0)) == (CONTRADICTED, SOUND)
    assert Feet().feel((0.5, 1.0), (0.0, 1.0), time, expected=(1.0, 1.0)) == (SOUND, SOUND)
    assert Feet().feel((0.0, 0.4), (0.6, 0.4), time, expected=(1.0, 1.0)) == (CONTRADICTED, SOUND)


def test_small_differences_count_only_where_one_says_no_contact() -> None:
    error = 0.5 * (LIMITS.contact_error + LIMITS.load_error)
    assert Feet().feel((0.0, 0.9), (error, 0.9), 0.2) == (CONTRADICTED, SOUND)
    assert Feet().feel((0.5, 0.5), (0.5 + error, 0.5 - error), 0.2) == (SOUND, SOUND)


def test_torques_that_do_not_fit_the_motion_prove_nothing() -> None:
    assert Feet().feel((0.5, 0.5), (0.0, 0.0), 1.0, total=1.0) == (SOUND, SOUND)
    assert Feet().feel((0.5, 0.5), (0.0, 1.0), 1.0, torques_good=False) == (SOUND, SOUND)


def test_an_absent_sensor_is_replaced_and_comes_back() -> None:
    feet = Feet()
    torques, missing = (0.45, 0.55), (NOT_FINITE, 0.0)
    assert feet.feel((0.5, 0.5), torques, 0.8 * LIMITS.fault_time, samples=missing) == (SOUND, SOUND)
    assert feet.feel((0.5, 0.5), torques, 0.4 * LIMITS.fault_time, samples=missing) == (ABSENT, SOUND)
    assert feet.monitor.used[0, 2] == pytest.approx(0.45 * WEIGHT)
    assert feet.feel((0.45, 0.55), torques, 0.8 * LIMITS.recover_time) == (ABSENT, SOUND)
    assert feet.feel((0.45, 0.55), torques, 0.4 * LIMITS.recover_time) == (SOUND, SOUND)
    assert not feet.doubtful or feet.feel((0.45, 0.55), torques, 2.0 * LIMITS.settle_time)
    assert not feet.doubtful


def test_a_fault_stays_while_readings_contradict_or_repeat_themselves() -> None:
    feet = Feet()
    assert feet.feel((0.5, 1.0), (0.0, 1.0), 0.1) == (CONTRADICTED, SOUND)
    assert feet.feel((0.5, 1.0), (0.0, 1.0), 2.0 * LIMITS.recover_time) == (CONTRADICTED, SOUND)
    # Stuck, and right by chance: the same to the last bit.
    assert feet.feel((0.5, 0.5), (0.5, 0.5), 2.0 * LIMITS.recover_time, noise=0.0) == (CONTRADICTED, SOUND)
    assert feet.feel((0.5, 0.5), (0.5, 0.5), 1.2 * LIMITS.recover_time) == (SOUND, SOUND)
    assert feet.monitor.counts.tolist() == [1.0, 0.0]


def test_a_slip_is_counted_once_raises_the_noise_and_ends() -> None:
    slip, monitor = CONFIG.slip, SlipMonitor(CONFIG.slip, CONFIG.gate)
    nominal = np.array([[CONFIG.foot.slip, CONFIG.foot.flat]] * 2)

    def feel(innovation: float, duration: float, stands: float = 1.0) -> np.ndarray:
        for _ in range(round(duration / DT)):
            densities = nominal.copy()
            watch_slips(np.array([innovation, 1.0]), np.array([stands, 1.0]), DT, densities, monitor.memory)
        return densities

    over = 1.1 * CONFIG.gate
    np.testing.assert_array_equal(feel(over, 0.8 * slip.time), nominal)
    np.testing.assert_array_equal(feel(1.0, DT), nominal)  # starts anew
    np.testing.assert_array_equal(feel(over, 0.8 * slip.time), nominal)
    raised = feel(over, 0.5 * slip.time)
    assert raised[0, 0] == slip.density
    np.testing.assert_array_equal(raised[1], nominal[1])
    assert feel(1.0, 0.8 * slip.recover_time)[0, 0] == slip.density
    np.testing.assert_array_equal(feel(1.0, 0.4 * slip.recover_time), nominal)
    assert monitor.counts.tolist() == [1.0, 0.0]
    np.testing.assert_array_equal(feel(over, 2.0 * slip.time, stands=0.0), nominal)  # in the air nothing slips
    assert monitor.counts.tolist() == [1.0, 0.0]


def sample(robot: RobotModel, t: float) -> SensorData:
    nj = robot.nj
    q = robot.posture("stand").copy()
    return SensorData(
        t, q, np.zeros(nj), np.zeros(nj), np.zeros(3), np.array([0.0, 0.0, GRAVITY]), np.zeros((2, 6))
    )  # fmt: skip


def test_samples_at_full_scale_are_recognised(g1: RobotModel) -> None:
    sensors = g1.profile.sensors
    buffer = SensorBuffer(g1.nj, sensors, LIMITS.saturation, 0.05)
    buffer.reset(sample(g1, 0.0))
    good = sample(g1, 0.001)
    cases = {
        "gyro": (np.array([0.0, -sensors.imu.gyro_range, 0.0]), SATURATED_IMU | BAD_IMU),
        "accel": (np.array([0.0, 0.0, sensors.imu.accel_range]), SATURATED_IMU),
    }
    for k, (name, (value, flag)) in enumerate(cases.items()):
        assert buffer.accept(replace(good, t=0.002 * (k + 1), **{name: value})) == flag
        assert buffer.accept(replace(good, t=0.002 * (k + 1) + 0.001, **{name: 0.99 * value})) == 0
    assert sensors.feet.force_range is not None and sensors.feet.torque_range is not None
    for k, (axis, scale) in enumerate(((2, sensors.feet.force_range), (4, -sensors.feet.torque_range))):
        wrenches = np.zeros((2, 6))
        wrenches[1, axis] = scale
        assert buffer.accept(replace(good, t=0.02 * (k + 1), wrenches=wrenches)) == SATURATED_FEET
        assert buffer.feet.tolist() == [0.0, 2.0]
        assert buffer.wrenches[1, axis] == scale


def test_one_absent_foot_leaves_the_other_its_readings(g1: RobotModel) -> None:
    buffer = SensorBuffer(g1.nj, g1.profile.sensors, LIMITS.saturation, 0.05)
    buffer.reset(sample(g1, 0.0))
    wrenches = np.full((2, 6), np.nan)
    wrenches[1] = 3.0
    buffer.accept(replace(sample(g1, 0.001), wrenches=wrenches))
    assert buffer.feet.tolist() == [NOT_FINITE, 0.0]
    np.testing.assert_array_equal(buffer.wrenches, [[0.0] * 6, [3.0] * 6])


def test_a_saturated_rate_is_not_taken_and_widens_the_tilt(g1: RobotModel) -> None:
    estimator = StateEstimator(g1)
    spread = []
    for rate in (0.9, 1.0):
        estimator.reset(sample(g1, 0.0))
        for k in range(1, 21):
            gyro = np.array([0.0, 0.0, rate * g1.profile.sensors.imu.gyro_range])
            state = estimator.step(replace(sample(g1, k * DT), gyro=gyro), DT)
        spread.append(estimator.filter.state.covariance[2, 2])
        assert estimator.health.saturated_imu == (20 if rate == 1.0 else 0)
        assert estimator.health.coasting == pytest.approx(20 * DT if rate == 1.0 else 0.0)
        turned = 2.0 * np.arccos(min(abs(state.q[6]), 1.0))
        assert (turned < 0.01) == (rate == 1.0)  # [rad]
    assert spread[1] > 1.01 * spread[0]
