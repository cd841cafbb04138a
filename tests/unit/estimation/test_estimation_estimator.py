"""The whole estimator on motions of known truth, with exact and noisy sensors.

Closed loops with contact dynamics are in ``tests/closed_loop``.
"""

import numpy as np
import pinocchio as pin
import pytest
from msgspec.structs import replace

from controllers.estimation.estimator import StateEstimator
from controllers.estimation.samples import EstimatorHealth
from models.constants import GRAVITY
from tests.known_motion import (
    DT,
    FREE_FALL,
    LIFT_AT,
    LIFT_TIME,
    PUSH_AT,
    Motion,
    between,
    motion,
    robot_of,
    run,
    sensors_of,
)


def test_exact_sensors_give_the_exact_state(estimator: StateEstimator) -> None:
    robot = robot_of(estimator)
    truth = motion(robot)
    states = run(estimator, sensors_of(robot, truth, None))
    speed = np.array([s.v[:6] for s in states]) - truth.v[:, :6]
    assert np.abs(speed[:, :3]).max() < 2e-3
    assert np.abs(speed[:, 3:]).max() < 1e-5
    tilt = [pin.log3(pin.Quaternion(s.q[3:7]).matrix() @ pin.Quaternion(q[3:7]).matrix().T)[:2]
            for s, q in zip(states, truth.q, strict=True)]  # fmt: skip
    assert np.degrees(np.abs(tilt).max()) < 0.05
    assert np.abs(np.array([s.q[2] for s in states]) - truth.q[:, 2]).max() < 1e-3


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_errors_with_the_profiles_noise(estimator: StateEstimator, seed: int) -> None:
    robot = robot_of(estimator)
    truth = motion(robot)
    states = run(estimator, sensors_of(robot, truth, seed))
    speed = np.array([s.v[:3] for s in states]) - truth.v[:, :3]
    height = np.array([s.q[2] for s in states]) - truth.q[:, 2]
    tilt = np.array([pin.log3(pin.Quaternion(s.q[3:7]).matrix() @ pin.Quaternion(q[3:7]).matrix().T)[:2]
                     for s, q in zip(states, truth.q, strict=True)])  # fmt: skip
    assert np.sqrt((speed**2).mean(axis=0)).max() < 0.004
    assert np.abs(speed[between(PUSH_AT, PUSH_AT + 0.4)]).max() < 0.012  # no lag: the push changes it by 0.4
    assert np.abs(speed).max() < 0.02  # lift-off and touch-down included
    assert np.degrees(np.sqrt((tilt**2).mean(axis=0))).max() < 0.5
    assert np.abs(height).max() < 0.003
    health = estimator.health
    assert health == EstimatorHealth(steps=len(truth) - 1, gated=health.gated, friction=health.friction)
    assert estimator.health.gated < 20


def test_standing_is_smooth(estimator: StateEstimator) -> None:
    robot = robot_of(estimator)
    truth = motion(robot)
    still = Motion(
        *(np.repeat(a[:1], 2000, axis=0) for a in (truth.q, truth.v, truth.gyro, truth.accel, truth.wrenches))
    )
    states = run(estimator, sensors_of(robot, still, 5))
    speed = np.array([s.v[:3] for s in states])[500:]
    assert speed.std(axis=0).max() < 0.002
    assert np.abs(speed.mean(axis=0)).max() < 0.002


def test_lifted_foot_leaves_and_makes_contact_once(estimator: StateEstimator) -> None:
    robot = robot_of(estimator)
    states = run(estimator, sensors_of(robot, motion(robot), 3))
    active = np.array([[c.active for c in s.contacts] for s in states], dtype=int)
    assert active[:, 0].all()
    changes = np.flatnonzero(np.diff(active[:, 1]))
    assert len(changes) == 2
    assert abs(changes[0] * DT - LIFT_AT) < 0.05
    assert abs(changes[1] * DT - (LIFT_AT + LIFT_TIME)) < 0.05


def test_starts_between_the_soles_without_yaw(estimator: StateEstimator) -> None:
    robot = robot_of(estimator)
    truth = motion(robot)
    state = estimator.reset(sensors_of(robot, truth, None)[0])
    np.testing.assert_allclose(state.q, robot.standing_configuration(), atol=1e-6)
    assert state.t == 0.0
    rng = np.random.default_rng(0)
    tilted = pin.exp3(0.2 * rng.normal(size=3))
    sample = replace(sensors_of(robot, truth, None)[0], accel=tilted @ (-FREE_FALL))
    state = estimator.reset(sample)
    data = robot.data()
    pin.framesForwardKinematics(robot.pin, data, state.q)
    soles = [data.oMf[foot.frame_id].translation for foot in robot.feet]
    np.testing.assert_allclose(np.mean(soles, axis=0), 0.0, atol=1e-12)
    imu = data.oMf[robot.frame_id("imu")].rotation
    np.testing.assert_allclose(imu @ tilted @ [0.0, 0.0, 1.0], [0.0, 0.0, 1.0], atol=1e-12)
    base = pin.Quaternion(state.q[3:7]).matrix()
    assert abs(base[1, 0]) < 1e-12


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_starts_lying_flat_with_some_heading(estimator: StateEstimator, direction: float) -> None:
    """On its back or its face, the base's x axis is vertical and has no heading; the attitude is still reported."""
    robot = robot_of(estimator)
    sample = sensors_of(robot, motion(robot), None)[0]
    estimator.reset(sample)  # the orientation of the IMU follows the joints
    up = estimator._kinematics.imu.rotation.T @ [GRAVITY * direction, 0.0, 0.0]
    state = estimator.reset(replace(sample, accel=up))
    base = pin.Quaternion(state.q[3:7]).matrix()
    np.testing.assert_allclose(base @ [1.0, 0.0, 0.0], [0.0, 0.0, direction], atol=1e-9)


