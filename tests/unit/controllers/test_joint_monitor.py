"""Motors that do not follow their commands, encoders that are stuck, and what is no fault."""

import numpy as np
import pytest
from msgspec.structs import replace

from controllers.safety.joint_monitor import JointMonitor
from models.robot_model import RobotModel
from models.types import JointCommand, RobotState
from tests.support import standing


class Joints:
    """Joints that follow their commands, apart from one; their measurements are noisy."""

    def __init__(self, model: RobotModel) -> None:
        self.model, self.monitor = model, JointMonitor(model)
        self.rng = np.random.default_rng(0)
        self.joint = model.joint_index("left_knee_joint")
        self.command = JointCommand(model.posture("stand"), np.zeros(model.nj), np.zeros(model.nj))

    def state(self) -> RobotState:
        state = standing(self.model)
        v = np.append(np.zeros(6), 0.01 * self.rng.standard_normal(self.model.nj))
        commanded = (
            self.command.tau + self.model.kp * (self.command.q - state.q[7:]) + self.model.kd * (self.command.v - v[6:])
        )
        noise = 0.005 * self.model.tau_max * self.rng.standard_normal(self.model.nj)
        return replace(state, v=v, tau=commanded + noise)

    def run(self, ticks: int, **changed: float) -> int:
        """Ticks until a fault is found, at most so many; changed values of the one joint."""
        for tick in range(ticks):
            state = self.state()
            q, v, tau = state.q.copy(), state.v.copy(), state.tau.copy()
            tau[self.joint] = changed.get("given", tau[self.joint])
            q[7 + self.joint] = changed.get("q", q[7 + self.joint])
            v[6 + self.joint] = changed.get("v", v[6 + self.joint])
            self.monitor.step(replace(state, q=q, v=v, tau=tau), self.command)
            if self.monitor.fault:
                return tick + 1
        return ticks


@pytest.fixture
def joints(g1: RobotModel) -> Joints:
    joints = Joints(g1)
    assert joints.run(1100) == 1100
    return joints


def test_a_motor_that_gives_nothing_is_found_within_a_tenth_of_a_second(joints: Joints) -> None:
    joints.command.tau[joints.joint] = -30.0
    assert joints.run(200) == 200  # as long as it follows its command
    assert joints.run(100, given=0.0) < 60
    assert joints.monitor.fault.startswith("motor of 'left_knee_joint' gives")


def test_a_motor_that_gives_much_more_than_commanded_is_found(joints: Joints) -> None:
    assert joints.run(100, given=130.0) < 60
    joints.monitor.reset()
    assert joints.run(900, given=130.0) == 900  # the grace after a start


def test_a_stuck_encoder_is_found_whatever_it_says(joints: Joints) -> None:
    assert joints.run(100, q=0.5, v=0.02) == 51
    assert joints.monitor.fault == "encoder of 'left_knee_joint' stuck at 0.5000 rad for 0.05 s"


def test_a_position_that_stands_still_with_a_velocity_that_does_not_is_no_fault(joints: Joints) -> None:
    assert joints.run(300, q=0.5) == 300


def test_near_a_limit_the_drivers_give_less_than_commanded(joints: Joints) -> None:
    joints.command.tau[joints.joint] = -30.0
    assert joints.run(200, given=0.0, q=float(joints.model.q_upper[joints.joint]) - 0.01) == 200


def test_a_drive_that_follows_as_fast_as_it_may_is_no_fault(joints: Joints) -> None:
    model, joint = joints.model, joints.joint
    largest, step = model.tau_max[joint], 0.001 * model.tau_rate_max[joint]
    there = int(np.ceil(2.0 * largest / step))  # ticks from one end to the other
    given = 0.0
    for tick in range(40 * there):  # never long enough to get to the other end
        commanded = largest if tick % there < 0.65 * there else -largest
        joints.command.tau[joint] = commanded
        assert joints.run(1, given=given) == 1 and not joints.monitor.fault
        given += float(np.clip(commanded - given, -step, step))


def test_missing_samples_tell_nothing(joints: Joints) -> None:
    assert joints.run(100, given=float("nan"), q=float("nan"), v=float("nan")) == 100
    assert joints.run(100) == 100


def late(joints: Joints, ticks: int, noise: float = 1.0, every: int = 0) -> None:
    """Run 1.5 s with commands that arrive late; every so many samples the torques are missing, 0 for never."""
    sent: list[float] = []
    for tick in range(1500):  # a torque that swings as that of a hip does in a walk
        sent.append(30.0 * np.sin(2.0 * np.pi * 2.0 * 0.001 * tick) + noise * joints.rng.standard_normal())
        joints.command.tau[joints.joint] = sent[max(tick - ticks, 0)]
        state = joints.state()
        if every and tick % every == 0:
            state = replace(state, tau=np.full(joints.model.nj, np.nan))
        joints.command.tau[joints.joint] = sent[tick]
        joints.monitor.step(state, joints.command)


@pytest.mark.parametrize("ticks", [1, 3, 21, 35])
def test_a_late_command_is_no_fault_and_a_dead_motor_is_one_all_the_same(g1: RobotModel, ticks: int) -> None:
    joints = Joints(g1)
    late(joints, ticks, noise=20.0)
    assert joints.monitor.fault == ""
    assert joints.monitor.delay == pytest.approx(0.001 * ticks)
    joints.command.tau[joints.joint] = -30.0
    assert joints.run(150, given=0.0) < 110


@pytest.mark.parametrize("at_sample", [False, True])
def test_a_torque_that_is_evaluated_at_the_sample_needs_no_look_ahead(g1: RobotModel, at_sample: bool) -> None:
    joints, late_by, commands = Joints(g1), 5, []
    for tick in range(1500):
        phase = 2.0 * np.pi * 2.0 * 0.001 * tick
        state = standing(g1)
        q, v = state.q[7:] + 0.05 * np.sin(phase), np.full(g1.nj, 0.05 * 4.0 * np.pi * np.cos(phase))
        noise = joints.rng.standard_normal(g1.nj)
        commands.append(JointCommand(q, v, 0.1 * g1.tau_max * noise))
        old = commands[max(tick - late_by, 0)]
        tau = old.tau if at_sample else old.tau + g1.kp * (old.q - q) + g1.kd * (old.v - v)
        measured = replace(state, q=np.append(state.q[:7], q), v=np.append(np.zeros(6), v), tau=tau)
        joints.monitor.step(measured, commands[-1])
    assert joints.monitor.fault == ""
    assert joints.monitor.delay == pytest.approx(0.001 * late_by)
    assert joints.monitor.lookahead == pytest.approx(0.0 if at_sample else 0.0005 * (late_by - 1))


def test_missing_samples_do_not_change_the_delay(g1: RobotModel) -> None:
    joints = Joints(g1)
    late(joints, 3, noise=20.0, every=8)
    assert joints.monitor.delay == pytest.approx(0.003)


def test_a_command_that_is_not_finite_does_not_end_the_measurement(g1: RobotModel) -> None:
    joints = Joints(g1)
    joints.command.tau[joints.joint] = np.nan
    joints.monitor.step(standing(g1), joints.command)
    joints.command.tau[joints.joint] = 0.0
    late(joints, 5, noise=20.0)
    assert joints.monitor.delay == pytest.approx(0.005)


def test_constant_commands_do_not_change_the_delay(g1: RobotModel) -> None:
    joints = Joints(g1)
    assert joints.run(2000) == 2000
    assert joints.monitor.delay == pytest.approx(0.001)
