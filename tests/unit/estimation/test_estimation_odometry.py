"""Covariance of pose and twist of the base, against finite differences and samples of the estimator's own output."""

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from msgspec.structs import replace

from controllers.estimation.estimator import StateEstimator
from controllers.estimation.filter_kernels import SIZE, retract
from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.types import SensorData

DT = 0.001


@pytest.fixture(scope="module")
def estimator(robot: RobotModel) -> StateEstimator:
    """In a random posture, turned, moved away from the origin, in motion, with a random covariance."""
    rng = np.random.default_rng(0)
    law = StateEstimator(robot)
    joints = robot.standing_configuration()[7:] + 0.2 * rng.normal(size=robot.nj)
    force = np.array([0.5, -0.7, 9.7])
    zero = np.zeros(robot.nj)
    law.reset(SensorData(0.0, joints, zero, zero, np.zeros(3), force, np.zeros((2, 6))))
    law.step(SensorData(DT, joints, zero, zero, np.zeros(3), force, np.zeros((2, 6))), DT)
    law.filter.state.rotation[:] = pin.exp3(rng.normal(size=3))
    law.filter.state.vectors[:] = rng.normal(size=(4, 3))
    law.filter.state.biases[:] = 0.1 * rng.normal(size=(2, 3))
    root = rng.normal(size=(SIZE, SIZE))
    law.filter.state.covariance[:] = 1e-8 * (root @ root.T)
    return law