def test_another_world_frame_gives_the_same_motion_in_it(estimator: StateEstimator) -> None:
    """Turned and shifted at the start, the estimate stays turned and shifted, and its twist in B does not change."""
    robot = robot_of(estimator)
    sensors = sensors_of(robot, motion(robot), 4)[: round(1.5 / DT)]
    reference = run(estimator, sensors)
    turn, shift = pin.exp3(np.array([0.0, 0.0, 2.0])), np.array([3.0, -5.0, 0.7])
    estimator.reset(sensors[0])
    inner = estimator.filter.state
    inner.rotation[:] = turn @ inner.rotation
    inner.vectors[:] = inner.vectors @ turn.T
    inner.vectors[1:] += shift
    inner.soles[:] = turn @ inner.soles
    adjoint = np.zeros((27, 27))
    for block in range(0, 21, 3):
        adjoint[block : block + 3, block : block + 3] = turn
    for block in (6, 9, 12):
        adjoint[block : block + 3, :3] = pin.skew(shift) @ turn
    adjoint[21:, 21:] = np.eye(6)
    inner.covariance[:] = adjoint @ inner.covariance @ adjoint.T
    moved = [estimator.step(sample, DT) for sample in sensors[1:]]
    for a, b in zip(reference[1:], moved, strict=True):
        np.testing.assert_allclose(b.v, a.v, atol=1e-8)
        np.testing.assert_allclose(b.q[:3], turn @ a.q[:3] + shift, atol=1e-8)
        np.testing.assert_allclose(
            pin.Quaternion(b.q[3:7]).matrix(), turn @ pin.Quaternion(a.q[3:7]).matrix(), atol=1e-8
        )


def test_no_information_about_yaw_or_position_is_invented(estimator: StateEstimator) -> None:
    robot = robot_of(estimator)
    sensors = sensors_of(robot, motion(robot), 6)
    estimator.reset(sensors[0])
    start = np.diag(estimator.filter.state.covariance).copy()
    for sample in sensors[1:]:
        estimator.step(sample, DT)
    end = np.diag(estimator.filter.state.covariance)
    for component in (2, 6, 7, 8):
        assert end[component] >= 0.999 * start[component]
    assert (end[[0, 1]] < start[[0, 1]]).all()


def test_same_samples_same_bits(estimator: StateEstimator) -> None:
    robot = robot_of(estimator)
    sensors = sensors_of(robot, motion(robot), 7)[:500]
    first, second = run(estimator, sensors), run(estimator, sensors)
    for a, b in zip(first, second, strict=True):
        assert a.q.tobytes() == b.q.tobytes()
        assert a.v.tobytes() == b.v.tobytes()


def test_states_handed_out_do_not_change_later(estimator: StateEstimator) -> None:
    robot = robot_of(estimator)
    sensors = [replace(s, tau=np.full(robot.nj, s.t)) for s in sensors_of(robot, motion(robot), 0)[:50]]
    state = estimator.reset(sensors[0])
    arrays = (state.q, state.v, state.tau, state.contacts[0].wrench, state.contacts[1].wrench)
    before = [array.copy() for array in arrays]
    for sample in sensors[1:]:
        last = estimator.step(sample, DT)
    for array, copy in zip(arrays, before, strict=True):
        np.testing.assert_array_equal(array, copy)
    np.testing.assert_array_equal(last.tau, sensors[-1].tau)


def test_level_floor_takes_part_of_the_tilt_that_an_accelerometer_bias_causes(estimator: StateEstimator) -> None:
    robot = robot_of(estimator)
    still = motion(robot).held(500)
    bias = 0.05
    still.accel[:, 0] += bias
    states = run(estimator, sensors_of(robot, still, None))
    tilt = [np.linalg.norm(pin.log3(pin.Quaternion(state.q[3:7]).matrix())[:2]) for state in (states[0], states[-1])]
    assert tilt[0] == pytest.approx(bias / GRAVITY, rel=0.01)
    imu = estimator.config.imu.accel_bias / estimator.config.gravity
    kept = estimator.config.initial.floor**2 / (estimator.config.initial.floor**2 + imu**2)
    assert tilt[1] / tilt[0] == pytest.approx(kept, abs=0.08)


def test_memory_layout_and_later_writes_do_not_matter(estimator: StateEstimator) -> None:
    """Strided arrays, and arrays that the caller reuses after the call."""
    robot = robot_of(estimator)
    sensors = sensors_of(robot, motion(robot), 8)[:200]
    expected = [s.q.copy() for s in run(estimator, sensors)]
    scratch = np.zeros((robot.nj, 2))
    estimator.reset(sensors[0])
    for k, sample in enumerate(sensors[1:], start=1):
        scratch[:, 0] = sample.q
        state = estimator.step(replace(sample, q=scratch[:, 0]), DT)
        scratch[:] = np.nan
        np.testing.assert_array_equal(state.q, expected[k])


def test_hanging_robot_does_not_drift(estimator: StateEstimator) -> None:
    """Feet in the air, held still: without the update at rest, the accelerometer's bias would carry it away."""
    robot = robot_of(estimator)
    truth = motion(robot)
    still = Motion(
        *(np.repeat(a[:1], 3000, axis=0) for a in (truth.q, truth.v, truth.gyro, truth.accel, truth.wrenches))
    )
    still.wrenches[:] = 0.0
    states = run(estimator, sensors_of(robot, still, 1))
    assert not any(c.active for s in states for c in s.contacts)
    assert np.abs(np.array([s.v[:3] for s in states])).max() < 0.02
    assert np.abs(states[-1].q[:3] - states[0].q[:3]).max() < 0.02
