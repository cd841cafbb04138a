"""The filter's kernels against finite differences of the definitions, and its algebra."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

from controllers.estimation.config import EstimatorConfig
from controllers.estimation.filter import InvariantFilter
from controllers.estimation.kernels_predict import (
    FOOT,
    GYRO_BIAS,
    SIZE,
    SOLE,
    add_process_noise,
    apply_transition,
    predict,
    retract,
)
from controllers.estimation.kernels_update import correct, foot_residual
from models.config import default_config
from models.constants import GRAVITY
from models.profile import ImuSensor

CONFIG = default_config(EstimatorConfig, "controllers", "estimator")
DT = 0.001
EXACT = np.zeros((2, 6, 6))
"""Noise of sole poses that are without."""
FOOT_PLUS = np.array([6, 7, 8, 0, 1, 2])
FOOT_MINUS = [np.array([9, 10, 11, 15, 16, 17]), np.array([12, 13, 14, 18, 19, 20])]


@dataclass
class State:
    """Arrays of the filter."""

    rotation: np.ndarray
    vectors: np.ndarray
    soles: np.ndarray
    biases: np.ndarray

    @classmethod
    def random(cls, rng: np.random.Generator) -> State:
        rotations = [np.ascontiguousarray(pin.exp3(rng.normal(size=3))) for _ in range(3)]
        return cls(rotations[0], rng.normal(size=(4, 3)), np.array(rotations[1:]), 0.1 * rng.normal(size=(2, 3)))

    def perturbed(self, error: np.ndarray) -> State:
        """``Exp(error) X``, biases plus error."""
        turn, jacobian = pin.exp3(error[:3]), pin.Jexp3(-error[:3])  # left Jacobian of phi = right one of -phi
        vectors = np.array([turn @ self.vectors[k] + jacobian @ error[3 + 3 * k : 6 + 3 * k] for k in range(4)])
        soles = np.array([pin.exp3(error[15 + 3 * k : 18 + 3 * k]) @ self.soles[k] for k in range(2)])
        return State(turn @ self.rotation, vectors, soles, self.biases + error[21:].reshape(2, 3))

    def error_from(self, true: State) -> np.ndarray:
        """First-order error of this estimate (27,)."""
        turn = self.rotation @ true.rotation.T
        parts = [pin.log3(turn)]
        parts += [self.vectors[k] - turn @ true.vectors[k] for k in range(4)]
        parts += [pin.log3(self.soles[k] @ true.soles[k].T) for k in range(2)]
        return np.concatenate([*parts, (self.biases - true.biases).ravel()])

    def propagated(self, rate: np.ndarray, force: np.ndarray, covariance: np.ndarray | None = None) -> State:
        """One step without noise of measured ``rate`` and ``force``."""
        result = State(self.rotation.copy(), self.vectors.copy(), self.soles.copy(), self.biases.copy())
        covariance = np.eye(SIZE) if covariance is None else covariance
        predict(
            result.rotation, result.vectors, result.soles, covariance, rate - self.biases[0], force - self.biases[1],
            DT, GRAVITY, np.zeros((2, 2)), np.zeros((2, 3)), np.zeros(4), EXACT,
        )  # fmt: skip
        return result


def positive_definite(rng: np.random.Generator, n: int = SIZE) -> np.ndarray:
    root = rng.normal(size=(n, n))
    return root @ root.T + 0.1 * np.eye(n)


def test_transition_is_the_derivative_of_the_prediction() -> None:
    rng = np.random.default_rng(0)
    true, rate, force = State.random(rng), rng.normal(size=3), 10.0 * rng.normal(size=3)
    after = true.propagated(rate, force)
    transition = np.zeros((SIZE, SIZE))
    step = 1e-5
    for j in range(SIZE):
        error = np.zeros(SIZE)
        error[j] = step
        forward = true.perturbed(error).propagated(rate, force).error_from(after)
        backward = true.perturbed(-error).propagated(rate, force).error_from(after)
        transition[:, j] = (forward - backward) / (2.0 * step)
    covariance = positive_definite(rng)
    expected = transition @ covariance @ transition.T
    true.propagated(rate, force, covariance)
    np.testing.assert_allclose(covariance, expected, atol=2e-6 * np.abs(expected).max())
    change = transition - np.eye(SIZE)  # of the order of the step, so the same bound must hold for the change itself
    applied = np.eye(SIZE)
    middle = true.rotation @ pin.exp3(0.5 * DT * (rate - true.biases[0]))
    vectors = true.vectors.copy()
    vectors[:2] = 0.5 * (true.vectors[:2] + after.vectors[:2])
    apply_transition(middle, vectors, DT, GRAVITY, applied)
    np.testing.assert_allclose(applied - np.eye(SIZE), change, atol=1e-8)


def test_prediction_integrates_a_turning_fall() -> None:
    """Against the closed form: constant rate, no specific force."""
    rng = np.random.default_rng(1)
    state = State.random(rng)
    state.biases[:] = 0.0
    rate = np.array([0.3, -0.7, 1.1])
    now = state
    for _ in range(500):
        now = now.propagated(rate, np.zeros(3))
    t, g = 0.5, np.array([0.0, 0.0, -GRAVITY])
    np.testing.assert_allclose(now.rotation, state.rotation @ pin.exp3(t * rate), atol=1e-12)
    np.testing.assert_allclose(now.vectors[0], state.vectors[0] + t * g, atol=1e-12)
    np.testing.assert_allclose(now.vectors[1], state.vectors[1] + t * state.vectors[0] + 0.5 * t * t * g, atol=1e-12)


@pytest.mark.parametrize("foot", [0, 1])
def test_measurement_matrix_is_the_derivative_of_the_residual(foot: int) -> None:
    rng = np.random.default_rng(2)
    true = State.random(rng)
    position = true.rotation.T @ (true.vectors[2 + foot] - true.vectors[1])
    orientation = true.rotation.T @ true.soles[foot]
    noise, residual, world_noise = positive_definite(rng, 6), np.zeros(6), np.zeros((6, 6))
    step, numeric = 1e-6, np.zeros((6, SIZE))
    for j in range(SIZE):
        for sign in (1.0, -1.0):
            error = np.zeros(SIZE)
            error[j] = sign * step
            state = true.perturbed(error)
            foot_residual(
                state.rotation, state.vectors, state.soles[foot], foot, position, orientation, noise, residual,
                world_noise,
            )  # fmt: skip
            numeric[:, j] += sign * residual / (2.0 * step)
    expected = np.zeros((6, SIZE))
    expected[np.arange(6), FOOT_PLUS] = 1.0
    expected[np.arange(6), FOOT_MINUS[foot]] = -1.0
    np.testing.assert_allclose(numeric, expected, atol=1e-8)
    turn = np.kron(np.eye(2), true.soles[foot])
    np.testing.assert_allclose(world_noise, turn @ noise @ turn.T, atol=1e-4)


def test_retraction_undoes_any_error() -> None:
    rng = np.random.default_rng(3)
    for scale in (1e-7, 1e-3, 1.0):
        true = State.random(rng)
        error = scale * rng.normal(size=SIZE)
        state = true.perturbed(error)
        retract(state.rotation, state.vectors, state.soles, state.biases, error)
        np.testing.assert_allclose(state.rotation, true.rotation, atol=1e-12)
        np.testing.assert_allclose(state.vectors, true.vectors, atol=1e-9)
        np.testing.assert_allclose(state.soles, true.soles, atol=1e-12)
        np.testing.assert_allclose(state.biases, true.biases, atol=1e-12)


def test_a_foot_turns_about_its_pivot() -> None:
    rng = np.random.default_rng(4)
    true = State.random(rng)
    cops = 0.1 * rng.normal(size=(2, 2))
    tip = np.array([2e-3, 3e-3])
    covariance = np.zeros((SIZE, SIZE))
    add_process_noise(
        true.vectors, true.soles, covariance, cops, np.column_stack([np.zeros((2, 2)), tip**2]), np.zeros(4), EXACT
    )
    expected = np.zeros((SIZE, SIZE))
    step = 1e-6
    for foot in range(2):
        for axis in range(3):
            turn = pin.exp3(step * np.eye(3)[axis])
            moved = State(true.rotation, true.vectors.copy(), true.soles.copy(), true.biases)
            pressure = true.vectors[2 + foot] + true.soles[foot] @ np.append(cops[foot], 0.0)
            moved.vectors[2 + foot] = pressure + turn @ (true.vectors[2 + foot] - pressure)
            moved.soles[foot] = turn @ true.soles[foot]
            column = true.error_from(moved) / step  # the estimate stays where the foot was
            expected += tip[foot] ** 2 * np.outer(column, column)
    np.testing.assert_allclose(covariance, expected, atol=1e-10)


def test_gyro_noise_enters_like_a_bias_over_one_step() -> None:
    rng = np.random.default_rng(5)
    true = State.random(rng)
    covariance = np.zeros((SIZE, SIZE))
    add_process_noise(
        true.vectors, true.soles, covariance, np.zeros((2, 2)), np.zeros((2, 3)), np.array([1.0, 0, 0, 0]), EXACT
    )
    transition, small = np.eye(SIZE), 1e-7
    apply_transition(true.rotation, true.vectors, small, GRAVITY, transition)
    column = transition[:GYRO_BIAS, GYRO_BIAS : GYRO_BIAS + 3] / small
    np.testing.assert_allclose(covariance[:GYRO_BIAS, :GYRO_BIAS], column @ column.T, atol=1e-4)


def test_update_is_the_kalman_update() -> None:
    rng = np.random.default_rng(6)
    prior, noise, residual = positive_definite(rng), positive_definite(rng, 6), rng.normal(size=6)
    matrix = np.zeros((6, SIZE))
    matrix[np.arange(6), FOOT_PLUS] = 1.0
    matrix[np.arange(6), FOOT_MINUS[1]] = -1.0
    innovation = matrix @ prior @ matrix.T + noise
    gain = prior @ matrix.T @ np.linalg.inv(innovation)
    covariance, error = prior.copy(), np.zeros(SIZE)
    squared = correct(covariance, FOOT_PLUS, FOOT_MINUS[1], residual, noise, 1e9, error)
    assert squared == pytest.approx(residual @ np.linalg.solve(innovation, residual))
    np.testing.assert_allclose(error, gain @ residual, atol=1e-10)
    np.testing.assert_allclose(covariance, prior - gain @ matrix @ prior, atol=1e-9)


def test_gate_weighs_an_outlier_down_and_leaves_the_rest() -> None:
    rng = np.random.default_rng(7)
    prior, noise, residual = np.eye(SIZE), 0.1 * np.eye(6), rng.normal(size=6)
    gate = 5.0

    def pull(scale: float, gate: float) -> float:
        error = np.zeros(SIZE)
        correct(prior.copy(), FOOT_PLUS, FOOT_MINUS[0], scale * residual, noise, gate, error)
        return float(np.linalg.norm(error))

    assert pull(0.5, gate) == pull(0.5, 1e9)
    assert pull(1e3, gate) < 0.1 * pull(1e3, 1e9)
    assert pull(1e4, gate) == pytest.approx(pull(1e3, gate), rel=0.1)  # the pull saturates, and does not vanish
    assert pull(1e3, gate) > pull(0.5, gate)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_unusable_innovation_changes_nothing(value: float) -> None:
    covariance = positive_definite(np.random.default_rng(8))
    before, error = covariance.copy(), np.zeros(SIZE)
    residual = np.zeros(6)
    residual[2] = value
    assert correct(covariance, FOOT_PLUS, FOOT_MINUS[0], residual, np.eye(6), 1e9, error) == -1.0
    np.testing.assert_array_equal(covariance, before)
    indefinite = -np.eye(SIZE)
    assert correct(indefinite, FOOT_PLUS, FOOT_MINUS[0], np.zeros(6), 0.1 * np.eye(6), 1e9, error) == -1.0


def test_yaw_and_position_are_the_unobservable_directions() -> None:
    """They stay what they are under any transition and are invisible to both soles, at every state."""
    rng = np.random.default_rng(9)
    directions = np.zeros((SIZE, 4))
    directions[[2, SOLE + 2, SOLE + 5], 0] = 1.0
    for axis in range(3):
        directions[[6 + axis, FOOT + axis, FOOT + 3 + axis], 1 + axis] = 1.0
    for _ in range(5):
        state = State.random(rng)
        moved = directions.copy()
        apply_transition(state.rotation, state.vectors, 0.05, GRAVITY, moved)
        np.testing.assert_allclose(moved, directions, atol=1e-15)
    for foot in range(2):
        np.testing.assert_array_equal(directions[FOOT_PLUS] - directions[FOOT_MINUS[foot]], 0.0)


def test_covariance_stays_positive_definite_through_swings_and_long_runs() -> None:
    rng = np.random.default_rng(10)
    filter_ = InvariantFilter(CONFIG)
    filter_.covariance[:] = 1e-4 * np.eye(SIZE)
    noise, residual, error = 1e-7 * np.eye(6), np.zeros(6), np.zeros(SIZE)
    quiet = [CONFIG.foot.slip, CONFIG.foot.flat]
    swing = [CONFIG.foot.swing, CONFIG.foot.swing_rotation]
    for k in range(20000):
        densities = np.array([quiet, swing] if (k // 300) % 2 else [swing, quiet])
        filter_.predict(
            rng.normal(size=3), 10.0 * rng.normal(size=3), DT, densities, 0.05 * rng.normal(size=(2, 2)), 1.0, EXACT
        )
        for foot in range(2):
            assert correct(filter_.covariance, FOOT_PLUS, FOOT_MINUS[foot], residual, noise, 1e9, error) >= 0.0
        filter_.vectors[:] = np.clip(filter_.vectors, -2.0, 2.0)
        if k % 500 == 0:
            np.testing.assert_array_equal(filter_.covariance, filter_.covariance.T)
            assert np.linalg.eigvalsh(filter_.covariance)[0] > 0.0
    np.testing.assert_allclose(filter_.rotation.T @ filter_.rotation, np.eye(3), atol=1e-14)


def test_level_floor_corrects_tilt_but_a_slope_is_left_alone() -> None:
    for tilt, corrected in ((0.01, True), (0.1, False)):
        filter_ = InvariantFilter(CONFIG)
        filter_.covariance[:] = np.diag(np.r_[np.full(3, 1e-4), np.full(12, 1e-6), np.zeros(6), np.full(6, 1e-6)])
        for block in (15, 18):  # soles turn with the base
            filter_.covariance[block : block + 3] = filter_.covariance[:3]
            filter_.covariance[:, block : block + 3] = filter_.covariance[:, :3]
        filter_.covariance += 1e-9 * np.eye(SIZE)
        turn = pin.exp3(np.array([0.0, tilt, 0.0]))
        filter_.rotation[:] = turn
        filter_.soles[:] = turn
        assert filter_.measure_level() == 0
        left = pin.log3(filter_.rotation)
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
    filter_.vectors[2:] = 0.0  # no lever for the noise of the gyro
    filter_.covariance[:] = 0.0
    advance(filter_, now)
    expected = np.array([level, level, np.hypot(height, FOOT_NOISE.pivot * now[1])])
    np.testing.assert_allclose(np.diag(filter_.covariance)[FOOT : FOOT + 6], np.tile(expected**2 * DT, 2), rtol=1e-9)


def advance(filter_: InvariantFilter, densities: tuple[float, float], noise: np.ndarray = EXACT) -> None:
    """One step at rest, both feet alike."""
    both = np.tile(densities, (2, 1))
    filter_.predict(np.zeros(3), np.array([0.0, 0.0, GRAVITY]), DT, both, np.zeros((2, 2)), 1.0, noise)


def test_error_of_the_encoders_wanders_while_the_robot_stands() -> None:
    """Twice its variance in the persistence, turned into W, position and orientation together."""
    rng, config = np.random.default_rng(13), CONFIG.kinematics
    noise = np.array([positive_definite(rng, 6) for _ in range(2)])
    with_, without = InvariantFilter(CONFIG), InvariantFilter(CONFIG)
    soles = [np.ascontiguousarray(pin.exp3(rng.normal(size=3))) for _ in range(2)]
    steps = 5
    for filter_, given in ((with_, noise), (without, EXACT)):
        filter_.soles[:] = soles
        filter_.covariance[:] = 0.0
        for _ in range(steps):
            advance(filter_, BEARS, given)
    expected = np.zeros((SIZE, SIZE))
    for foot in range(2):
        turn, rows = np.kron(np.eye(2), soles[foot]), FOOT_MINUS[foot]
        expected[np.ix_(rows, rows)] = 2.0 * steps * DT / config.persistence * turn @ noise[foot] @ turn.T
    np.testing.assert_allclose(with_.covariance - without.covariance, expected, atol=1e-9 * np.abs(expected).max())


def test_levelling_does_not_trust_a_sole_more_than_its_encoders_zeros() -> None:
    """Soles that disagree about the floor: each keeps its share of the tilt that it has against the other."""
    filter_, sole = InvariantFilter(CONFIG), CONFIG.initial.sole
    filter_.covariance[:] = 1e-12 * np.eye(SIZE)
    rows = [SOLE, SOLE + 1, SOLE + 3, SOLE + 4]
    filter_.covariance[rows, rows] = sole**2
    tilt = 0.5 * sole
    for foot, sign in ((0, 1.0), (1, -1.0)):
        filter_.soles[foot] = pin.exp3(np.array([sign * tilt, 0.0, 0.0]))
    assert filter_.measure_level() == 0
    for foot, sign in ((0, 1.0), (1, -1.0)):
        np.testing.assert_allclose(pin.log3(filter_.soles[foot]), [sign * 0.5 * tilt, 0.0, 0.0], atol=1e-3 * tilt)


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


def observability(rng: np.random.Generator, *, moving: bool, steps: int = 40) -> np.ndarray:
    """Rows ``H Phi_k ... Phi_1`` of both soles over several steps of 20 ms (12 steps, 27), all soles bearing."""
    state, dt = State.random(rng), 0.02
    state.vectors[0] *= moving
    rows = np.zeros((12, SIZE))
    for foot in range(2):
        rows[6 * foot + np.arange(6), FOOT_PLUS] = 1.0
        rows[6 * foot + np.arange(6), FOOT_MINUS[foot]] -= 1.0
    product, blocks = np.eye(SIZE), []
    for k in range(steps):
        blocks.append(rows @ product)
        apply_transition(state.rotation, state.vectors, dt, GRAVITY, product)
        if moving:
            rate = np.array([np.sin(0.7 * k), np.cos(0.4 * k), np.sin(0.3 * k + 1.0)]) * 2.0
            state.rotation = state.rotation @ pin.exp3(dt * rate)
            state.vectors[1] += dt * state.vectors[0]
            state.vectors[0] += dt * rng.normal(size=3)
    return np.vstack(blocks)


@pytest.mark.parametrize(("moving", "expected"), [(True, 4), (False, 6)])
def test_nothing_else_is_unobservable(moving: bool, expected: int) -> None:
    """Over many steps, biases included: yaw and position when the robot turns; tilt against accelerometer bias besides
    when it does not. A bias of the gyro, the velocity and the direction of gravity are always seen."""
    matrix = observability(np.random.default_rng(12), moving=moving)
    scale = np.linalg.norm(matrix, axis=0)
    assert (scale > 0.0).all()
    _, values, basis = np.linalg.svd(matrix)
    relative = values / values[0]
    assert (relative > 1e-7).sum() == SIZE - expected
    hidden = basis[SIZE - expected :]  # (expected, 27)
    known = np.zeros((4, SIZE))
    known[0, [2, SOLE + 2, SOLE + 5]] = 1.0
    for axis in range(3):
        known[1 + axis, [6 + axis, FOOT + axis, FOOT + 3 + axis]] = 1.0
    np.testing.assert_allclose(known - known @ hidden.T @ hidden, 0.0, atol=1e-6)
    assert np.abs(hidden[:, GYRO_BIAS : GYRO_BIAS + 3]).max() < 1e-6
    assert np.abs(hidden[:, 3:6]).max() < 1e-6
    if moving:
        assert np.abs(hidden[:, GYRO_BIAS + 3 :]).max() < 1e-6


def test_an_accelerometer_bias_does_not_leak_into_yaw() -> None:
    """A robot that stands: the bias becomes tilt and bias, and the yaw stays what it was to the last digits."""
    soles = SimpleNamespace(
        imu_rotation=np.eye(3),
        positions=np.array([[0.05, 0.1, -0.8], [0.05, -0.1, -0.8]]),
        rotations=np.tile(np.eye(3), (2, 1, 1)),
        covariances=np.tile(1e-7 * np.eye(6), (2, 1, 1)),
    )
    quiet = np.tile([CONFIG.foot.slip, CONFIG.foot.flat], (2, 1))
    for bias in ([0.1, 0.0, 0.0], [0.0, -0.1, 0.0], [0.07, 0.07, 0.1]):
        filter_ = InvariantFilter(CONFIG)
        filter_.initialise(soles, np.array([0.0, 0.0, GRAVITY]))
        yaw = filter_.covariance[2, 2]
        for _ in range(2000):
            filter_.predict(np.zeros(3), np.array([0.0, 0.0, GRAVITY]) + bias, DT, quiet, np.zeros((2, 2)), 1.0, EXACT)
            assert filter_.measure_soles(soles) == 0
            assert filter_.covariance[2, 2] >= yaw * (1.0 - 1e-9)
            yaw = filter_.covariance[2, 2]
        turn = pin.log3(filter_.rotation)
        assert np.linalg.norm(turn[:2]) > 1e-5 or np.abs(filter_.biases[1]).max() > 1e-4  # it did go somewhere
        assert abs(turn[2]) < 1e-6
