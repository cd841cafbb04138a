"""The start of a real robot: each state, what it waits for, how it is left; with made-up inputs, without a robot."""

import numpy as np
import pinocchio as pin
import pytest

from bridge.driver.foot_load import FootLoad
from bridge.driver.start_commands import StartState
from bridge.plants.base import standing_torques
from models.constants import GRAVITY
from models.errors import CommandError
from models.robot_model import RobotModel
from models.types import SensorData
from tests.start_bench import Bench


@pytest.mark.parametrize("knee", [0.1, 0.3, 0.5])
def test_the_load_of_bent_legs_counts_beyond_its_error(g1: RobotModel, knee: float) -> None:
    load, q, legs = FootLoad(g1), np.zeros(g1.nj), [foot.joint_ids_v for foot in g1.feet]
    for leg in legs:
        q[np.array(leg) - 6] = [-0.5 * knee, 0.0, 0.0, knee, -0.5 * knee, 0.0]
    zero, up, feet = np.zeros(g1.nj), np.array([0.0, 0.0, GRAVITY]), np.full((2, 6), np.nan)
    standing, off = standing_torques(g1, q, g1.data()), np.zeros(g1.nj)
    off[np.array(legs)[:, 3] - 6] = 0.2  # friction of the knees
    hanging = pin.computeGeneralizedGravity(g1.pin, g1.data(), np.concatenate([[0, 0, 0, 0, 0, 0, 1], q]))[6:]
    load.update(SensorData(0.0, q, zero, standing, zero[:3], up, feet))
    assert load.load == pytest.approx(1.0, abs=0.02) and load.load - load.error > 0.5
    load.update(SensorData(0.0, q, zero, hanging + off, zero[:3], up, feet))
    assert abs(load.load) < load.error


def test_nothing_is_commanded_before_the_release(bench: Bench) -> None:
    for state in (StartState.LISTEN, StartState.GANTRY, StartState.RELEASE):
        bench.reach(state)
        assert bench.tick() is None and not bench.startup.commands
    bench.reach(StartState.DAMP)
    command = bench.tick()
    assert command is not None and command.kp is not None and not command.kp.any()


def test_listening_names_the_failed_check(bench: Bench) -> None:
    bench.inputs["findings"] = ("lowstate at 250 Hz instead of 500 Hz",)
    bench.run(5.0)
    assert bench.startup.state is StartState.LISTEN and "250 Hz" in bench.startup.waits_for
    bench.inputs["findings"] = ()
    bench.run(1.1)
    assert bench.startup.state is StartState.GANTRY and "confirm_gantry" in bench.startup.waits_for
    bench.inputs["findings"] = ("crc",)
    bench.tick()
    assert bench.startup.state is StartState.LISTEN


def test_each_service_is_refused_in_other_states(bench: Bench) -> None:
    own = {
        StartState.GANTRY: "confirm_gantry", StartState.HANGING: "lower", StartState.STAND: "relax",
        StartState.DAMPED: "prepare",
    }  # fmt: skip
    for state in StartState:
        fresh = Bench(bench.model)
        if state is StartState.DAMPED:
            fresh.reach(StartState.HELD)
            fresh.startup.damp("test")
        else:
            fresh.reach(state)
        for name in set(own.values()) - {own.get(state)}:
            with pytest.raises(CommandError, match=rf"{name} refused in state '{state}'"):
                getattr(fresh.startup, name)()
            assert fresh.startup.state is state


@pytest.mark.parametrize("state", list(StartState)[3:-1])
def test_every_state_after_the_release_may_be_left_to_damping(bench: Bench, state: StartState) -> None:
    bench.reach(state)
    bench.inputs["stop"] = "button B"
    command = bench.tick()
    assert bench.startup.state is StartState.DAMPED and "button B" in bench.startup.waits_for
    bench.inputs["stop"] = ""
    bench.run(0.2)
    command = bench.tick()
    assert command is not None and command.kp is not None and command.kd is not None
    assert not command.kp.any() and not command.tau.any() and command.kd.min() > 0.0


@pytest.mark.parametrize("state", [StartState.PREPARE, StartState.HELD, StartState.STAND])
@pytest.mark.parametrize(
    ("leap", "inputs", "reason"),
    [(0.1, {}, "between two ticks of the driver"), (0.0, {"jumped": True, "stop": "the clock"}, "the clock")],
)
def test_a_driver_that_hung_damps_from_the_measured_torques(
    bench: Bench, state: StartState, leap: float, inputs: dict[str, object], reason: str
) -> None:
    """Which are zero here: the guard has damped."""
    bench.reach(state)
    bench.run(0.1)
    bench.t += leap
    bench.inputs |= inputs
    command = bench.tick()
    assert bench.startup.state is StartState.DAMPED and reason in bench.startup.reason
    assert command is not None and command.kp is not None
    assert not command.kp.any() and not command.tau.any()


