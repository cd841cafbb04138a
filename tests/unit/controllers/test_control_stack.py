"""The control stack: stages in order, the hand-over between the laws, recorded inputs, refusals."""

import math
from functools import partial

import numpy as np
import pytest

from controllers.input_log import InputLog, TickInputs
from controllers.stack import ControlStack, StackConfig
from models.calibration import Calibration
from models.errors import CommandError, PoiseError
from models.robot_model import RobotModel
from models.types import Mode, SensorData
from planners.gait.footsteps import Foothold
from planners.gait.route import Footstep
from tests.support import standing


def at_rest(model: RobotModel, t: float = 0.0) -> SensorData:
    """A robot that stands."""
    state, zero = standing(model, t), np.zeros(model.nj)
    wrenches = np.array([contact.wrench for contact in state.contacts])
    return SensorData(t, state.q[7:], zero, zero, np.zeros(3), np.array([0.0, 0.0, 9.81]), wrenches)


@pytest.fixture
def stack(g1: RobotModel) -> ControlStack:
    made = ControlStack(g1, log=InputLog())
    made.reset(at_rest(g1))
    return made


def run(stack: ControlStack, ticks: int, first: int = 1) -> None:
    for k in range(first, first + ticks):
        assert stack.step(at_rest(stack.robot, 0.001 * k), 0.001) is not None


def test_only_an_active_mode_is_answered(stack: ControlStack, g1: RobotModel) -> None:
    assert stack.mode is Mode.OFF and stack.step(at_rest(g1), 0.001) is None and stack.scheduled is None
    assert stack.arm().accepted and stack.mode is Mode.STAND
    command = stack.step(at_rest(g1, 0.001), 0.001)
    assert command is not None and np.isfinite(command.tau).all()
    assert stack.scheduled == (True, True)
    assert stack.supervise(0.001) is Mode.STAND
    assert stack.supervise(1.0) is Mode.DAMP  # no sample for so long
    assert "state estimate older" in stack.supervisor.faults[0]
    assert stack.step(at_rest(g1, 1.0), 0.001) is None


@pytest.mark.parametrize("wait", [0.0, 5.0])
def test_a_robot_that_has_just_become_active_is_supervised_before_its_first_tick(
    stack: ControlStack, g1: RobotModel, wait: float
) -> None:
    for start in (0.0, 20.0):  # a second run of the same stack, too
        stack.reset(at_rest(g1, start))
        if wait:
            stack.step(at_rest(g1, start + wait), 0.001, standing(g1, start + wait))  # off
        assert stack.arm().accepted
        assert stack.supervise(start + wait) is Mode.STAND and not stack.supervisor.faults
        assert stack.supervise(start + wait + 1.0) is Mode.DAMP


def test_a_mode_decides_whether_the_gait_follows_its_commands(stack: ControlStack) -> None:
    stack.arm()
    run(stack, 5)
    assert not stack.gait_active
    assert stack.command("walk").accepted and stack.walking
    assert stack.gait_active  # until it has settled
    run(stack, 5, 6)
    stack.set_velocity(0.3, 0.0, 0.0)
    run(stack, 5, 11)
    assert stack.gait.walking
    stack.enter(Mode.STAND)
    assert not stack.walking and not stack.gait_active
    stack.enter(Mode.WALK)
    assert stack.gait.steps == 0 and not stack.motion_active
    stack.enter(Mode.DAMP)
    assert not stack.walking


@pytest.mark.parametrize("end", ["stop", "command", "reset"])
def test_a_velocity_is_repeated_until_the_robot_is_stopped_or_reset(stack: ControlStack, end: str) -> None:
    log = stack.log
    assert log is not None
    stack.arm()
    run(stack, 1)
    stack.command("walk")
    stack.hold_velocity(0.3, 0.0, 0.0)
    run(stack, 2, 2)
    assert stack.gait.state.command.moves
    if end == "reset":
        stack.reset(at_rest(stack.robot, 0.003))
        stack.arm()
        stack.command("walk")
    elif end == "stop":
        stack.stop()
    else:
        stack.command("stop")
    run(stack, 2, 4)
    assert not stack.gait.state.command.moves
    log.take(1)
    stack.supervisor.request(Mode.WALK)  # goes on
    stack.hold_velocity(0.3, 0.0, 0.0)
    assert ("hold_velocity", 0.3, 0.0, 0.0) in TickInputs.read(log.take(2)).before
    run(stack, 2, 6)
    assert stack.gait.state.command.moves


