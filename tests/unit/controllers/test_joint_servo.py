"""Joint servo: what it tracks, how it takes over and gives up, and which commands it refuses."""

import numpy as np
import pytest
from msgspec.structs import replace

from controllers.joints.joint_servo import JointServo, ServoState
from models.errors import JointNameError, TrajectoryError
from models.robot_model import RobotModel
from models.types import JointCommand, JointTrajectory
from tests.servos import DT, armed, hold, torque_of


def test_law(g1: RobotModel) -> None:
    servo, t = armed(g1)
    rng = np.random.default_rng(0)
    q = g1.posture("stand") + 0.001 * rng.standard_normal(g1.nj)
    q = np.clip(q, g1.q_lower + 0.1, g1.q_upper - 0.1)
    v = 0.01 * rng.standard_normal(g1.nj)
    cmd = JointCommand(q + 0.001, 0.01 * np.ones(g1.nj), 0.1 * np.ones(g1.nj))
    expected = g1.kp * 0.001 + g1.kd * (0.01 - v) + 0.1
    for k in range(20):
        servo.command(cmd, t + k * DT)
        tau = torque_of(servo, t + k * DT, q, v, DT)
    np.testing.assert_allclose(tau, expected, rtol=1e-12)


def test_off_gives_no_torque_and_ignores_commands(g1: RobotModel) -> None:
    servo = JointServo(g1)
    assert not servo.command(hold(g1, tau=g1.tau_max), 0.0)
    assert not torque_of(servo, 0.0, g1.posture("zero"), np.zeros(g1.nj), DT).any()
    assert servo.state is ServoState.OFF


def test_arming_does_not_jump(g1: RobotModel) -> None:
    """From a posture 0.2 rad away, the first torque is small and grows smoothly."""
    servo = JointServo(g1)
    servo.arm()
    q = g1.posture("stand") + np.clip(0.2, None, 0.5 * (g1.q_upper - g1.posture("stand")))
    zero = np.zeros(g1.nj)
    servo.step(0.0, q, zero, DT)
    history = []
    for k in range(1, 400):
        servo.command(hold(g1), k * DT)
        history.append(torque_of(servo, k * DT, q, zero, DT).copy())
    torques = np.array(history)
    final = np.abs(g1.kp * (g1.posture("stand") - q))
    assert np.all(np.abs(torques[0]) <= 0.01 * final + 1e-9)
    assert np.all(np.abs(np.diff(torques, axis=0)) <= 0.01 * final + 1e-9)
    np.testing.assert_allclose(np.abs(torques[-1]), np.minimum(final, g1.tau_max), rtol=1e-6)


def test_another_source_takes_over_without_a_jump(g1: RobotModel) -> None:
    """``blend`` keeps the feed-forward in force and goes to the next one smoothly, even when it comes again."""
    servo, t = armed(g1)
    q, zero = g1.posture("stand"), np.zeros(g1.nj)
    first, second = 0.2 * g1.tau_max, -0.2 * g1.tau_max
    for k in range(100):
        servo.command(hold(g1, tau=first), t + k * DT)
        servo.step(t + k * DT, q, zero, DT)
    t += 100 * DT
    servo.blend()
    servo.blend()
    history = [first]
    for k in range(400):
        if k >= 2:
            servo.command(hold(g1, tau=second), t + k * DT)
        history.append(torque_of(servo, t + k * DT, q, zero, DT).copy())
        if k == 150:
            servo.blend()  # from the middle of the fade
    np.testing.assert_allclose(history[1], first)
    assert np.all(np.abs(np.diff(np.array(history), axis=0)) <= 0.01 * 0.4 * g1.tau_max)
    for k in range(400, 600):
        servo.command(hold(g1, tau=second), t + k * DT)
        last = torque_of(servo, t + k * DT, q, zero, DT)
    np.testing.assert_allclose(last, second)


def test_holds_the_measured_posture_before_the_first_command(g1: RobotModel) -> None:
    servo = JointServo(g1)
    servo.arm()
    q, zero = g1.posture("stand"), np.zeros(g1.nj)
    servo.step(0.0, q, zero, DT)
    for k in range(1, 200):
        tau = torque_of(servo, k * DT, q - 0.01, zero, DT)
    np.testing.assert_allclose(tau, 0.01 * g1.kp, rtol=1e-9)
    assert servo.state is ServoState.ACTIVE


