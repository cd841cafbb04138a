"""The start of a real robot: each state, what it waits for, how it is left; with made-up inputs, without a robot."""

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from msgspec import structs

from bridge.driver.foot_load import FootLoad
from bridge.driver.start_commands import StartState
from bridge.driver.startup import StartInputs, Startup
from bridge.plants.base import standing_torques
from controllers.joints.joint_servo import drive_torque
from models.constants import GRAVITY
from models.errors import CommandError
from models.robot_model import RobotModel
from models.types import JointCommand, SensorData, Vector

DT = 0.002


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


class Bench:
    """Feeds a start; the joints follow the stiff hold perfectly."""

    def __init__(self, model: RobotModel, **options: Any) -> None:
        self.model, self.startup = model, Startup(model, **options)
        self.q = model.posture("stand") + 0.3
        self.t = 0.0
        self.inputs: dict[str, object] = {"vendor": "ai"}
        self.driver = JointCommand(model.posture("stand"), np.zeros(model.nj), np.full(model.nj, 3.0))

    def sensors(self, v: Vector | None = None) -> SensorData:
        zero = np.zeros(self.model.nj)
        velocity = zero if v is None else v
        return SensorData(self.t, self.q, velocity, zero, np.zeros(3), np.array([0, 0, 9.81]), np.full((2, 6), np.nan))

    def tick(self, v: Vector | None = None) -> JointCommand | None:
        self.t += DT
        self.startup.update(StartInputs(self.sensors(v), **self.inputs))  # type: ignore[arg-type]
        command = self.startup.command(self.sensors(v), self.driver)
        if command is not None and command.kp is not None and command.kp.any():
            self.q = command.q
        return command

    def run(self, time: float) -> None:
        for _ in range(round(time / DT)):
            self.tick()

    def reach(self, state: StartState) -> None:
        """Through the normal sequence to a state."""
        steps = {
            StartState.GANTRY: lambda: self.run(1.1),
            StartState.RELEASE: self.startup.confirm_gantry,
            StartState.DAMP: lambda: (self.inputs.update(vendor=""), self.run(0.11)),
            StartState.PREPARE: lambda: self.run(1.1),
            StartState.HANGING: lambda: self.run(3.1),
            StartState.HELD: self.startup.lower,
            StartState.LOADED: lambda: (self.inputs.update(load=0.98), self.run(2.0)),
            StartState.STAND: lambda: (self.inputs.update(driven=True), self.tick()),
            StartState.RELAX: self.startup.relax,
        }
        passed = [StartState.LISTEN, *steps].index(self.startup.state)
        for reached, act in list(steps.items())[passed:]:
            if self.startup.state is state:
                return
            act()
            assert self.startup.state is reached, self.startup.waits_for
        assert self.startup.state is state


@pytest.fixture
def bench(g1: RobotModel) -> Bench:
    return Bench(g1)


def test_nothing_is_commanded_before_the_release(bench: Bench) -> None:
    for state in (StartState.LISTEN, StartState.GANTRY, StartState.RELEASE):
        bench.reach(state)
        assert bench.tick() is None and not bench.startup.commands
    bench.reach(StartState.DAMP)
    command = bench.tick()
    assert command is not None and command.kp is not None and not command.kp.any()


