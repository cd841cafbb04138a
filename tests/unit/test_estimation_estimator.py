"""The whole estimator on motions of known truth: a robot that sways, is pushed and lifts a foot, with noisy sensors.

The motions are made with Pinocchio alone: a base trajectory, legs by inverse kinematics, and sensors from their
definitions. Closed loops with contact dynamics are in ``tests/closed_loop``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest

from controllers.estimation.estimator import StateEstimator
from controllers.estimation.guard import EstimatorHealth
from models.constants import GRAVITY
from models.errors import MessageError
from models.robot_model import RobotModel
from models.types import RobotState, SensorData

DT, FREE_FALL = 0.001, np.array([0.0, 0.0, -GRAVITY])
PUSH_AT, LIFT_AT, END = 1.0, 1.8, 3.2
LIFT_TIME, LIFT_HEIGHT, STRIDE = 0.6, 0.05, 0.03
PUSH_SPEED, PUSH_TIME, RETURN_TIME = 0.4, 0.1, 0.12


@dataclass
class Motion:
    """Truth and exact sensors, one row per tick."""

    q: np.ndarray
    v: np.ndarray
    gyro: np.ndarray
    accel: np.ndarray
    wrenches: np.ndarray

    def __len__(self) -> int:
        return len(self.q)

    def held(self, n: int) -> Motion:
        """The first tick, n times over."""
        columns = (self.q, self.v, self.gyro, self.accel, self.wrenches)
        return Motion(*(np.repeat(column[:1], n, axis=0) for column in columns))


def bump(t: np.ndarray, start: float, duration: float) -> np.ndarray:
    """0 before, (1 - cos) / 2 twice over in between, 0 after."""
    phase = np.clip((t - start) / duration, 0.0, 1.0)
    return 0.5 * (1.0 - np.cos(2.0 * np.pi * phase))


def base_motion(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Displacement (n, 3) and rotation vector (n, 3) of the base: sway, a push in x and y, then a shift to the left.

    The push takes the base to 0.4 m/s in 0.1 s, and a critically damped motion takes it back.
    """
    impulse = np.where(t >= PUSH_AT, (t - PUSH_AT) * np.exp(-np.maximum(t - PUSH_AT, 0.0) / RETURN_TIME), 0.0)
    window = round(PUSH_TIME / DT)
    push = PUSH_SPEED * np.convolve(impulse, np.full(window, 1.0 / window))[: t.size]
    sway = bump(t, 0.3, END - 0.3) * np.sin(2.0 * np.pi * 0.8 * t)
    shift = np.column_stack([0.8 * push, 0.6 * push, 0.01 * sway - 0.015 * bump(t, 0.3, END - 0.3)])
    turn = np.column_stack([0.04 * sway, 0.05 * sway + 0.8 * push, 0.03 * sway])
    return shift, turn


def solve_legs(robot: RobotModel, data: pin.Data, q: np.ndarray, soles: list[pin.SE3]) -> None:
    """Newton steps of both legs until the soles are where they should be; in place."""
    for _ in range(4):
        pin.computeJointJacobians(robot.pin, data, q)
        pin.updateFramePlacements(robot.pin, data)
        for foot, sole in zip(robot.feet, soles, strict=True):
            error = pin.log6(data.oMf[foot.frame_id].actInv(sole)).vector
            jacobian = pin.getFrameJacobian(robot.pin, data, foot.frame_id, pin.LOCAL)[:, foot.joint_ids_v]
            q[np.asarray(foot.joint_ids_v) + 1] += np.linalg.solve(jacobian, error)


