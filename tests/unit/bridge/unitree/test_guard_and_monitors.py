"""The damping guard, the monitors, and the profile of the robot's network."""

import xml.etree.ElementTree as ET
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bridge.launch.robot_network import LOOPBACK, RobotNetwork, interface_address, profile_text
from bridge.plants.hardware import GuardWatch, RobotClock, real_robot, session
from bridge.plants.monitors import HardwareMonitor
from bridge.plants.unitree.codec import UnitreeCodec, is_foreign, joint_command
from bridge.plants.unitree.guard import DampingGuard, connect
from bridge.plants.unitree.plant import UnitreePlant
from bridge.plants.unitree.simulated import DirectLink, GantryRobot
from bridge.plants.unitree.wire import LOW_CMD, LOW_STATE
from controllers.joints.joint_servo import drive_torque
from models.errors import ConfigError
from models.profile import Thresholds
from models.robot_model import RobotModel
from models.types import JointCommand

SILENCE = real_robot().silence_max


@pytest.fixture(scope="module")
def hardware() -> RobotModel:
    return RobotModel.load("g1_hardware")


def command_of(model: RobotModel) -> bytes:
    rows = np.ones((5, model.nj))
    return UnitreeCodec(model, RobotClock(0.002, 1.0), session()).encode(JointCommand(*rows), 5)


def test_the_guard_damps_after_the_silence_and_ends_with_it(g1: RobotModel) -> None:
    guard, data = DampingGuard(g1), command_of(g1)
    assert guard.step(100.0) is None  # before the driver's first command
    guard.receive(data, 100.0)
    assert guard.step(100.0 + 0.9 * SILENCE) is None
    begin = 100.0 + 1.1 * SILENCE
    first = guard.step(begin)
    assert guard.foreign == 0
    assert first is not None and (guard.active, guard.interventions) == (True, 1)
    q, v = 0.3 * np.ones(g1.nj), 0.2 * np.ones(g1.nj)
    last = drive_torque(g1, joint_command(LOW_CMD.read(data), g1.nj), q, v)
    torques = [drive_torque(g1, joint_command(LOW_CMD.read(first), g1.nj), q, v)]
    np.testing.assert_allclose(torques[0], last, rtol=1e-6)
    for step in range(1, 100):
        made = guard.step(begin + 0.002 * step)
        assert made is not None
        guard.receive(made, begin + 0.002 * step)  # it receives its own
        torques.append(drive_torque(g1, joint_command(LOW_CMD.read(made), g1.nj), q, v))
    assert np.abs(np.diff(torques, axis=0)).max() < 0.02 * np.abs(torques[0] - torques[-1]).max()
    record = LOW_CMD.read(made)
    command = joint_command(record, g1.nj)
    assert record["mode_machine"] == 5
    assert command.kd is not None and np.allclose(command.kd, g1.kd)
    assert not np.any(command.tau) and not np.any(command.kp)
    guard.receive(data, begin + 0.3)
    assert guard.step(begin + 0.301) is None and not guard.active
    assert guard.step(begin + 0.4) is not None and guard.interventions == 2


def test_the_guard_waits_longer_for_a_slow_simulated_robot(g1: RobotModel) -> None:
    guard = DampingGuard(g1, 0.5)
    guard.receive(command_of(g1), 100.0)
    assert guard.step(100.0 + 1.9 * SILENCE) is None
    assert guard.step(100.0 + 2.1 * SILENCE) is not None


def test_the_guard_ignores_others_and_damaged_commands(g1: RobotModel) -> None:
    guard, data = DampingGuard(g1), bytearray(command_of(g1))
    data[50] ^= 1
    guard.receive(bytes(data), 0.0)
    assert guard.refused == 1 and guard.step(1.0) is None and not guard.armed
    other = LOW_CMD.new()
    guard.receive(LOW_CMD.write(other), 0.0)
    driver = UnitreeCodec(g1, RobotClock(0.002, 1.0), session() ^ 1)  # of another graph
    guard.receive(driver.encode(JointCommand(*np.ones((5, g1.nj))), 5), 0.0)
    assert guard.foreign == 2 and guard.step(1.0) is None and not guard.armed


def test_the_guard_does_not_damp_after_the_drivers_last_command(g1: RobotModel) -> None:
    guard, rows = DampingGuard(g1), np.ones((5, g1.nj))
    guard.receive(command_of(g1), 0.0)
    for number in (session() ^ 1, session()):
        assert guard.armed
        last = UnitreeCodec(g1, RobotClock(0.002, 1.0), number).encode(JointCommand(*rows), 5, last=True)
        guard.receive(last, 0.002)
    assert not guard.armed and guard.step(1.0) is None


