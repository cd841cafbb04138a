"""The filter over time: how sure it stays, what it trusts, and what it cannot see."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from controllers.estimation.filter import InvariantFilter, propagate
from controllers.estimation.filter_kernels import FOOT, SIZE, SOLE, SolePoses, correct, correct_soles
from models.constants import GRAVITY
from models.profile import ImuSensor
from tests.filter_states import CONFIG, DT, EXACT, FOOT_MINUS, FOOT_PLUS, positive_definite


def test_covariance_stays_positive_definite_through_swings_and_long_runs() -> None:
    rng = np.random.default_rng(10)
    filter_ = InvariantFilter(CONFIG)
    filter_.state.covariance[:] = 1e-4 * np.eye(SIZE)
    noise, residual, error = 1e-7 * np.eye(6), np.zeros(6), np.zeros(SIZE)
    quiet = [CONFIG.foot.slip, CONFIG.foot.flat]
    swing = [CONFIG.foot.swing, CONFIG.foot.swing_rotation]
    for k in range(20000):
        densities = np.array([quiet, swing] if (k // 300) % 2 else [swing, quiet])
        rate, force, pivots = rng.normal(size=3), 10.0 * rng.normal(size=3), 0.05 * rng.normal(size=(2, 2))
        propagate(rate, force, DT, densities, pivots, 1.0, EXACT, filter_.memory)
        for foot in range(2):
            assert correct(filter_.state.covariance, FOOT_PLUS, FOOT_MINUS[foot], residual, noise, 1e9, error) >= 0.0
        filter_.state.vectors[:] = np.clip(filter_.state.vectors, -2.0, 2.0)
        if k % 500 == 0:
            np.testing.assert_array_equal(filter_.state.covariance, filter_.state.covariance.T)
            assert np.linalg.eigvalsh(filter_.state.covariance)[0] > 0.0
    np.testing.assert_allclose(filter_.state.rotation.T @ filter_.state.rotation, np.eye(3), atol=1e-14)


def test_level_floor_corrects_tilt_but_a_slope_is_left_alone() -> None:
    for tilt, corrected in ((0.01, True), (0.1, False)):
        filter_ = InvariantFilter(CONFIG)
        filter_.state.covariance[:] = np.diag(np.r_[np.full(3, 1e-4), np.full(12, 1e-6), np.zeros(6), np.full(6, 1e-6)])
        for block in (15, 18):  # soles turn with the base
            filter_.state.covariance[block : block + 3] = filter_.state.covariance[:3]
            filter_.state.covariance[:, block : block + 3] = filter_.state.covariance[:, :3]
        filter_.state.covariance[...] += 1e-9 * np.eye(SIZE)
        turn = pin.exp3(np.array([0.0, tilt, 0.0]))
        filter_.state.rotation[:] = turn
        filter_.state.soles[:] = turn
        assert filter_.measure_level() == 0
        left = pin.log3(filter_.state.rotation)
        if corrected:
            variance = 1e-4 / (1e-4 + CONFIG.initial.floor**2)
            np.testing.assert_allclose(left, [0.0, tilt * (1.0 - variance), 0.0], atol=0.02 * tilt)
        else:
            np.testing.assert_array_equal(left, pin.log3(turn))


FOOT_NOISE = CONFIG.foot
BEARS, SWINGS = (FOOT_NOISE.slip, FOOT_NOISE.flat), (FOOT_NOISE.swing, FOOT_NOISE.swing_rotation)
TIPS = (FOOT_NOISE.slip, FOOT_NOISE.tipping)
BRIEFLY, LONG = round(0.5 * FOOT_NOISE.settle_time / DT), round(FOOT_NOISE.settle_time / DT)


@pytest.mark.parametrize(
    ("past", "now", "level", "height"),
    [
        ([], BEARS, FOOT_NOISE.slip, FOOT_NOISE.sink),  # the give under the first load is in the initial height
        ([SWINGS] * 10, BEARS, FOOT_NOISE.slip, FOOT_NOISE.sink),
        ([BEARS], SWINGS, FOOT_NOISE.swing, FOOT_NOISE.swing),
        ([BEARS, SWINGS] + [BEARS] * BRIEFLY, BEARS, FOOT_NOISE.creep, FOOT_NOISE.settling),
        ([BEARS, SWINGS] + [BEARS] * LONG, BEARS, FOOT_NOISE.slip, FOOT_NOISE.sink),
        ([BEARS, TIPS] + [BEARS] * BRIEFLY, BEARS, FOOT_NOISE.creep, FOOT_NOISE.settling),
        ([BEARS, TIPS] + [BEARS] * LONG, BEARS, FOOT_NOISE.slip, FOOT_NOISE.sink),
    ],
)
def test_a_foot_wanders_less_the_longer_it_lies(
    past: list[tuple[float, float]], now: tuple[float, float], level: float, height: float
) -> None:
    filter_ = InvariantFilter(CONFIG)
    for densities in past:
        advance(filter_, densities)
    filter_.state.vectors[2:] = 0.0  # no lever for the noise of the gyro
    filter_.state.covariance[:] = 0.0
    advance(filter_, now)
    expected = np.array([level, level, np.hypot(height, FOOT_NOISE.pivot * now[1])])
    np.testing.assert_allclose(
        np.diag(filter_.state.covariance)[FOOT : FOOT + 6], np.tile(expected**2 * DT, 2), rtol=1e-9
    )


@pytest.mark.parametrize("bearing", [BEARS, TIPS])
def test_a_sole_that_bears_for_long_does_not_turn_about_the_vertical(bearing: tuple[float, float]) -> None:
    """Also one that tips, or whose flatness is unknown: the gyro's bias about the vertical is measured by it."""
    filter_ = InvariantFilter(CONFIG)

    def heading_noise(steps: int) -> float:
        for _ in range(steps):
            advance(filter_, bearing)
        filter_.state.covariance[:] = 0.0
        advance(filter_, bearing)
        return float(filter_.state.covariance[SOLE + 2, SOLE + 2])

    long = round(FOOT_NOISE.turn_time / DT) + 1
    assert heading_noise(10) == pytest.approx(bearing[1] ** 2 * DT)
    assert heading_noise(long) == pytest.approx(FOOT_NOISE.turn**2 * DT)
    assert filter_.state.covariance[SOLE, SOLE] == pytest.approx(bearing[1] ** 2 * DT)
    advance(filter_, SWINGS)
    assert heading_noise(10) == pytest.approx(bearing[1] ** 2 * DT)