def test_a_stop_during_the_release_damps_as_soon_as_the_robots_own_controller_has_ended(g1: RobotModel) -> None:
    bench = Bench(g1, own="Unitree's controller")
    bench.reach(StartState.RELEASE)
    bench.inputs["stop"] = "button B"
    assert bench.tick() is None  # two programs would command the robot in turns
    bench.inputs["stop"] = ""
    assert bench.tick() is None
    assert bench.startup.waits_for == "Unitree's controller to end, then it is damped (button B)"
    assert "use its stop function" in bench.startup.damp("again")
    bench.inputs["vendor"] = ""
    bench.run(0.11)
    assert bench.tick() is not None and bench.startup.state is StartState.DAMPED
    assert "button B" in bench.startup.waits_for


@pytest.mark.parametrize("stop", ["motor temperature", ""])
def test_a_stop_during_the_release_is_kept_when_a_check_fails(g1: RobotModel, stop: str) -> None:
    bench = Bench(g1, own="Unitree's controller")
    bench.reach(StartState.RELEASE)
    bench.startup.damp("button B")
    bench.inputs |= {"findings": ("motor temperature",), "stop": stop, "vendor": "ai" if stop else ""}
    bench.run(5.1)
    assert bench.startup.state is StartState.LISTEN and "then it is damped (button B)" in bench.startup.waits_for
    bench.inputs |= {"vendor": "", "foreign": True}
    bench.run(0.3)
    assert bench.startup.state is StartState.LISTEN
    bench.inputs["foreign"] = False
    bench.run(0.11)
    assert bench.startup.state is StartState.DAMPED and "button B" in bench.startup.waits_for


@pytest.mark.parametrize("state", [StartState.LISTEN, StartState.GANTRY])
def test_before_the_release_a_stop_begins_again_and_commands_nothing(bench: Bench, state: StartState) -> None:
    bench.reach(state)
    with pytest.raises(CommandError, match="nothing is commanded yet"):
        bench.startup.damp("test")
    bench.inputs["stop"] = "button B"
    assert bench.tick() is None and bench.startup.state is StartState.LISTEN


def test_a_controller_that_does_not_end_is_named(bench: Bench) -> None:
    bench.reach(StartState.RELEASE)
    bench.run(5.1)
    assert bench.startup.state is StartState.LISTEN
    bench.run(1.1)
    assert bench.startup.state is StartState.GANTRY and "'ai' is active" in bench.startup.waits_for


def test_another_program_ends_the_release_without_a_command(bench: Bench) -> None:
    bench.reach(StartState.RELEASE)
    bench.inputs |= {"vendor": "", "findings": ("lowcmd of another program",), "stop": "lowcmd of another program"}
    assert bench.tick() is None
    assert bench.startup.state is StartState.LISTEN and bench.startup.waits_for == "lowcmd of another program"


def test_a_controller_that_becomes_active_is_left_alone_once_the_robot_is_damped(bench: Bench) -> None:
    bench.reach(StartState.STAND)
    bench.inputs |= {"vendor": "ai", "stop": "the vendor's controller 'ai' is active again"}
    command = bench.tick()
    assert bench.startup.state is StartState.DAMPED and command is not None
    bench.run(0.2)
    assert bench.startup.commands  # the torque fades first
    bench.inputs["stop"] = ""  # the drivers stop for this reason while they command
    bench.run(0.2)
    assert bench.startup.state is StartState.LISTEN and bench.tick() is None
    bench.run(1.1)
    assert bench.startup.state is StartState.GANTRY and "'ai' became active" in bench.startup.waits_for


def test_moving_joints_are_damped_before_the_ramp(bench: Bench) -> None:
    bench.reach(StartState.DAMP)
    fast = np.zeros(bench.model.nj)
    fast[3] = 1.0
    for _ in range(1500):
        bench.tick(fast)
    assert bench.startup.state is StartState.DAMP
    bench.run(1.1)
    assert bench.startup.state is StartState.PREPARE


def test_a_joint_that_does_not_follow_the_ramp_is_named(bench: Bench) -> None:
    bench.q = bench.model.posture("stand") + 1.0
    bench.reach(StartState.DAMP)
    bench.run(1.1)
    bench.driver = bench.driver
    stuck = bench.q.copy()
    while bench.startup.state is StartState.PREPARE:
        bench.tick()
        bench.q[3] = stuck[3]
    assert bench.startup.state is StartState.DAMPED and "'left_knee_joint'" in bench.startup.reason