@pytest.mark.ros
@pytest.mark.parametrize(("plant", "robot", "reason"), [("booster", "g1", "joints"), ("unitree", "g9", "'g9'")])
def test_the_guard_process_names_what_it_cannot_start_with(plant: str, robot: str, reason: str) -> None:
    main = pytest.importorskip("bridge.nodes.damping_guard").main
    with pytest.raises(SystemExit, match=rf"damping_guard: .*{reason}"):
        main([plant, robot, "0", "{}"])


def test_commands_of_other_programs_are_recognised(g1: RobotModel) -> None:
    rows = JointCommand(*np.ones((5, g1.nj)))
    mine = session()
    own, other = (UnitreeCodec(g1, RobotClock(0.002, 1.0), each).encode(rows, 5) for each in (mine, mine ^ 1))
    assert not is_foreign(own, mine) and is_foreign(other, mine) and is_foreign(LOW_CMD.write(LOW_CMD.new()), mine)
    guard = DampingGuard(g1)
    guard.receive(own, 0.0)
    made = guard.step(1.0)
    assert made is not None and not is_foreign(made, mine) and is_foreign(made, mine ^ 1)


def test_a_guard_that_does_not_receive_the_drivers_commands_is_a_hold() -> None:
    watch = GuardWatch(0.05)
    for commanded in (False, True):
        for _ in range(19):
            watch.step([False], commanded=commanded)
        assert not watch.holds and not watch.warnings
    for _ in range(2):
        watch.step([False], commanded=True)
    assert watch.holds == ("guard process without a command of the driver for more than 1 s",)
    watch.step([True], commanded=True)
    assert not watch.holds


def monitor_of(model: RobotModel) -> HardwareMonitor:
    assert model.profile.hardware is not None
    return HardwareMonitor(model, model.profile.hardware)


def watch(
    monitor: HardwareMonitor, model: RobotModel, time: float, lost: int = 0, foreign: int = 0, **values: float
) -> None:
    """Feed states with other values for all motors (``joint`` -1), the one with index ``joint``, or the left knee.

    Of the ``joints`` motors from that index on, each state has another one with these values.
    """
    codec = UnitreeCodec(model, RobotClock(0.002, 1.0))
    record = LOW_STATE.new()
    motors = record["motor_state"]
    joint, joints = int(values.pop("joint", 3)), int(values.pop("joints", 1))
    for tick in range(round(time / 0.002)):
        record["tick"] = 2 * tick
        motors["temperature"], motors["vol"], motors["motorstate"] = 40, 50.0, 0
        for name, value in values.items():
            motors[name][slice(None) if joint < 0 else joint + tick % joints] = value
        monitor.step(codec.decode(LOW_STATE.write(record)), lost, 0.002 * (lost + 1), foreign)


HOT = "motor temperature of 'left_knee_joint': 110 degC above 105 degC"


@pytest.mark.parametrize(
    ("values", "level", "reason"),
    [
        ({}, "none", ""),
        ({"temperature": 80}, "warnings", "motor temperature of 'left_knee_joint': 80 degC above 75 degC"),
        ({"temperature": 95}, "holds", "motor temperature of 'left_knee_joint': 95 degC above 90 degC"),
        ({"temperature": 110}, "damps", HOT),
        ({"vol": 43.0}, "warnings", "voltage of 'left_knee_joint': 43 V below 44 V"),
        ({"vol": 30.0}, "damps", "voltage of 'left_knee_joint': 30 V below 39 V"),
        ({"vol": 0.0}, "none", ""),
        ({"vol": 0.0, "joint": -1}, "warnings", "voltage: not measured by any drive, so a low voltage is not detected"),
        ({"motorstate": 0x40}, "holds", "motor of 'left_knee_joint': error word 0x40"),
        ({"temperature": 110, "joint": 2, "joints": 2}, "damps", HOT),
        ({"vol": 30.0, "joint": 2, "joints": 2}, "damps", "voltage of 'left_knee_joint': 30 V below 39 V"),
        ({"motorstate": 0x40, "joint": 2, "joints": 2}, "holds", "motor of 'left_knee_joint': error word 0x40"),
        ({"motorstate": 1, "joint": 33}, "none", ""),  # no motor of this robot
    ],
)
def test_monitors_name_joint_value_and_threshold(
    hardware: RobotModel, values: dict[str, float], level: str, reason: str
) -> None:
    monitor = monitor_of(hardware)
    watch(monitor, hardware, 0.06, **values)
    assert not (monitor.warnings or monitor.holds or monitor.damps)  # not yet for long enough
    watch(monitor, hardware, 0.3, **values)
    found = {name: getattr(monitor, name) for name in ("warnings", "holds", "damps")}
    assert found == {name: (reason,) if name == level else () for name in found}


