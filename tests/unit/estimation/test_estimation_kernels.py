"""The filter's kernels against finite differences of the definitions, and its algebra."""

import numpy as np
import pinocchio as pin
import pytest

from controllers.estimation.filter_kernels import (
    FOOT,
    GYRO_BIAS,
    SIZE,
    SOLE,
    FilterState,
    SolePoses,
    add_process_noise,
    apply_transition,
    correct,
    foot_residual,
    retract,
)
from models.constants import GRAVITY
from tests.filter_states import DT, FOOT_MINUS, FOOT_PLUS, NOISELESS, State, positive_definite


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
    seen = SolePoses(np.tile(orientation, (2, 1, 1)), np.tile(position, (2, 1)), np.tile(noise, (2, 1, 1)))
    step, numeric = 1e-6, np.zeros((6, SIZE))
    for j in range(SIZE):
        for sign in (1.0, -1.0):
            error = np.zeros(SIZE)
            error[j] = sign * step
            state = true.perturbed(error)
            foot_residual(FilterState(*state), foot, seen, residual, world_noise)
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
        retract(FilterState(*state), error)
        np.testing.assert_allclose(state.rotation, true.rotation, atol=1e-12)
        np.testing.assert_allclose(state.vectors, true.vectors, atol=1e-9)
        np.testing.assert_allclose(state.soles, true.soles, atol=1e-12)
        np.testing.assert_allclose(state.biases, true.biases, atol=1e-12)


def test_a_foot_turns_about_its_pivot() -> None:
    rng = np.random.default_rng(4)
    true = State.random(rng)
    cops = 0.1 * rng.normal(size=(2, 2))
    tilt, heading = np.array([2e-3, 3e-3]), np.array([1e-3, 4e-3])
    covariance = np.zeros((SIZE, SIZE))
    feet = np.column_stack([np.zeros((2, 2)), tilt**2, heading**2])
    add_process_noise(true.vectors, true.soles, covariance, NOISELESS._replace(pivots=cops, feet=feet))
    expected = np.zeros((SIZE, SIZE))
    step = 1e-6
    for foot in range(2):
        for axis in range(3):
            turn = pin.exp3(step * np.eye(3)[axis])
            moved = State(*true.copy())
            pressure = true.vectors[2 + foot] + true.soles[foot] @ np.append(cops[foot], 0.0)
            moved.vectors[2 + foot] = pressure + turn @ (true.vectors[2 + foot] - pressure)
            moved.soles[foot] = turn @ true.soles[foot]
            column = true.error_from(moved) / step  # the estimate stays where the foot was
            expected += (heading if axis == 2 else tilt)[foot] ** 2 * np.outer(column, column)
    np.testing.assert_allclose(covariance, expected, atol=1e-10)


def test_gyro_noise_enters_like_a_bias_over_one_step() -> None:
    rng = np.random.default_rng(5)
    true = State.random(rng)
    covariance = np.zeros((SIZE, SIZE))
    add_process_noise(true.vectors, true.soles, covariance, NOISELESS._replace(imu=np.array([1.0, 0, 0, 0])))
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
            state.rotation[:] = state.rotation @ pin.exp3(dt * rate)
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
