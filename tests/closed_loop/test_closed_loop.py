"""The whole robot in lockstep: start, determinism, delay, what the controller sees and what is logged."""

from typing import Any

import numpy as np
import pytest
from msgspec import structs
from numpy.typing import NDArray

from bridge.closed_loop import ClosedLoop
from controllers.joints.joint_servo import JointServo
from controllers.stack import Law
from models.constants import GRAVITY
from models.errors import ConfigError
from models.robot_model import RobotModel
from models.types import JointCommand, Mode, RobotState, SolveStatus
from tests.wrapped import Wrapped, columns

DT = 0.001


def test_starts_standing_without_drop_or_jerk(robot: RobotModel) -> None:
    loop = ClosedLoop(robot, seed=2, record_period_s=DT)
    assert loop.mode is Mode.STAND and not loop.plant.held
    released = loop.t
    loop.run(1.0)
    log = loop.log
    after = log.t >= released
    weight = robot.mass * GRAVITY
    load = log.wrenches[after][:, 2] + log.wrenches[after][:, 8]
    assert not loop.fallen and loop.mode is Mode.STAND
    assert np.abs(load - weight).max() < 0.05 * weight
    assert np.ptp(log.true_q[after][:, 2]) < 0.002
    assert np.abs(log.true_v[after][:, :3]).max() < 0.05
    assert np.abs(log.true_v[after][:, 6:]).mean() < 0.02
    assert loop.foot_slip.max() < 0.001


def test_torque_does_not_step_while_it_starts(robot: RobotModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """At most 5 % of the torque limit in a millisecond, the sensors' noise included, until it stands on its own."""
    torques: list[NDArray[np.float64]] = []
    step = JointServo.step

    def keep(servo: JointServo, *sample: Any) -> JointCommand:
        command = step(servo, *sample)
        torques.append(servo.torque.copy())
        return command

    monkeypatch.setattr(JointServo, "step", keep)
    ClosedLoop(robot, record=False)
    steps = np.abs(np.diff(np.array(torques), axis=0)) / robot.tau_max
    assert len(steps) > 1000
    assert steps.max() < 0.05


def test_same_seed_is_bit_identical_and_reset_equals_new(g1: RobotModel) -> None:
    def scenario(loop: ClosedLoop) -> NDArray[np.float64]:
        loop.apply_push((40.0, 20.0, 0.0), 0.1)
        loop.run(0.2)
        loop.command("wave")
        loop.run(0.5)
        return columns(loop).copy()

    one, other = ClosedLoop(g1, seed=7), ClosedLoop(g1, seed=7)
    first = scenario(one)
    np.testing.assert_array_equal(first, scenario(other))
    events = list(one.events)
    one.reset()
    np.testing.assert_array_equal(first, scenario(one))
    assert one.events == events
    other.reset(8)
    assert np.any(first != scenario(other))
    other.reset(7)
    np.testing.assert_array_equal(first, scenario(other))


@pytest.mark.parametrize("delay_ticks", [0, 2, 7])
def test_command_arrives_after_the_delay(g1: RobotModel, delay_ticks: int) -> None:
    controller = Wrapped(g1)
    loop = ClosedLoop(g1, delay_s=delay_ticks * DT, controller=controller)
    for _ in range(20):
        loop.step()
        in_force = loop._lockstep.servo.setpoint.tau
        np.testing.assert_allclose(in_force, controller.commands[-1 - delay_ticks].tau, atol=1e-12)
        assert np.any(in_force != controller.commands[-2 - delay_ticks].tau)


def test_profile_gives_the_default_delay(g1: RobotModel) -> None:
    controller = Wrapped(g1)
    loop = ClosedLoop(g1, controller=controller)
    loop.run(0.01)
    np.testing.assert_allclose(loop._lockstep.servo.setpoint.tau, controller.commands[-3].tau, atol=1e-12)


def test_slower_controller_runs_every_other_tick(g1: RobotModel) -> None:
    controller = Wrapped(g1)
    loop = ClosedLoop(g1, control_period_s=0.002, controller=controller)
    before = len(controller.states)
    loop.run(0.2)
    assert len(controller.states) - before == 100
    assert controller.states[-1].t - controller.states[-2].t == pytest.approx(0.002)
    assert loop.mode is Mode.STAND


def test_controller_sees_estimates_that_share_no_memory_with_the_plant(g1: RobotModel) -> None:
    controller = Wrapped(g1)
    loop = ClosedLoop(g1, controller=controller)
    state = controller.states[-1]
    assert type(state) is RobotState
    arrays = [*structs.asdict(state).values()] + [c.wrench for c in state.contacts]
    plant = [loop.data.qpos, loop.data.qvel, loop.data.sensordata, loop.data.xpos, loop.data.actuator_force]
    for array in arrays:
        if isinstance(array, np.ndarray):
            assert not any(np.shares_memory(array, inner) for inner in plant)
    assert np.any(state.q[7:] != loop.truth.q[7:])  # noise and quantisation are in it


def test_estimate_from_truth_is_the_truth(g1: RobotModel) -> None:
    loop = ClosedLoop(g1, estimate="truth", sensor_noise=False)
    truth = loop.truth
    loop.step()
    np.testing.assert_array_equal(loop.state.q, truth.q)


def test_log_rows_and_recording(g1: RobotModel) -> None:
    loop = ClosedLoop(g1, record_period_s=0.004)
    rows = len(loop.log)
    loop.run(1.0)
    log = loop.log
    assert len(log) - rows == 250
    assert np.diff(log.t) == pytest.approx(0.004)
    assert log.com.shape == (len(log), 3) and log.residual.shape == (len(log),)
    np.testing.assert_allclose(log.true_com[-1], loop.plant.com, atol=1e-3)
    np.testing.assert_allclose(log.wrenches[-1].reshape(2, 6)[:, 2].sum(), GRAVITY * g1.mass, rtol=0.02)
    assert set(log.modes) == {Mode.STAND} and set(log.statuses) == {SolveStatus.OPTIMAL}
    assert log.residual.max() < 1e-6
    recording = log.recording(loop.events)
    assert recording.robot == "g1" and recording.q.shape == (len(log), g1.nq)
    with pytest.raises(AttributeError, match="no column 'speed'; known: t, com"):
        log.speed  # noqa: B018


def test_log_can_be_off(g1: RobotModel) -> None:
    loop = ClosedLoop(g1, record=False)
    loop.run(0.1)
    assert len(loop.log) == 0


@pytest.mark.parametrize(
    ("options", "culprit"),
    [
        ({"estimate": "guess"}, "estimate: unknown 'guess'"),
        ({"delay_s": -0.001}, "delay_s"),
        ({"delay_s": float("nan")}, "delay_s"),
        ({"control_period_s": 0.0015}, "control_period_s"),
        ({"control_period_s": 0.0}, "control_period_s"),
        ({"seed": -1}, "seed"),
        ({"terrain": "lava"}, "terrain"),
        ({"friction": -1.0}, "friction"),
        ({"timestep": 0.0}, "timestep"),
        ({"robot": "r2d2"}, "r2d2"),
    ],
)
def test_bad_arguments_are_refused_by_name(g1: RobotModel, options: dict[str, object], culprit: str) -> None:
    with pytest.raises(ConfigError, match=culprit):
        ClosedLoop(**{"robot": g1, **options})  # type: ignore[arg-type]


def test_wrapped_controller_is_a_controller(g1: RobotModel) -> None:
    controller: Law = Wrapped(g1)
    assert not controller.motion_active