@pytest.mark.parametrize(("lost", "level"), [(0, "none"), (1, "damps")])
def test_lost_states(hardware: RobotModel, lost: int, level: str) -> None:
    monitor = monitor_of(hardware)
    watch(monitor, hardware, 10.0, lost)
    assert float(monitor.values["states lost [%]"]) == pytest.approx(100.0 * lost / (lost + 1), abs=1.0)


def test_saturated_torques(hardware: RobotModel) -> None:
    monitor, knee = monitor_of(hardware), float(hardware.tau_max[3])
    watch(monitor, hardware, 5.0, tau_est=0.9 * knee)
    assert not monitor.warnings
    watch(monitor, hardware, 0.5, tau_est=-knee)
    assert len(monitor.warnings) == 1 and "torque saturation of 'left_knee_joint'" in monitor.warnings[0]
    watch(monitor, hardware, 1.0, tau_est=-knee)
    assert len(monitor.holds) == 1
    watch(monitor, hardware, 3.0, tau_est=-knee)
    assert len(monitor.damps) == 1


def test_commands_of_another_program_count_at_once(hardware: RobotModel) -> None:
    monitor = monitor_of(hardware)
    watch(monitor, hardware, 0.002, foreign=1)
    assert len(monitor.holds) == 1 and "lowcmd of another program" in monitor.holds[0]
    watch(monitor, hardware, 1.0)
    assert not monitor.holds
    watch(monitor, hardware, 0.03, foreign=1)
    assert len(monitor.damps) == 1


def test_thresholds_are_ordered() -> None:
    assert Thresholds(1.0, 2.0, 3.0).rising and not Thresholds(3.0, 2.0, 1.0).rising
    with pytest.raises(ValueError, match="not in order"):
        Thresholds(1.0, 3.0, 2.0)


def test_the_profile_of_the_network_has_one_more_interface() -> None:
    space = "{http://www.eprosima.com}"
    root = ET.fromstring(profile_text("192.168.123.222"))
    allowed = [each.text for each in root.findall(f".//{space}interfaceWhiteList/{space}address")]
    peers = [each.text for each in root.findall(f".//{space}initialPeersList//{space}address")]
    assert allowed == ["127.0.0.1", "192.168.123.222"] and peers == ["127.0.0.1", "239.255.0.1"]
    assert root.find(f".//{space}metatrafficUnicastLocatorList") is None
    alone = ET.fromstring(profile_text(LOOPBACK))
    assert [each.text for each in alone.findall(f".//{space}interfaceWhiteList/{space}address")] == ["127.0.0.1"]


def test_interfaces_and_domains_are_refused_by_name() -> None:
    assert interface_address("lo") == "127.0.0.1"
    with pytest.raises(ConfigError, match=r"no interface 'eth77'; known: .*lo"):
        interface_address("eth77")
    with pytest.raises(ConfigError, match="ROS domain 3 is that of the robot"):
        RobotNetwork("lo", 3).check(3)


def test_the_plant_refuses_profiles_and_rates(g1: RobotModel, hardware: RobotModel) -> None:
    with pytest.raises(ConfigError, match="'g1' needs 'hardware'"):
        UnitreePlant(g1)
    with pytest.raises(ConfigError, match=r"rate: 250\.0 Hz; the robot runs at 500 or 1000 Hz"):
        UnitreePlant(hardware, rate=250.0)


@pytest.mark.parametrize("speed", [0.0, 0.05, 2.0, float("nan"), "fast", True, None])
def test_plant_and_guard_refuse_a_speed_by_name(g1: RobotModel, hardware: RobotModel, speed: Any) -> None:
    with pytest.raises(ConfigError, match=rf"speed: {speed!r} is not a number from 0\.1 to 1"):
        UnitreePlant(hardware, speed=speed)
    with pytest.raises(ConfigError, match="speed"):
        connect(g1, 0, {"speed": speed})


@pytest.mark.parametrize(("speed", "found"), [(0.3, ""), (1.0, "the robot's time has speed 1.0, not 0.3")])
def test_a_real_robot_is_not_started_with_the_speed_of_a_slow_one(
    hardware: RobotModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, speed: float, found: str
) -> None:
    link = DirectLink(GantryRobot("g1", rate=500.0))
    plant = UnitreePlant(hardware, speed=0.3, marker=str(tmp_path / "marker"), link=link)
    monkeypatch.setattr("bridge.plants.unitree.plant.time", SimpleNamespace(monotonic=lambda: plant_time() / speed))

    def plant_time() -> float:
        return 0.001 * link.robot.tick

    for _ in range(700):
        link.step()
        plant.read()
    assert [text for text in plant.findings if "speed" in text] == (
        [f"{found}: a real robot has speed 1"] if found else []
    )