@cache
def motion(robot: RobotModel) -> Motion:
    """The whole motion, on flat feet; the right one is lifted once and set down further ahead."""
    t = np.arange(0.0, END + 2 * DT, DT)
    n, data = t.size, robot.data()
    shift, turn = base_motion(t)
    lift = LIFT_HEIGHT * bump(t, LIFT_AT, LIFT_TIME)
    phase = np.clip((t - LIFT_AT) / LIFT_TIME, 0.0, 1.0)
    stride = STRIDE * (phase - np.sin(2.0 * np.pi * phase) / (2.0 * np.pi))
    start = robot.standing_configuration()
    pin.framesForwardKinematics(robot.pin, data, start)
    homes = [data.oMf[foot.frame_id].copy() for foot in robot.feet]
    q, v = np.zeros((n, robot.nq)), np.zeros((n, robot.nv))
    poses: list[pin.SE3] = []
    now = start.copy()
    arms = [j for j in range(robot.nj) if not any(j + 6 in foot.joint_ids_v for foot in robot.feet)]
    for k in range(n):
        now[:3] = start[:3] + shift[k]
        now[3:7] = pin.Quaternion(pin.exp3(turn[k])).coeffs()
        now[7 + np.array(arms)] = start[7 + np.array(arms)] + 0.1 * np.sin(3.0 * t[k]) * bump(t[k : k + 1], 0.3, END)
        right = homes[1].copy()
        right.translation = homes[1].translation + np.array([stride[k], 0.0, lift[k]])
        solve_legs(robot, data, now, [homes[0], right])
        q[k] = now
        pin.framesForwardKinematics(robot.pin, data, now)
        poses.append(data.oMf[robot.frame_id("imu")].copy())
    for k in range(1, n - 1):
        v[k] = pin.difference(robot.pin, q[k - 1], q[k + 1]) / (2.0 * DT)
    gyro, accel, velocity = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3))
    for k in range(1, n - 1):
        gyro[k] = pin.log3(poses[k - 1].rotation.T @ poses[k + 1].rotation) / (2.0 * DT)
        velocity[k] = (poses[k + 1].translation - poses[k - 1].translation) / (2.0 * DT)
    for k in range(1, n - 1):
        middle = poses[k - 1].rotation @ pin.exp3(0.5 * pin.log3(poses[k - 1].rotation.T @ poses[k].rotation))
        accel[k] = middle.T @ ((velocity[k] - velocity[k - 1]) / DT - FREE_FALL)
    share = 0.5 * (1.0 - np.clip(np.minimum(t - (LIFT_AT - 0.1), LIFT_AT + LIFT_TIME + 0.1 - t) / 0.1, 0.0, 1.0))
    wrenches = np.zeros((n, 2, 6))
    wrenches[:, 0, 2] = (1.0 - share) * robot.mass * GRAVITY
    wrenches[:, 1, 2] = share * robot.mass * GRAVITY
    return Motion(q[1:-1], v[1:-1], gyro[1:-1], accel[1:-1], wrenches[1:-1])


def torques_of(robot: RobotModel, truth: Motion) -> np.ndarray:
    """Joint torques of the motion under its foot wrenches (n, nj); whatever else holds the base takes the rest."""
    data, n = robot.data(), len(truth)
    acceleration = np.gradient(truth.v, DT, axis=0) if n > 1 else np.zeros_like(truth.v)
    torques = np.empty((n, robot.nv))
    for k in range(n):
        torques[k] = pin.rnea(robot.pin, data, truth.q[k], truth.v[k], acceleration[k])
        pin.computeJointJacobians(robot.pin, data, truth.q[k])
        for foot, wrench in zip(robot.feet, truth.wrenches[k], strict=True):
            torques[k] -= pin.getFrameJacobian(robot.pin, data, foot.frame_id, pin.LOCAL).T @ wrench
    return torques[:, 6:]


def sensors_of(robot: RobotModel, truth: Motion, seed: int | None) -> list[SensorData]:
    """What the robot's sensors say, with the profile's noise; exact when ``seed`` is None."""
    n, nj, profile = len(truth), robot.nj, robot.profile.sensors
    scale = 0.0 if seed is None else 1.0
    rng = np.random.default_rng(seed)
    resolution = profile.encoders.resolution
    q = truth.q[:, 7:] if seed is None else np.rint(truth.q[:, 7:] / resolution) * resolution
    v = truth.v[:, 6:] + scale * profile.encoders.velocity_noise * rng.normal(size=(n, nj))
    gyro = truth.gyro + scale * profile.imu.gyro_bias * rng.normal(size=3)
    gyro = gyro + scale * profile.imu.gyro_noise_density / np.sqrt(DT) * rng.normal(size=(n, 3))
    accel = truth.accel + scale * profile.imu.accel_bias * rng.normal(size=3)
    accel = accel + scale * profile.imu.accel_noise_density / np.sqrt(DT) * rng.normal(size=(n, 3))
    wrenches = truth.wrenches + scale * profile.feet.force_noise * rng.normal(size=(n, 2, 6))
    tau = torques_of(robot, truth)
    return [SensorData(k * DT, q[k], v[k], tau[k], gyro[k], accel[k], wrenches[k]) for k in range(n)]


def run(estimator: StateEstimator, sensors: list[SensorData]) -> list[RobotState]:
    return [estimator.reset(sensors[0])] + [estimator.step(sample, DT) for sample in sensors[1:]]


@pytest.fixture(scope="module", params=["g1", "talos"])
def estimator(request: pytest.FixtureRequest) -> StateEstimator:
    robot: RobotModel = request.getfixturevalue(request.param)
    result = StateEstimator(robot)
    result.robot = robot  # type: ignore[attr-defined]
    return result


def robot_of(estimator: StateEstimator) -> RobotModel:
    return estimator.robot  # type: ignore[attr-defined, no-any-return]


def between(start: float, end: float) -> slice:
    return slice(round(start / DT), round(end / DT))


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
    assert estimator.health == EstimatorHealth(steps=len(truth) - 1, gated=estimator.health.gated)
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
    """On its back or its face, the base's x axis is vertical and has no heading; the attitude is still told."""
    robot = robot_of(estimator)
    sample = sensors_of(robot, motion(robot), None)[0]
    up = estimator._kinematics.imu_rotation.T @ [GRAVITY * direction, 0.0, 0.0]
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
    inner = estimator.filter
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
    start = np.diag(estimator.filter.covariance).copy()
    for sample in sensors[1:]:
        estimator.step(sample, DT)
    end = np.diag(estimator.filter.covariance)
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


