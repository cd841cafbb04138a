"""A robot behind ros2_control in one process, in lockstep: start, stand, wave, walk, faults, and what is said of them.

The serialised messages of broadcasters and controllers pass between both sides as on the network.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")

from bridge.driver.start_commands import StartState
from bridge.hardware_loop import Process, Ros2ControlLoop
from bridge.plants.ros2_control.commands import GUARD, command_codec
from bridge.plants.ros2_control.config import COMMAND, FEET, IMU, JOINTS, Source
from bridge.plants.ros2_control.plant import Ros2ControlPlant
from bridge.plants.ros2_control.simulated import ControlledRobot, DirectControlLink
from models.errors import CommandError, ConfigError, MessageError
from models.robot_model import RobotModel
from models.types import JointCommand, Mode
from tests.gantry import started

pytestmark = [pytest.mark.ros, pytest.mark.long]
AFTERWARDS = (StartState.RELAX, StartState.DAMPED)


def loop_of(folder: Path, **options: Any) -> Ros2ControlLoop:
    try:
        return Ros2ControlLoop(folder / "marker", **options)
    except MessageError as error:
        pytest.skip(str(error))


@pytest.fixture
def standing(tmp_path: Path) -> Ros2ControlLoop:
    return started(loop_of(tmp_path))


TALOS = {"robot": "talos", "laws": "talos_hardware"}
CASES = [
    ({"command": "effort"}, 0.4),
    pytest.param({"command": "effort", "delay": 1}, 0.4, marks=pytest.mark.slow),
    pytest.param({"command": "effort", "delay": 4}, 0.4, marks=pytest.mark.slow),
    pytest.param({"command": "effort", "delay": 5}, 0.4, marks=pytest.mark.slow),
    pytest.param({"command": "effort", "delay": 6}, 0.4, marks=pytest.mark.slow),
    pytest.param({"command": "effort", "laws": "g1"}, 0.4, marks=pytest.mark.slow),  # with sensors in the feet
    pytest.param({"command": "pvt"}, 0.4, marks=pytest.mark.slow),
    pytest.param({"command": "pvt", "delay": 8}, 0.4, marks=pytest.mark.slow),
    pytest.param({"command": "pvt", "rate": 500.0}, 0.4, marks=pytest.mark.slow),
    pytest.param({"command": "feedback"}, 0.4, marks=pytest.mark.slow),
    pytest.param({"command": "feedback", "free_flyer": True, **TALOS}, 0.3, marks=pytest.mark.slow),
    pytest.param({"command": "effort", **TALOS}, 0.3, marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("options", "speed"), CASES)
def test_it_starts_stands_waves_and_walks(tmp_path: Path, options: dict[str, Any], speed: float) -> None:
    loop = loop_of(tmp_path, seed=3, **options)
    loop.start()
    loop.unhook()
    assert loop.history == [str(each) for each in StartState if each not in AFTERWARDS]
    before = loop.side.base
    loop.run(2.0)
    assert np.abs(loop.side.base - before).max() < 0.005
    loop.command("wave")
    loop.run(7.0)
    assert loop.stack.mode is Mode.STAND
    begin, estimated = loop.side.base, loop.stack.state.q[:2].copy()
    loop.command("walk")
    loop.stack.set_velocity(speed, 0.0, 0.0)
    loop.run(5.0)
    loop.stack.command("stop")
    loop.run(3.0)
    walked, odometry = loop.side.base - begin, loop.stack.state.q[:2] - estimated
    assert not loop.failure and loop.stack.mode is Mode.STAND
    assert walked[0] > 0.7 * 5.0 * speed and np.abs(odometry - walked[:2]).max() < 0.05
    assert not loop.plant.refused and loop.side.refused == loop.plant.counter.lost == 0


def test_nothing_is_sent_before_the_gantry_is_confirmed(tmp_path: Path) -> None:
    loop = loop_of(tmp_path)
    loop.reach(StartState.GANTRY)
    loop.run(1.0)
    assert not loop.link.sent
    loop.startup.confirm_gantry()
    loop.run(0.2)
    assert loop.link.sent


def deactivate(loop: Ros2ControlLoop, source: Source = COMMAND) -> None:
    loop.side.controllers[loop.side.settings.controllers[source]] = "inactive"


def foreign(loop: Ros2ControlLoop) -> bytes:
    """A command of another driver of the same kind, without torque."""
    codec, zero = command_codec(loop.robot, loop.plant.config, "poise_driver_0"), np.zeros(loop.robot.nj)
    return codec.encode(0, JointCommand.torque(zero), zero, zero)


FAULTS: dict[str, tuple[Callable[[Ros2ControlLoop], object], str]] = {
    "joint states missing": (lambda loop: setattr(loop.side, "broken", {JOINTS}), "no new state of the robot"),
    "imu missing": (lambda loop: setattr(loop.side, "broken", {IMU}), "imu: the newest message is 0.041 s older"),
    "clock of the robot jumps back": (lambda loop: setattr(loop.side, "tick", 7), "clock has jumped"),
    "clock of the robot jumps ahead": (lambda loop: setattr(loop.side, "tick", 99_000), "clock has jumped"),
    "controller inactive": (deactivate, "'whole_body_controller' is inactive: ROS_DOMAIN_ID=0 ros2 control switch"),
    "broadcaster inactive": (lambda loop: deactivate(loop, IMU), "controller 'imu_sensor_broadcaster' is inactive"),
    "commands of another program": (
        lambda loop: loop.link.state_receivers.append(lambda message: loop.link.publish(foreign(loop))),
        "command of another program: ",
    ),
    "a command of a wrong size": (lambda loop: loop.link.send(b"\0\1" + bytes(30)), "'whole_body_controller' is"),
    "no commands of the controller": (
        lambda loop: setattr(loop.drivers, "command", lambda command: False), "no command of the controller"
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_damps_and_is_named(standing: Ros2ControlLoop, name: str) -> None:
    act, reason = FAULTS[name]
    act(standing)
    standing.until(lambda: standing.startup.state is StartState.DAMPED, 0.3)
    assert reason in standing.startup.reason
    standing.run(0.2)
    command = standing.side.drive()
    if name == "joint states missing":  # without velocities there is no damping by torques
        np.testing.assert_allclose(command.tau, 0.0, atol=1e-9)


def test_one_command_of_another_program_holds_and_is_refused_at_the_start(tmp_path: Path) -> None:
    loop = loop_of(tmp_path)
    loop.link.publish(foreign(loop))
    loop.run(0.5)
    assert loop.startup.state is StartState.LISTEN and "command of another program" in loop.startup.waits_for
    started(loop)
    assert loop.plant.holds == ()
    loop.link.publish(foreign(loop))
    loop.run(0.1)
    assert not loop.failure and "command of another program" in loop.plant.holds[0]
    assert not loop.stack.command("walk").accepted
    loop.run(1.0)
    assert loop.plant.holds == ()


def test_joint_states_missing_for_10_ms_are_ridden_through(standing: Ros2ControlLoop) -> None:
    standing.link.connected = False
    standing.run(0.01)
    standing.link.connected = True
    standing.run(1.0)
    assert not standing.failure and standing.plant.counter.lost == 10


def test_the_guard_fades_the_torque_of_a_driver_that_was_killed(standing: Ros2ControlLoop) -> None:
    standing.step()
    last = standing.side.drive().tau
    standing.running.discard(Process.DRIVER)
    torques = []
    for _ in range(300):
        standing.step()
        torques.append(standing.side.drive().tau)
    assert standing.guard.active and standing.guard.interventions == 1 and not standing.guard.refused
    steps = np.abs(np.diff([last, *torques[:40]], axis=0))  # until the robot, which is damped, hits the floor
    assert steps.max() < 0.25 * np.abs(last).max()  # all of it without the fade


def test_a_fault_fades_from_the_torque_that_is_in_force(tmp_path: Path) -> None:
    """A controller of torques has reduced gains: the fade begins with what they gave."""
    loop = loop_of(tmp_path)
    loop.reach(StartState.GANTRY)
    loop.startup.confirm_gantry()
    loop.reach(StartState.PREPARE)
    loop.run(1.5)  # the joints lag behind the ramp
    taus = []
    for tick in range(20):
        if tick == 10:
            loop.startup.damp("test")
        loop.step()
        taus.append(loop.side.drive().tau)
    steps = np.abs(np.diff(taus, axis=0)).max(axis=1)
    assert steps[10:].max() < 2.0 * steps[:9].max() + 0.5


def test_after_a_crash_the_next_driver_damps_when_the_command_controller_is_known_to_be_active(tmp_path: Path) -> None:
    loop = loop_of(tmp_path)
    loop.marker.touch()
    loop.restart_driver()
    loop.side.deactivate(COMMAND)
    loop.run(0.5)
    assert not loop.link.sent and "'whole_body_controller' is inactive" in loop.startup.waits_for
    loop.side.controllers = dict.fromkeys(loop.side.controllers, "active")
    loop.run(0.5)
    assert loop.link.sent and loop.startup.state is StartState.DAMPED
    with pytest.raises(CommandError, match="start it again"):
        loop.startup.prepare()


def test_close_damps_and_leaves_no_torque(standing: Ros2ControlLoop, tmp_path: Path) -> None:
    marker = tmp_path / "marker"
    assert marker.exists()
    standing.side.receive(standing.link.sent[-1])
    last = standing.side.drive().tau
    standing.link.sent.clear()
    standing.plant.close()
    assert len(standing.link.sent) > 20 and not marker.exists()
    standing.side.receive(standing.link.sent[0])
    np.testing.assert_allclose(standing.side.drive().tau, last, atol=1e-9)
    standing.side.receive(standing.link.sent[-1])
    assert not np.any(standing.side.drive().tau)
    assert "configure it again" in standing.plant.findings[0]


@pytest.fixture
def side() -> ControlledRobot:
    return ControlledRobot("g1")


def plant_of(side: ControlledRobot, folder: Path, laws: str = "g1", **settings: Any) -> Ros2ControlPlant:
    return Ros2ControlPlant(
        RobotModel.load(laws), marker=str(folder / "marker"), link=DirectControlLink(side), **settings
    )


def run(plant: Ros2ControlPlant, side: ControlledRobot, time: float) -> None:
    for _ in range(round(time / plant.period)):
        plant._link.step()  # type: ignore[attr-defined]
        plant._link.beat(False)  # type: ignore[attr-defined]
        plant.read()


def test_each_missing_part_is_named_and_then_none(side: ControlledRobot, tmp_path: Path) -> None:
    plant = plant_of(side, tmp_path)
    assert [finding.split("'")[0] for finding in plant.findings] == [
        f"no message of {source} on " for source in (JOINTS, IMU, *FEET)
    ]
    side.broken = frozenset({FEET[1], IMU})
    side.controllers.pop("imu_sensor_broadcaster")
    run(plant, side, 0.6)
    found = "; ".join(plant.findings)
    assert "no message of imu on '/imu_sensor_broadcaster/imu' (lo, domain 0)" in found
    assert "no message of right_foot on '/right_foot_broadcaster/wrench'" in found
    assert "'imu_sensor_broadcaster' is not loaded: ROS_DOMAIN_ID=0 ros2 control load_controller" in found
    assert plant.read().t == 0.0  # no sample without its parts
    side.broken, side.controllers["imu_sensor_broadcaster"] = frozenset(), "active"
    run(plant, side, 1.2)
    assert plant.findings == () and plant.stop == "" and plant.vendor == ""
    sensors = plant.read()
    assert np.isfinite(sensors.wrenches).all() and sensors.t > 1.0


def test_advice_names_the_domain_and_the_namespace_of_the_robot(side: ControlledRobot, tmp_path: Path) -> None:
    link, marker = DirectControlLink(side), str(tmp_path / "marker")
    plant = Ros2ControlPlant(RobotModel.load("g1"), domain=3, marker=marker, link=link, namespace="robot_1")
    side.controllers["imu_sensor_broadcaster"] = "inactive"
    command = "ROS_DOMAIN_ID=3 ros2 control switch_controllers -c /robot_1/controller_manager --activate imu_sensor"
    assert any(command in each for each in plant.findings)


def test_an_imu_that_is_slower_than_the_joints_is_named(side: ControlledRobot, tmp_path: Path) -> None:
    plant, states = plant_of(side, tmp_path), side.states
    side.states = lambda: [each for each in states() if each[0] != IMU or side.tick % 4 == 0]  # type: ignore[method-assign]
    run(plant, side, 1.202)
    assert np.isfinite(plant.read().gyro).all() and not plant.stop
    assert any("imu: no message with the stamp of the joint states" in each for each in plant.findings)


def test_a_robot_without_foot_sensors_needs_none(side: ControlledRobot, tmp_path: Path) -> None:
    plant = plant_of(side, tmp_path, "g1_hardware")
    side.broken = frozenset(FEET)
    run(plant, side, 1.2)
    assert plant.findings == () and np.isnan(plant.read().wrenches).all()


def test_a_refused_message_is_counted_and_named(side: ControlledRobot, tmp_path: Path) -> None:
    plant = plant_of(side, tmp_path)
    run(plant, side, 1.2)
    t, states = plant.read().t, side.states
    side.states = lambda: [(source, data[:40]) for source, data in states()]  # type: ignore[method-assign]
    run(plant, side, 0.01)
    assert plant.read().t == t and plant.refused == dict.fromkeys((JOINTS, IMU, *FEET), 10)
    assert any("10 messages of joint_states refused: JointState: cannot be decoded" in each for each in plant.findings)


def test_the_torque_of_an_old_state_has_no_gains(side: ControlledRobot, tmp_path: Path) -> None:
    plant = plant_of(side, tmp_path)
    run(plant, side, 0.1)
    one = np.ones(side.model.nj)
    command = JointCommand(one, one, 0.1 * one, 20.0 * one, one)
    for broken, silent in ((frozenset[str](), False), (frozenset({JOINTS}), True)):
        side.broken = broken
        run(plant, side, 0.02)
        for _ in range(20):  # within the drives' rate limit
            plant.write(command)
        side.receive(plant._link.sent[-1])  # type: ignore[attr-defined]
        assert np.allclose(side.drive().tau, 0.1) == silent


def test_other_joints_of_linear_feedback_controller_are_refused(side: ControlledRobot, tmp_path: Path) -> None:
    try:
        plant = plant_of(side, tmp_path, command="feedback")
    except MessageError as error:
        pytest.skip(str(error))
    run(plant, side, 1.2)
    assert plant.findings == ()
    names = side.model.joint_names
    for order, reason in ((names[::-1], "the order differs"), (names[1:], f"only one of them has '{names[0]}'")):
        side.moving_joints = order
        assert any(reason in each and "poise controllers" in each for each in plant.findings)


def test_an_unknown_option_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="comand"):
        Ros2ControlPlant(RobotModel.load("g1"), comand="pvt")


def test_torques_go_on_from_those_of_the_guard_after_a_hang(side: ControlledRobot, tmp_path: Path) -> None:
    plant = plant_of(side, tmp_path)
    run(plant, side, 0.01)
    link, model, zero = plant._link, side.model, np.zeros(side.model.nj)
    codec = command_codec(model, plant.config, GUARD)
    assert isinstance(link, DirectControlLink)
    for _ in range(2):
        plant.write(JointCommand.torque(model.tau_max))
    link.publish(codec.encode(0, JointCommand.torque(zero), zero, zero))
    run(plant, side, 0.001)
    steps = []
    for _ in range(2):
        plant.write(JointCommand.torque(model.tau_max))
        plant.read()  # with the echo of the command
        steps.append(codec.decode(link.sent[-1]).tau)
    np.testing.assert_allclose(steps, np.outer([1.0, 2.0], 0.001 * model.tau_rate_max))