def difference(law: StateEstimator, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Position and rotation in W, linear and angular velocity in B, of the present state less another (12,)."""
    state = law._state()
    turn = pin.Quaternion(state.q[3:7]).matrix() @ pin.Quaternion(q[3:7]).matrix().T
    return np.concatenate([state.q[:3] - q[:3], pin.log3(turn), state.v[:6] - v[:6]])


def disturbed(law: StateEstimator, q: np.ndarray, v: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Error of the output (12,) when the filter's error is ``error`` (27,); the filter is put back afterwards."""
    inner = law.filter.state
    kept = [array.copy() for array in (inner.rotation, inner.vectors, inner.soles, inner.biases)]
    retract(inner, -error)
    result = difference(law, q, v)
    for array, copy in zip((inner.rotation, inner.vectors, inner.soles, inner.biases), kept, strict=True):
        array[:] = copy
    return result


def numeric_jacobians(law: StateEstimator, robot: RobotModel) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """By the filter's error (12, 27), the rate sample (12, 3), joint positions and velocities (12, nj)."""
    state = law._state()
    buffer, step = law._buffer, 1e-6

    def central(move: Callable[[float], np.ndarray]) -> np.ndarray:
        return (move(step) - move(-step)) / (2.0 * step)

    def by_error(axis: int) -> Callable[[float], np.ndarray]:
        return lambda h: disturbed(law, state.q, state.v, h * np.eye(SIZE)[axis])

    def by_buffer(array: np.ndarray, axis: int) -> Callable[[float], np.ndarray]:
        def move(h: float) -> np.ndarray:
            array[axis] += h
            law._kinematics.update(buffer.joints[0])
            result = difference(law, state.q, state.v)
            array[axis] -= h
            law._kinematics.update(buffer.joints[0])
            return result

        return move

    return (
        np.column_stack([central(by_error(axis)) for axis in range(SIZE)]),
        np.column_stack([central(by_buffer(buffer.imu[0], axis)) for axis in range(3)]),
        np.column_stack([central(by_buffer(buffer.joints[0], axis)) for axis in range(robot.nj)]),
        np.column_stack([central(by_buffer(buffer.joints[1], axis)) for axis in range(robot.nj)]),
    )


def test_covariance_is_that_of_finite_differences(estimator: StateEstimator, robot: RobotModel) -> None:
    error, rate, joints, speeds = numeric_jacobians(estimator, robot)
    between = estimator._kinematics.imu.columns
    encoders, config = robot.profile.sensors.encoders, estimator.config
    expected = error @ estimator.filter.state.covariance @ error.T
    expected += config.imu.gyro_noise**2 / DT * (rate @ rate.T)
    expected += encoders.velocity_noise**2 * (speeds[:, between] @ speeds[:, between].T)
    joints[6:] = 0.0  # times the speed: left out of the twist, see ``odometry_covariance``
    angle = np.hypot(config.kinematics.encoder_steps * encoders.resolution, encoders.offset)
    expected += angle**2 * (joints[:, between] @ joints[:, between].T)
    pose, twist = estimator.odometry_covariance()
    np.testing.assert_allclose(pose, expected[:6, :6], rtol=1e-6, atol=1e-8 * np.abs(expected[:6, :6]).max())
    np.testing.assert_allclose(twist, expected[6:, 6:], rtol=1e-6, atol=1e-8 * np.abs(expected[6:, 6:]).max())
    joint = estimator.base_covariance()
    np.testing.assert_allclose(joint[:6, 6:], expected[:6, 6:], rtol=1e-6, atol=1e-8 * np.abs(expected).max())
    np.testing.assert_array_equal(joint, joint.T)


def test_covariance_is_that_of_samples(estimator: StateEstimator) -> None:
    """Errors drawn from the filter's covariance scatter the output as its covariance says (rate and joints exact)."""
    state, rng = estimator._state(), np.random.default_rng(1)
    root, count = np.linalg.cholesky(estimator.filter.state.covariance + 1e-16 * np.eye(SIZE)), 4000
    samples = np.array([disturbed(estimator, state.q, state.v, root @ rng.normal(size=SIZE)) for _ in range(count)])
    kept = estimator._variances.copy()
    estimator._variances[:] = 0.0
    pose, twist = estimator.odometry_covariance()
    estimator._variances[:] = kept
    for expected, part in ((pose, samples[:, :6]), (twist, samples[:, 6:])):
        white = np.linalg.solve(np.linalg.cholesky(expected), part.T)
        np.testing.assert_allclose(white @ white.T / count, np.eye(6), atol=5.0 / np.sqrt(count))


def test_twist_does_not_know_what_cannot_be_observed(estimator: StateEstimator) -> None:
    """Yaw and position uncertain by any amount: the twist stays as certain as it was, and so do roll and pitch."""
    before_pose, before = estimator.odometry_covariance()
    inner = estimator.filter.state
    kept = inner.covariance.copy()
    directions = np.zeros((SIZE, 4))
    directions[[2, 17, 20], 0] = 1.0
    for axis in range(3):
        directions[[6 + axis, 9 + axis, 12 + axis], 1 + axis] = 1.0
    inner.covariance[...] += directions @ directions.T
    pose, twist = estimator.odometry_covariance()
    inner.covariance[:] = kept
    np.testing.assert_allclose(twist, before, atol=1e-15)
    np.testing.assert_allclose(pose[3:5, 3:5], before_pose[3:5, 3:5], atol=1e-15)
    assert pose[5, 5] == pytest.approx(before_pose[5, 5] + 1.0)


def test_missing_inertial_samples_widen_the_angular_velocity(robot: RobotModel) -> None:
    law = StateEstimator(robot)
    zero = np.zeros(robot.nj)
    sample = SensorData(0.0, zero, zero, zero, np.zeros(3), np.array([0.0, 0.0, GRAVITY]), np.zeros((2, 6)))
    law.reset(sample)
    start = law.odometry_covariance()[1][5, 5]
    law.step(SensorData(DT, zero, zero, zero, np.full(3, np.nan), sample.accel, sample.wrenches), DT)
    assert law.odometry_covariance()[1][5, 5] > 20.0 * start
    law.step(SensorData(2 * DT, zero, zero, zero, np.zeros(3), sample.accel, sample.wrenches), DT)
    assert law.odometry_covariance()[1][5, 5] == pytest.approx(start, rel=0.1)


def test_a_sole_turns_about_its_middle_until_it_tips(robot: RobotModel) -> None:
    """The point about which the filter turns a sole: its middle while it lies flat, the edge when the CoP is there."""
    law, zero = StateEstimator(robot), np.zeros(robot.nj)
    load = 0.5 * robot.mass * GRAVITY
    edge = robot.feet[0].rectangle[3]
    for share, expected in ((0.5, 0.0), (1.0, edge)):  # centre of pressure, as a share of the way to the left edge
        wrenches = np.zeros((2, 6))
        wrenches[:, 2] = load
        wrenches[0, 3] = share * edge * load
        sample = SensorData(0.0, zero, zero, zero, np.zeros(3), np.array([0.0, 0.0, GRAVITY]), wrenches)
        law.reset(sample)
        law.step(replace(sample, t=DT), DT)
        np.testing.assert_allclose(law._contacts.pivots[0], [0.0, expected], atol=1e-12)


def test_result_is_the_callers(estimator: StateEstimator) -> None:
    pose, twist = estimator.odometry_covariance()
    copies = pose.copy(), twist.copy()
    estimator.filter.state.covariance[...] *= 4.0
    estimator.odometry_covariance()
    estimator.filter.state.covariance[...] *= 0.25
    np.testing.assert_array_equal(pose, copies[0])
    np.testing.assert_array_equal(twist, copies[1])