def advance(filter_: InvariantFilter, densities: tuple[float, float], noise: np.ndarray = EXACT) -> None:
    """One step at rest, both feet alike."""
    both = np.tile(densities, (2, 1))
    propagate(np.zeros(3), np.array([0.0, 0.0, GRAVITY]), DT, both, np.zeros((2, 2)), 1.0, noise, filter_.memory)


def test_error_of_the_encoders_wanders_while_the_robot_stands() -> None:
    """Twice its variance in the persistence, turned into W, position and orientation together."""
    rng, config = np.random.default_rng(13), CONFIG.kinematics
    noise = np.array([positive_definite(rng, 6) for _ in range(2)])
    with_, without = InvariantFilter(CONFIG), InvariantFilter(CONFIG)
    soles = [np.ascontiguousarray(pin.exp3(rng.normal(size=3))) for _ in range(2)]
    steps = 5
    for filter_, given in ((with_, noise), (without, EXACT)):
        filter_.state.soles[:] = soles
        filter_.state.covariance[:] = 0.0
        for _ in range(steps):
            advance(filter_, BEARS, given)
    expected = np.zeros((SIZE, SIZE))
    for foot in range(2):
        turn, rows = np.kron(np.eye(2), soles[foot]), FOOT_MINUS[foot]
        expected[np.ix_(rows, rows)] = 2.0 * steps * DT / config.persistence * turn @ noise[foot] @ turn.T
    np.testing.assert_allclose(
        with_.state.covariance - without.state.covariance, expected, atol=1e-9 * np.abs(expected).max()
    )