def test_a_relaxing_robot_fades_from_the_last_command_with_its_gains_to_damping(bench: Bench) -> None:
    bench.reach(StartState.STAND)
    bench.run(1.0)
    startup, v = bench.startup, 0.1 * np.ones(bench.model.nj)
    startup.relax()
    torques = []
    while startup.state is StartState.RELAX:
        command = bench.tick(v)
        assert command is not None
        torques.append(drive_torque(bench.model, command, bench.q - 0.1, v))
        assert startup.state is not StartState.RELAX or startup.waits_for.startswith("the robot to sink, ")
    assert len(torques) == pytest.approx(startup.config.relax_time / DT, abs=2)
    first = drive_torque(bench.model, bench.driver, bench.q - 0.1, v)
    np.testing.assert_allclose(torques[0], first, rtol=0.01)
    np.testing.assert_allclose(torques[len(torques) // 2], 0.5 * (first - bench.model.kd * v), rtol=0.02)
    assert startup.state is StartState.DAMPED and "lowered" in startup.waits_for


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


def test_a_stop_during_the_release_damps_as_soon_as_the_robots_own_controller_has_ended(g1: RobotModel) -> None:
    bench = Bench(g1, own="Unitree's controller")
    bench.reach(StartState.RELEASE)
    bench.inputs["stop"] = "button B"
    assert bench.tick() is None  # two programs would command the robot in turns
    bench.inputs["stop"] = ""
    assert bench.tick() is None
    assert bench.startup.waits_for == "Unitree's controller to end, then it is damped (button B)"
    assert "use its own stop" in bench.startup.damp("again")
    bench.inputs["vendor"] = ""
    bench.run(0.11)
    assert bench.tick() is not None and bench.startup.state is StartState.DAMPED
    assert "button B" in bench.startup.waits_for


def test_in_the_air_the_stiff_hold_uses_half_of_the_torque_and_gives_way_to_what_holds_a_joint(bench: Bench) -> None:
    bench.reach(StartState.HANGING)
    away = bench.q.copy()
    away[3] -= 0.5
    for held, damped in ((0.5, False), (0.7, True)):
        away[3] = bench.q[3] - held
        sensors = structs.replace(bench.sensors(), q=away)
        command = bench.startup.command(sensors, bench.driver)
        assert command is not None
        torque = drive_torque(bench.model, command, away, np.zeros(bench.model.nj))
        assert torque[3] == pytest.approx(0.5 * bench.model.tau_max[3])
        bench.startup.update(StartInputs(sensors, vendor=""))
        assert (bench.startup.state is StartState.DAMPED) == damped


def test_the_bound_in_the_air_is_of_the_torque_that_reduced_gains_give(g1: RobotModel) -> None:
    def executed(command: JointCommand) -> JointCommand:
        assert command.kp is not None and command.kd is not None
        return structs.replace(command, kp=np.minimum(command.kp, g1.kp), kd=np.minimum(command.kd, g1.kd))

    bench = Bench(g1, executed=executed)
    bench.reach(StartState.HANGING)
    q, v = bench.q - 0.3 * g1.tau_max / g1.kp, np.zeros(g1.nj)  # four times that with the gains of the stiff hold
    command = bench.startup.command(structs.replace(bench.sensors(), q=q), bench.driver)
    assert command is not None
    np.testing.assert_allclose(drive_torque(g1, executed(command), q, v), 0.3 * g1.tau_max)


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


def test_the_ramp_is_slow_and_ends_in_the_standing_posture(bench: Bench) -> None:
    bench.q = bench.model.posture("stand") + 1.2
    bench.reach(StartState.DAMP)
    bench.run(1.1)
    assert bench.startup.state is StartState.PREPARE
    positions = []
    while bench.startup.state is StartState.PREPARE:
        bench.tick()
        positions.append(bench.q)
    assert np.abs(np.diff(positions, axis=0)).max() / DT < 1.6 * bench.startup.config.ramp_speed
    assert np.allclose(bench.q, bench.model.posture("stand"), atol=1e-6)


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


def test_gains_fade_without_a_step_of_torque(bench: Bench) -> None:
    bench.reach(StartState.LOADED)
    q, v = bench.model.posture("stand") + 0.02, np.full(bench.model.nj, 0.1)
    bench.q = q
    before = bench.startup.command(bench.sensors(v), bench.driver)
    assert before is not None
    torques = [drive_torque(bench.model, before, q, v)]
    bench.inputs["driven"] = True
    for _ in range(300):
        bench.t += DT
        bench.q = q
        bench.startup.update(StartInputs(bench.sensors(v), vendor="", load=1.0, driven=True))
        command = bench.startup.command(bench.sensors(v), bench.driver)
        assert command is not None
        torques.append(drive_torque(bench.model, command, q, v))
    end = drive_torque(bench.model, bench.driver, q, v)
    assert np.allclose(torques[-1], end) and not bench.startup.fading
    step = np.abs(np.diff(torques, axis=0)).max(axis=0)
    assert (step <= 1.6 * np.abs(end - torques[0]) * DT / bench.startup.config.fade + 1e-9).all()


def test_after_a_stop_the_last_torque_fades(bench: Bench) -> None:
    bench.reach(StartState.STAND)
    bench.run(1.0)
    held = bench.startup.command(bench.sensors(), bench.driver)
    assert held is not None
    last = drive_torque(bench.model, held, bench.q, np.zeros(bench.model.nj))
    bench.startup.damp("test")
    first = bench.startup.command(bench.sensors(), bench.driver)
    assert first is not None and np.allclose(first.tau, last)
    bench.run(0.16)
    end = bench.startup.command(bench.sensors(), bench.driver)
    assert end is not None and not end.tau.any()


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
    assert "hold it by its rope, then switch it off, or poise start damp" in bench.startup.waits_for
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


def test_the_torque_that_a_killed_driver_left_fades_from_the_first_command_on(g1: RobotModel) -> None:
    startup, three, zero = Startup(g1, crashed=True), np.zeros(3), np.zeros(g1.nj)

    def torque(t: float, tau: float, stale: float) -> float | None:
        sensors = SensorData(t, zero, zero, np.full(g1.nj, tau), three, three, np.full((2, 6), np.nan))
        startup.update(StartInputs(sensors, vendor="", stale=stale))
        command = startup.command(sensors, JointCommand.torque(zero))
        return None if command is None else float(command.tau[0])

    for stale in (0.1, 0.5):
        assert torque(0.0, np.nan, stale) is None  # before the first sample
    t, ramp = DT, 0.15
    while (first := torque(t, 5.0, 0.0)) is None:
        t += DT
    assert first == 5.0 and t == pytest.approx(startup.config.quiet_time, abs=2 * DT)
    assert torque(t, 5.0, 0.1) == pytest.approx(5.0 * (1.0 - 0.1 / ramp))  # without samples
    assert torque(t, 5.0, 0.2) == 0.0


def test_the_torques_of_the_load_hold_the_weight(g1: RobotModel) -> None:
    """Virtual work: for a motion with both soles flat on the floor, tau' dq = m g dz of the CoM."""
    data = g1.data()
    joints = g1.posture("stand").copy()
    motion = np.zeros(g1.nj)
    for side in ("left", "right"):
        for joint, share in (("hip_pitch", -1.0), ("knee", 2.0), ("ankle_pitch", -1.0)):
            motion[g1.joint_index(f"{side}_{joint}_joint")] = share
    motion[g1.joint_index("waist_pitch_joint")] = 0.5

    def height(step: float) -> float:
        return float(pin.centerOfMass(g1.pin, data, g1.planted(joints + step * motion, data))[2])

    torques = standing_torques(g1, joints, data)
    work = GRAVITY * g1.mass * (height(1e-5) - height(-1e-5)) / 2e-5
    assert torques @ motion == pytest.approx(work, rel=1e-4) and abs(work) > 10.0


def test_the_stiff_hold_includes_them_by_the_share_of_the_load(bench: Bench) -> None:
    bench.reach(StartState.HANGING)
    bench.inputs.update(load=1.0)
    command = bench.tick()
    assert command is not None and not command.tau.any()
    bench.inputs.update(load=0.5)
    bench.startup.lower()
    bench.run(2.0)
    command = bench.tick()
    assert command is not None
    expected = standing_torques(bench.model, bench.q, bench.model.data())
    np.testing.assert_allclose(command.tau, 0.5 * expected, rtol=1e-3)