def coasting_run(
    estimator: StateEstimator, seed: int, spoil: dict[str, object], at: float, length: float
) -> np.ndarray:
    """Errors of the base velocity when part of each sample in a window is spoiled (n, 3)."""
    robot = robot_of(estimator)
    truth = motion(robot)
    sensors = sensors_of(robot, truth, seed)
    window = between(at, at + length)
    for k in range(window.start, window.stop):
        sensors[k] = replace(sensors[k], **{n: np.full_like(getattr(sensors[k], n), x) for n, x in spoil.items()})
    states = run(estimator, sensors)
    for state in states:
        assert np.isfinite(state.q).all()
        assert np.isfinite(state.v).all()
        assert np.isfinite(state.tau).all()
    return np.array([s.v[:3] for s in states]) - truth.v[:, :3]


@pytest.mark.parametrize(
    ("part", "counter"),
    [("q", "invalid_joints"), ("v", "invalid_joints"), ("tau", "invalid_torques"), ("gyro", "invalid_imu"),
     ("accel", "invalid_imu"), ("wrenches", "invalid_feet")],
)  # fmt: skip
@pytest.mark.parametrize("value", [np.nan, -np.inf])
def test_values_that_are_not_finite_are_bridged_and_counted(
    estimator: StateEstimator, part: str, counter: str, value: float
) -> None:
    error = coasting_run(estimator, 0, {part: value}, at=PUSH_AT + 0.05, length=0.02)
    expected = EstimatorHealth(steps=estimator.health.steps, gated=estimator.health.gated)
    setattr(expected, counter, 20)
    assert estimator.health == expected
    assert np.abs(error).max() < 0.1  # 20 ms in the middle of a push of 4 m/s^2
    assert np.abs(error[between(PUSH_AT + 0.3, LIFT_AT)]).max() < 0.02


def test_stale_samples_coast_and_time_goes_on(estimator: StateEstimator) -> None:
    robot = robot_of(estimator)
    sensors = sensors_of(robot, motion(robot), 0)
    estimator.reset(sensors[0])
    for sample in sensors[1:300]:
        last = estimator.step(sample, DT)
    for k in range(20):  # duplicates, then one from the past, then one without a stamp
        stale = sensors[299] if k < 18 else replace(sensors[320], t=sensors[100].t if k == 18 else np.nan)
        state = estimator.step(stale, DT)
        assert state.t == pytest.approx(last.t + (k + 1) * DT)
    assert estimator.health.stale == 20
    assert estimator.health.coasting == pytest.approx(20 * DT)
    state = estimator.step(sensors[320], DT)
    assert state.t == sensors[320].t
    assert estimator.health.coasting == 0.0
    assert np.abs(state.v[:3] - motion(robot).v[320, :3]).max() < 0.03


@pytest.mark.parametrize("dt", [0.0, -0.001, np.nan, np.inf])
def test_unusable_step_changes_nothing(estimator: StateEstimator, dt: float) -> None:
    sensors = sensors_of(robot_of(estimator), motion(robot_of(estimator)), 0)
    before = estimator.reset(sensors[0])
    after = estimator.step(sensors[1], dt)
    np.testing.assert_array_equal(after.q, before.q)
    np.testing.assert_array_equal(after.v, before.v)
    assert estimator.health.stale == 1


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


@pytest.mark.parametrize("part", ["q", "v", "tau", "gyro", "accel", "wrenches"])
def test_unusable_first_sample_is_refused_by_name(estimator: StateEstimator, part: str) -> None:
    robot = robot_of(estimator)
    sample = sensors_of(robot, motion(robot), None)[0]
    value = getattr(sample, part)
    if part != "wrenches":  # a robot without foot sensors starts on its leg torques
        with pytest.raises(MessageError, match=rf"sensors\.{part}: not finite"):
            estimator.reset(replace(sample, **{part: np.full_like(value, np.nan)}))
    with pytest.raises(MessageError, match=rf"sensors\.{part}: shape"):
        estimator.reset(replace(sample, **{part: value[:1]}))


def test_moving_start_and_missing_reset_are_refused(g1: RobotModel) -> None:
    estimator = StateEstimator(g1)
    sample = sensors_of(g1, motion(g1), None)[0]
    with pytest.raises(MessageError, match="reset"):
        estimator.step(sample, DT)
    with pytest.raises(MessageError, match="not at rest"):
        estimator.reset(replace(sample, accel=1.5 * sample.accel))
    with pytest.raises(MessageError, match=r"sensors\.t"):
        estimator.reset(replace(sample, t=np.nan))