@pytest.mark.parametrize("hold", ["", "the battery is empty"])
def test_no_walk_is_commanded_while_the_supervisor_ends_one(stack: ControlStack, hold: str) -> None:
    stack.arm()
    run(stack, 1)
    stack.command("forward")
    run(stack, 2, 2)
    if hold:
        stack.supervise(0.003, hardware=(hold,))
    else:
        stack.command("stop")
    for command in (
        partial(stack.set_velocity, 0.1, 0.0, 0.0),
        partial(stack.hold_velocity, 0.0, 0.0, 0.1),
        partial(stack.walk_to, Foothold(0.5, 0.0, 0.0)),
        partial(stack.take_steps, [Footstep(0, Foothold(0.1, 0.1, 0.0))]),
    ):
        with pytest.raises(CommandError, match=hold or "comes to a standstill"):
            command()
    stack.set_velocity(0.0, 0.0, 0.0)
    stack.hold_velocity(0.0, 0.0, 0.0)
    run(stack, 2, 4)
    assert not stack.gait.state.command.moving
    stack.supervise(0.005)  # the hold has ended
    assert stack.command("walk").accepted
    stack.set_velocity(0.1, 0.0, 0.0)
    assert stack.gait.state.command.moves


def test_a_motion_goes_to_the_law_that_runs(stack: ControlStack) -> None:
    stack.arm()
    run(stack, 5)
    assert stack.command("wave").accepted and stack.law.motion_active and stack.motion_active
    stack.stop_motion()
    stack.supervisor.reset(Mode.STAND)
    assert stack.command("walk").accepted and not stack.motion_active
    run(stack, 2, 6)
    assert stack.command("wave").accepted and stack.motion_active
    stack.enter(Mode.STAND)
    stack.enter(Mode.WALK)
    assert not stack.motion_active  # a new walk begins without


def test_without_a_gait_planner_the_standing_law_goes_on(g1: RobotModel) -> None:
    stack = ControlStack()
    stack.build_law(g1, StackConfig())
    stack.set_state(standing(g1))
    stack.reset_law(stack.state)
    stack.enter(Mode.WALK)
    assert not stack.walking and not stack.gait_active
    assert stack.control(0.001) is not None
    with pytest.raises(PoiseError, match="no gait planner"):
        stack.set_velocity(0.1, 0.0, 0.0)
    with pytest.raises(PoiseError, match="no supervisor"):
        stack.command("wave")


def test_inputs_are_recorded_and_refused_ones_are_not(stack: ControlStack) -> None:
    log = stack.log
    assert log is not None
    stack.arm()
    run(stack, 1)
    start = TickInputs.read(log.take(1))
    assert [entry[0] for entry in start.before] == ["start", "reset", "mode", "dt"]
    assert [entry[0] for entry in start.after] == ["law_dt"]
    assert stack.command("walk").accepted
    stack.set_velocity(0.1, 0.0, 0.2)
    with pytest.raises(CommandError):
        stack.set_velocity(math.nan, 0.0, 0.0)
    stack.stop()
    stack.walk_to(Foothold(0.5, 0.1, 0.2))
    for velocity in ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.1, 0.0, 0.0)):
        stack.hold_velocity(*velocity)
    stack.stop_motion()
    stack.set_gain("balance.dcm_gain", 5.5)
    assert TickInputs.read(log.take(2)).before == (
        ("mode", "walk"),
        ("velocity", 0.1, 0.0, 0.2),
        ("stop",),
        ("walk_to", 0.5, 0.1, 0.2, 0.0),
        ("hold_velocity", 0.0, 0.0, 0.0),
        ("hold_velocity", 0.1, 0.0, 0.0),
        ("stop_motion",),
        ("gain", "balance.dcm_gain", 5.5),
    )


def test_a_calibration_corrects_from_the_next_start_on(stack: ControlStack, g1: RobotModel) -> None:
    offsets = np.full(g1.nj, 0.01)
    none = Calibration.none(g1)
    stack.calibration = Calibration("g1", none.gyro_bias, none.accel_bias, offsets, none.wrench_offsets, np.ones(2))
    stack.step(at_rest(g1), 0.001)
    np.testing.assert_array_equal(stack.sensors.q, at_rest(g1).q)
    stack.reset(at_rest(g1))
    np.testing.assert_allclose(stack.sensors.q, at_rest(g1).q - offsets)
    assert stack.raw is not None and (stack.raw.q == at_rest(g1).q).all()
