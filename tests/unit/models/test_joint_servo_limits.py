"""Joint servo: the limits that it never exceeds."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from controllers.joints.joint_servo import drive_torque
from models.robot_model import RobotModel
from models.types import JointCommand
from tests.servos import DT, Vector, armed, hold, torque_of


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_setpoint_is_brought_back_to_the_limits(g1: RobotModel, sign: float) -> None:
    servo, t = armed(g1)
    far = np.full(g1.nj, sign * 1e6)
    assert servo.command(JointCommand(far, far, far), t)
    np.testing.assert_array_equal(servo.setpoint.q, g1.q_upper if sign > 0 else g1.q_lower)
    np.testing.assert_array_equal(servo.setpoint.v, sign * g1.v_max)
    np.testing.assert_array_equal(servo.setpoint.tau, sign * g1.tau_max)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_torque_towards_a_joint_limit_fades_out(g1: RobotModel, sign: float) -> None:
    servo, t = armed(g1)
    limit = g1.q_upper if sign > 0 else g1.q_lower
    margin, zero = servo.config.position_margin, np.zeros(g1.nj)
    for inside, share in ((margin, 1.0), (0.5 * margin, 0.5), (0.0, 0.0)):
        for _ in range(200):
            servo.command(hold(g1, q=limit, tau=sign * g1.tau_max), t)
            tau = torque_of(servo, t, limit - sign * inside, zero, DT)
            t += DT
        np.testing.assert_allclose(sign * tau, share * g1.tau_max, atol=1e-6 * g1.tau_max.max())
    for _ in range(200):
        servo.command(hold(g1, q=limit, tau=-sign * g1.tau_max), t)
        tau = torque_of(servo, t, limit, zero, DT)
        t += DT
    np.testing.assert_allclose(sign * tau, -g1.tau_max)  # away from the limit: all of it


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_torque_that_speeds_up_fades_out_beyond_the_velocity_limit(g1: RobotModel, sign: float) -> None:
    servo, t = armed(g1)
    q = 0.5 * (g1.q_lower + g1.q_upper)
    for excess, share in ((0.0, 1.0), (0.5, 0.5), (1.0, 0.0), (3.0, 0.0)):
        v = sign * g1.v_max * (1.0 + excess * servo.config.velocity_margin)
        for _ in range(200):
            servo.command(JointCommand(q, sign * g1.v_max, sign * g1.tau_max), t)
            expected = np.minimum(g1.tau_max + g1.kd * (g1.v_max - sign * v), g1.tau_max)
            tau = torque_of(servo, t, q, v, DT)
            t += DT
        np.testing.assert_allclose(sign * tau, np.clip(expected, -g1.tau_max, share * g1.tau_max), atol=1e-9)


def test_a_limited_joint_may_keep_a_share_of_its_gains(g1: RobotModel) -> None:
    """A robot that gets no further command is damped, and has less torque the nearer it is to the setpoint."""
    servo, t = armed(g1, keep_gains=True)
    q, zero, ahead = g1.posture("stand"), np.zeros(g1.nj), 2.0 * g1.tau_max / g1.kp
    inside = q + ahead < g1.q_upper  # others are at the limit of their setpoint
    for k in range(200):
        servo.command(hold(g1, q=q + ahead), t + k * DT)
        command = servo.step(t + k * DT, q, zero, DT)
    np.testing.assert_allclose(drive_torque(g1, command, q, zero), servo.torque, atol=1e-9)
    np.testing.assert_allclose(servo.torque[inside], g1.tau_max[inside])
    later = drive_torque(g1, command, q + 0.5 * ahead, np.ones(g1.nj))
    assert inside.any()
    np.testing.assert_allclose(later[inside], 0.5 * (g1.tau_max - g1.kd)[inside])
    servo.damp()
    measured = np.full(g1.nj, np.nan)
    servo.step(t + 1.0, measured, measured, 1.0)
    assert not servo.torque.any()


anything = st.floats(allow_nan=True, allow_infinity=True, width=64)
moderate = st.floats(-50.0, 50.0)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_never_exceeds_torque_and_rate_limits(g1: RobotModel, data: st.DataObject) -> None:
    """Whatever is commanded, measured or switched: finite torque within the limits, changing within the rate."""
    servo, t = armed(g1)
    previous = torque_of(servo, t, g1.posture("stand"), np.zeros(g1.nj), DT).copy()
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))

    def vector() -> Vector:
        values = rng.normal(0.0, 10.0 ** data.draw(st.integers(-3, 4)), g1.nj)
        values[data.draw(st.integers(0, g1.nj - 1))] = data.draw(st.one_of(anything, moderate))
        return values

    for _ in range(data.draw(st.integers(1, 12))):
        t += DT
        action = data.draw(st.sampled_from(["command", "command", "command", "damp", "off", "arm", "nothing"]))
        if action == "command":
            servo.command(JointCommand(vector(), vector(), vector()), t)
        elif action != "nothing":
            getattr(servo, action)()
        with np.errstate(all="ignore"):
            tau = torque_of(servo, t, vector(), vector(), DT)
        assert np.isfinite(tau).all()
        assert np.all(np.abs(tau) <= g1.tau_max * (1.0 + 1e-12))
        assert np.all(np.abs(tau - previous) <= g1.tau_rate_max * DT * (1.0 + 1e-9))
        previous = tau.copy()