@pytest.mark.parametrize(
    ("load", "tilt", "stands"), [(0.5, 0.0, False), (1.3, 0.0, False), (1.0, 0.5, False), (0.95, 0.05, True)]
)
def test_it_stands_by_load_and_tilt(bench: Bench, load: float, tilt: float, stands: bool) -> None:
    bench.reach(StartState.HELD)
    bench.inputs |= {"load": load, "tilt": tilt}
    bench.run(3.0)
    assert (bench.startup.state is StartState.LOADED) == stands


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"tilt": 1.5}, r"tilted by 1\.50 rad, 0\.2 rad at most"),
        ({"tilt": float("nan")}, "tilt of the base is not known yet"),
        ({"load": 0.9}, "the feet bear 90% of the weight, 30% at most"),
    ],
)
def test_a_robot_that_does_not_hang_upright_is_not_released_and_does_not_move(
    g1: RobotModel, changed: dict[str, float], reason: str
) -> None:
    hanging = {"tilt": 0.0, "load": 0.0}
    bench = Bench(g1)
    bench.reach(StartState.GANTRY)
    bench.inputs |= changed
    bench.run(2.0)
    with pytest.raises(CommandError, match=f"confirm_gantry refused: .*{reason}.*; hang the robot upright"):
        bench.startup.confirm_gantry()
    assert bench.startup.state is StartState.GANTRY
    bench.inputs |= hanging
    bench.run(2.0)
    bench.reach(StartState.PREPARE)
    bench.inputs |= changed
    bench.run(2.0)
    assert bench.startup.state is StartState.DAMPED
    with pytest.raises(CommandError, match=f"prepare refused: .*{reason}.*; hang the robot upright"):
        bench.startup.prepare()
    bench.inputs |= hanging
    bench.run(2.0)
    bench.startup.prepare()
    bench.run(5.0)
    assert bench.startup.state is StartState.HANGING


def test_a_robot_that_is_lifted_again_does_not_stand(bench: Bench) -> None:
    bench.reach(StartState.LOADED)
    bench.inputs["load"] = 0.1
    bench.run(2.0)
    assert bench.startup.state is StartState.HELD and not bench.startup.armable


def test_damped_robots_start_again_from_the_gantry(bench: Bench) -> None:
    bench.reach(StartState.STAND)
    bench.startup.damp("test")
    bench.run(1.0)
    bench.inputs |= {"load": 0.0, "driven": False}
    bench.run(1.0)
    bench.startup.prepare()
    bench.run(5.0)
    assert bench.startup.state is StartState.HANGING


def test_a_robot_without_a_controller_may_be_damped_before_the_release(g1: RobotModel) -> None:
    for pressed in (False, True):
        bench = Bench(g1)
        bench.inputs["vendor"] = ""
        bench.inputs["doubts"] = ("mode_machine 4 is another robot",)
        bench.tick()
        with pytest.raises(CommandError, match="damp refused: mode_machine 4 is another robot"):
            bench.startup.damp("test")
        bench.inputs["pressed"] = "button B"
        assert bench.tick() is None
        bench.inputs |= {"doubts": (), "pressed": "button B" if pressed else ""}
        if not pressed:
            assert bench.tick() is None
            bench.startup.damp("button B")
        command = bench.tick()
        assert bench.startup.state is StartState.DAMPED and "button B" in bench.startup.waits_for
        assert command is not None and command.kp is not None and not command.kp.any()


def test_after_a_crash_the_stop_button_damps_while_the_controller_is_unknown(g1: RobotModel) -> None:
    for vendor, damped in ((None, True), ("ai", False)):
        bench = Bench(g1, crashed=True)
        bench.inputs |= {"vendor": vendor, "doubts": ("no answer",), "pressed": "button B", "stop": "button B"}
        bench.tick()
        assert (bench.startup.state is StartState.DAMPED) == damped


def test_after_a_crash_only_damping_is_possible(g1: RobotModel) -> None:
    bench = Bench(g1, crashed=True)
    bench.inputs["vendor"] = ""
    bench.run(5.0)
    command = bench.tick()
    assert bench.startup.state is StartState.DAMPED
    assert command is not None and command.kp is not None and not command.kp.any()
    with pytest.raises(CommandError, match="start it again"):
        bench.startup.prepare()
    for act in (bench.startup.confirm_gantry, bench.startup.lower):
        with pytest.raises(CommandError, match="refused in state 'damped'"):
            act()


@pytest.mark.parametrize(
    "unknown",
    [{"vendor": None, "doubts": ("the motion switcher of the robot does not answer",)},
     {"vendor": "", "doubts": ("mode_machine 4 is another robot",)}],
)  # fmt: skip
def test_after_a_crash_nothing_is_commanded_before_robot_and_controller_are_known(
    g1: RobotModel, unknown: dict[str, object]
) -> None:
    bench = Bench(g1, crashed=True)
    bench.inputs |= unknown
    for _ in range(4000):
        assert bench.tick() is None
        if bench.t < 4.0:
            assert "start damp" not in bench.startup.waits_for
    assert str(unknown["doubts"][0]) in bench.startup.waits_for  # type: ignore[index]
    assert "secure it with its rope, then switch it off, or, if" in bench.startup.waits_for
    bench.startup.damp("start/damp was called")  # the operator sees the robot
    assert bench.tick() is not None and bench.startup.state is StartState.DAMPED


def test_after_a_crash_a_robot_under_its_own_controller_is_left_alone(g1: RobotModel) -> None:
    bench = Bench(g1, crashed=True)
    for _ in range(600):
        assert bench.tick() is None
    assert bench.startup.state is StartState.GANTRY and "'ai' is active after a crash" in bench.startup.waits_for
    with pytest.raises(CommandError, match="damp refused: nothing is commanded yet"):
        bench.startup.damp("test")
    bench.reach(StartState.HANGING)