@pytest.mark.parametrize("field", ["q", "v", "tau"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_command_that_is_not_finite_is_refused_then_times_out(g1: RobotModel, field: str, bad: float) -> None:
    servo, t = armed(g1)
    q, zero = g1.posture("stand"), np.zeros(g1.nj)
    before = servo.setpoint
    values = getattr(hold(g1), field).copy()
    values[7] = bad
    cmd = replace(hold(g1), **{field: values})
    steps = round(servo.config.command_timeout / DT)
    for k in range(steps - 1):
        assert not servo.command(cmd, t + k * DT)
        servo.step(t + k * DT, q, zero, DT)
    assert servo.state is ServoState.ACTIVE
    assert servo.refused == steps - 1
    np.testing.assert_array_equal(servo.setpoint.q, before.q)
    for k in range(steps - 1, steps + 2):
        servo.step(t + k * DT, q, zero, DT)
    assert servo.state is ServoState.DAMPED
    assert servo.timeouts == 1
    assert 0.0 < servo.silence - servo.config.command_timeout <= 2.0 * DT


def test_command_of_wrong_size_is_refused(g1: RobotModel) -> None:
    servo, t = armed(g1)
    assert not servo.command(replace(hold(g1), tau=np.zeros(g1.nj - 1)), t)
    assert servo.refused == 1


def test_timeout_fades_torque_into_damping_and_latches(g1: RobotModel) -> None:
    servo, t = armed(g1)
    q, v = g1.posture("stand"), 0.1 * np.ones(g1.nj)
    tau_ff = np.minimum(10.0, 0.5 * g1.tau_max)
    for k in range(50):
        servo.command(hold(g1, tau=tau_ff), t + k * DT)
        last = torque_of(servo, t + k * DT, q, v, DT).copy()
    torques = []
    for k in range(50, 300):
        torques.append(torque_of(servo, t + k * DT, q, v, DT).copy())
    assert servo.state is ServoState.DAMPED
    np.testing.assert_allclose(torques[-1], -servo.config.damping_scale * g1.kd * 0.1, rtol=1e-9)
    largest_step = np.abs(np.diff(np.array([last, *torques]), axis=0)).max(axis=0)
    change = np.abs(torques[-1] - last)
    assert np.all(largest_step <= 1.01 * change * DT / servo.config.damped_ramp + 1e-9)
    assert not servo.command(hold(g1), t + 0.3)
    servo.step(t + 0.3, q, v, DT)
    assert servo.state is ServoState.DAMPED
    servo.arm()
    assert servo.command(hold(g1), t + 0.3)
    assert servo.state is ServoState.ACTIVE


def test_measurement_that_is_not_finite_gives_that_joint_no_torque(g1: RobotModel) -> None:
    servo, t = armed(g1)
    q, v = g1.posture("stand").copy(), np.zeros(g1.nj)
    q[3], v[5] = np.inf, np.nan
    for k in range(30):
        servo.command(hold(g1, tau=0.1 * g1.tau_max), t + k * DT)
        tau = torque_of(servo, t + k * DT, q, v, DT)
    assert tau[3] == 0.0 and tau[5] == 0.0
    assert np.all(tau[[0, 1, 2, 4]] > 0.0)
    assert servo.sensor_faults == 30


def test_trajectory_is_interpolated_between_messages(g1: RobotModel) -> None:
    """Setpoints at 50 Hz, each reaching 40 ms ahead: the torque follows without a staircase."""
    servo, t0 = armed(g1)
    shoulder = g1.joint_index("left_shoulder_pitch_joint")
    names, zero = ("left_shoulder_pitch_joint",), np.zeros(g1.nj)
    q = g1.posture("stand").copy()
    start = q[shoulder]
    torques = []
    for k in range(400):
        t = t0 + k * DT
        if k % 20 == 0:
            ahead = np.array([0.04])
            position = start + 0.2 * (t - t0 + ahead)
            traj = JointTrajectory(names, ahead, position[:, None], np.array([[0.2]]))
            assert servo.command_trajectory(traj, t)
        q[shoulder] = start + 0.2 * (t - t0)
        v = zero.copy()
        v[shoulder] = 0.2
        torques.append(torque_of(servo, t, q, v, DT)[shoulder])
    assert servo.state is ServoState.ACTIVE
    assert np.abs(torques[100:]).max() < 1e-3 * g1.kp[shoulder]


def test_trajectory_ends_then_times_out(g1: RobotModel) -> None:
    servo, t = armed(g1)
    q, zero = g1.posture("stand"), np.zeros(g1.nj)
    servo.command_trajectory(JointTrajectory(g1.joint_names, np.array([0.1]), q[None]), t)
    for k in range(round((0.1 + servo.config.command_timeout) / DT) - 1):
        servo.step(t + k * DT, q, zero, DT)
    assert servo.state is ServoState.ACTIVE
    for j in range(4):
        servo.step(t + (k + 1 + j) * DT, q, zero, DT)
    assert servo.state is ServoState.DAMPED


def test_single_point_trajectory_is_a_setpoint_in_any_joint_order(g1: RobotModel) -> None:
    servo, t = armed(g1)
    order = np.random.default_rng(1).permutation(g1.nj)
    q = g1.posture("stand") + 0.001
    tau = 0.1 * g1.tau_max
    names = tuple(g1.joint_names[i] for i in order)
    traj = JointTrajectory(names, np.zeros(1), q[order][None], np.zeros((1, g1.nj)), tau[order][None])
    assert servo.command_trajectory(traj, t)
    servo.step(t, q, np.zeros(g1.nj), DT)
    np.testing.assert_array_equal(servo.setpoint.q, q)
    np.testing.assert_array_equal(servo.setpoint.tau, tau)


def test_refused_trajectory_leaves_the_setpoint(g1: RobotModel) -> None:
    servo, t = armed(g1)
    before = servo.setpoint
    far = g1.posture("stand") + 0.5
    for error, traj in (
        (TrajectoryError, JointTrajectory(g1.joint_names, np.zeros(1), far[None])),
        (JointNameError, JointTrajectory(("nose",), np.zeros(1), np.zeros((1, 1)))),
    ):
        with pytest.raises(error):
            servo.command_trajectory(traj, t)
        servo.step(t, g1.posture("stand"), np.zeros(g1.nj), DT)
        np.testing.assert_array_equal(servo.setpoint.q, before.q)
    assert servo.refused == 2


def test_gains_of_a_command_replace_those_of_the_profile(g1: RobotModel) -> None:
    servo, t = armed(g1)
    q, zero, ones = g1.posture("stand"), np.zeros(g1.nj), np.ones(g1.nj)
    soft = JointCommand(q + 0.001, zero, 0.1 * ones, kp=20.0 * ones, kd=0.5 * ones)
    for k in range(20):
        assert servo.command(soft, t + k * DT)
        command = servo.step(t + k * DT, q, 0.01 * ones, DT)
    np.testing.assert_allclose(servo.torque, 20.0 * 0.001 - 0.5 * 0.01 + 0.1, rtol=1e-9)
    np.testing.assert_array_equal(command.kp, soft.kp)
    np.testing.assert_array_equal(command.kd, soft.kd)
    for bad in (-ones, np.full(g1.nj, np.nan), np.ones(3)):
        assert not servo.command(replace(soft, kp=bad), t + 1.0)
    assert servo.refused == 3
    assert servo.command(hold(g1), t + 0.02)
    np.testing.assert_array_equal(servo.setpoint.kp, g1.kp)


def test_a_limited_joint_gets_its_torque_alone(g1: RobotModel) -> None:
    servo, t = armed(g1)
    q, zero = g1.posture("stand"), np.zeros(g1.nj)
    servo.command(replace(hold(g1), tau=2.0 * g1.tau_max), t)
    command = servo.step(t, q, zero, DT)
    limited = servo.torque != servo.setpoint.tau
    assert limited.any()
    assert command.kp is not None and command.kd is not None
    np.testing.assert_array_equal(command.tau, servo.torque)
    assert not command.kp[limited].any() and not command.kd[limited].any()