def test_levelling_does_not_trust_a_sole_more_than_its_encoders_zeros() -> None:
    """Soles that disagree about the floor: each keeps its share of the tilt that it has against the other."""
    filter_, sole = InvariantFilter(CONFIG), CONFIG.initial.sole
    filter_.state.covariance[:] = 1e-12 * np.eye(SIZE)
    rows = [SOLE, SOLE + 1, SOLE + 3, SOLE + 4]
    filter_.state.covariance[rows, rows] = sole**2
    tilt = 0.5 * sole
    for foot, sign in ((0, 1.0), (1, -1.0)):
        filter_.state.soles[foot] = pin.exp3(np.array([sign * tilt, 0.0, 0.0]))
    assert filter_.measure_level() == 0
    for foot, sign in ((0, 1.0), (1, -1.0)):
        np.testing.assert_allclose(pin.log3(filter_.state.soles[foot]), [sign * 0.5 * tilt, 0.0, 0.0], atol=1e-3 * tilt)


def test_data_sheet_adds_to_the_inertial_noise_as_variances() -> None:
    sensor = ImuSensor(
        gyro_noise_density=3.0, gyro_bias=4.0, accel_noise_density=5.0, accel_bias=6.0, gyro_range=1.0, accel_range=1.0,
        gyro_bias_walk=7.0, accel_bias_walk=8.0, misalignment=0.3, gyro_scale=9.0, accel_scale=0.4,
    )  # fmt: skip
    own = replace(CONFIG.imu, gyro_noise=4.0, accel_noise=12.0, gyro_bias=3.0, accel_bias=1.0)
    total = own.with_sensor(sensor, 10.0)
    assert total.gyro_noise == pytest.approx(5.0)
    assert total.accel_noise == pytest.approx(13.0)
    assert total.gyro_bias == pytest.approx(5.0)
    assert total.accel_bias == pytest.approx(np.sqrt(1.0 + 36.0 + 25.0))
    assert total.gyro_bias_walk == pytest.approx(np.hypot(7.0, own.gyro_bias_walk))
    assert total.accel_bias_walk == pytest.approx(np.hypot(8.0, own.accel_bias_walk))
    assert total.coast_factor == own.coast_factor


def test_an_accelerometer_bias_does_not_leak_into_yaw() -> None:
    """A robot that stands: the bias becomes tilt and bias, and the yaw stays what it was to the last digits."""
    soles = SolePoses(
        positions=np.array([[0.05, 0.1, -0.8], [0.05, -0.1, -0.8]]),
        rotations=np.tile(np.eye(3), (2, 1, 1)),
        covariances=np.tile(1e-7 * np.eye(6), (2, 1, 1)),
    )
    quiet = np.tile([CONFIG.foot.slip, CONFIG.foot.flat], (2, 1))
    for bias in ([0.1, 0.0, 0.0], [0.0, -0.1, 0.0], [0.07, 0.07, 0.1]):
        filter_ = InvariantFilter(CONFIG)
        filter_.initialise(soles, np.eye(3), np.array([0.0, 0.0, GRAVITY]))
        yaw = filter_.state.covariance[2, 2]
        for _ in range(2000):
            force, memory = np.array([0.0, 0.0, GRAVITY]) + bias, filter_.memory
            propagate(np.zeros(3), force, DT, quiet, np.zeros((2, 2)), 1.0, EXACT, memory)
            assert correct_soles(memory.state, soles, memory.gate, memory.error) == 0
            assert filter_.state.covariance[2, 2] >= yaw * (1.0 - 1e-9)
            yaw = filter_.state.covariance[2, 2]
        turn = pin.log3(filter_.state.rotation)
        assert np.linalg.norm(turn[:2]) > 1e-5 or np.abs(filter_.state.biases[1]).max() > 1e-4  # it did go somewhere
        assert abs(turn[2]) < 1e-6
