"""Commands as messages: the controllers of ros2_control make of each the torque of the drives' law; guard; its file."""

import numpy as np
import pytest
import yaml

pytest.importorskip("rclpy")

from rclpy.serialization import deserialize_message, serialize_message

from bridge.plants.hardware import real_robot, session
from bridge.plants.ros2_control.commands import DRIVER, GUARD, CommandCodec, command_codec, driver_mark
from bridge.plants.ros2_control.config import COMMAND, FEET, IMU, JOINTS, read_config
from bridge.plants.ros2_control.controllers_file import controllers_file
from bridge.plants.ros2_control.guard import ControlGuard
from bridge.plants.ros2_control.simulated import make_controller
from controllers.joints.joint_servo import damping_command, drive_torque
from models.errors import ConfigError, MessageError
from models.robot_model import RobotModel
from models.types import JointCommand, SensorData
from tests.unit.bridge.ros2_control.test_sensors import joint_state

pytestmark = pytest.mark.ros
KINDS = [("effort", False), ("pvt", False), ("feedback", False), ("feedback", True)]

SILENCE = real_robot().silence_max


def codec_of(model: RobotModel, command: str, mark: str = DRIVER, free_flyer: bool = False) -> CommandCodec:
    config = read_config({"command": command, "free_flyer": free_flyer, "delay": 0.001, "delay_margin": 1.0})
    try:
        return command_codec(model, config, mark)
    except MessageError as error:
        pytest.skip(str(error))


def random_command(model: RobotModel, seed: int) -> tuple[JointCommand, SensorData]:
    rows = np.random.default_rng(seed).uniform(0.1, 1.0, (7, model.nj))
    command = JointCommand(rows[0], rows[1], rows[2], rows[3], rows[4] * model.kd)
    nothing = np.full(6, np.nan)
    return command, SensorData(1.0, rows[5], rows[6], rows[2], nothing[:3], nothing[:3], np.full((2, 6), np.nan))


@pytest.mark.parametrize(("command", "free_flyer"), KINDS)
def test_the_controller_makes_the_torque_of_the_law(robot: RobotModel, command: str, free_flyer: bool) -> None:
    codec = codec_of(robot, command, free_flyer=free_flyer)
    controller = make_controller(read_config({"command": command, "free_flyer": free_flyer}), robot)
    for seed in range(3):
        given, sensors = random_command(robot, seed)
        data = codec.encode(123, given, sensors.q, sensors.v)
        assert codec.mark(data) == DRIVER and controller.accept(data)
        executed = drive_torque(robot, controller.command(sensors), sensors.q, sensors.v)
        np.testing.assert_allclose(executed, drive_torque(robot, given, sensors.q, sensors.v), atol=1e-12)
        decoded = drive_torque(robot, codec.decode(data), sensors.q, sensors.v)
        np.testing.assert_allclose(decoded, executed, atol=1e-12)
    with pytest.raises(MessageError):
        codec.decode(serialize_message(codec.kind()))


def test_torques_are_within_the_limits_and_finite(g1: RobotModel) -> None:
    codec, zero = codec_of(g1, "effort"), np.zeros(g1.nj)
    data = codec.encode(1, JointCommand.torque(np.full(g1.nj, 1e4)), zero, zero)
    np.testing.assert_array_equal(deserialize_message(data, codec.kind).data, g1.tau_max)
    data = codec.encode(1, JointCommand(zero, zero, zero, g1.kp, g1.kd), np.full(g1.nj, np.nan), zero)
    assert not np.any(deserialize_message(data, codec.kind).data)


@pytest.mark.parametrize(("delay", "of_it"), [(0.002, 0.2), (0.002, 1.9), (0.003, 1.9)])
def test_the_gains_of_torques_are_stable_up_to_twice_the_delay(robot: RobotModel, delay: float, of_it: float) -> None:
    """Each rotor alone, under its own gains after a part of the delay: it comes to rest, by steps of 0.1 ms."""
    codec = command_codec(robot, read_config({"delay": delay}), DRIVER)
    zero, step = np.zeros(robot.nj), 1e-4
    command = JointCommand(zero, zero, zero, 4.0 * robot.kp, 2.0 * robot.kd)
    q, v = np.full(robot.nj, 0.01), zero
    late = [zero] * round(of_it * delay / step)
    for _ in range(20_000):
        late.append(np.array(deserialize_message(codec.encode(1, command, q, v), codec.kind).data))
        v = v + step * late.pop(0) / robot.armature
        q = q + step * v
    assert np.abs(q).max() < 1e-3 and np.abs(v).max() < 1e-2


def test_marks(g1: RobotModel) -> None:
    zero = np.zeros(g1.nj)
    for command, free_flyer in KINDS:
        codec = codec_of(g1, command, GUARD, free_flyer)
        assert codec.mark(codec.encode(1, JointCommand.torque(zero), zero, zero)) == GUARD
        assert codec.mark(serialize_message(codec.kind())) == ""
        assert codec.mark(b"") == ""


def test_a_torque_changes_at_the_rate_of_the_drives(g1: RobotModel) -> None:
    codec, zero = codec_of(g1, "effort"), np.zeros(g1.nj)
    damping, fast, steps = damping_command(g1), np.full(g1.nj, 30.0), [zero]
    data = codec.encode(1, damping, zero, zero)
    for _ in range(20):
        data = codec.encode(1, damping, zero, fast, data)
        steps.append(codec.decode(data).tau)
    changes = np.abs(np.diff(steps, axis=0)) / (0.001 * g1.tau_rate_max)
    np.testing.assert_allclose(changes[0], 1.0)  # a joint that is struck
    assert changes.max() < 1.0 + 1e-9
    np.testing.assert_allclose(steps[-1], codec.decode(codec.encode(1, damping, zero, fast)).tau)


def guarded(guard: ControlGuard, begin: float, end: float, joints: bytes = b"") -> bytes:
    """Last command of a guard between two times [s], with joint states if there are any."""
    command = None
    for now in np.arange(begin, end, real_robot().command_period):
        if joints:
            guard.receive((JOINTS, joints), now)
        command = guard.step(now)
    assert command is not None
    return command


@pytest.mark.parametrize("command", ["effort", "pvt", "feedback"])
def test_the_guard_damps_after_the_silence(g1: RobotModel, command: str) -> None:
    driver, codec = codec_of(g1, command, driver_mark()), codec_of(g1, command, GUARD)
    guard, controller = ControlGuard(g1, codec), make_controller(read_config({"command": command}), g1)
    given, sensors = random_command(g1, 4)
    data = driver.encode(1, given, sensors.q, sensors.v)
    moving = joint_state(g1, sensors.v / 10.0)
    assert guard.step(9.0) is None and not guard.armed
    guard.receive((COMMAND, serialize_message(codec.kind())), 9.0)
    assert guard.foreign == 1 and not guard.armed
    other = codec_of(g1, command, f"{DRIVER}_0").encode(1, given, sensors.q, sensors.v)  # of another graph
    guard.receive((COMMAND, other), 9.0)
    assert guard.foreign == 2 and not guard.armed
    other = codec_of(g1, command, f"{GUARD[:-8]}{session() ^ 1:08x}").encode(
        1, given, sensors.q, sensors.v
    )  # its guard
    guard.receive((COMMAND, other), 9.0)
    assert guard.foreign == 3 and not guard.armed
    guard.receive((COMMAND, data), 10.0)
    guard.receive((JOINTS, serialize_message(moving)), 10.0 + SILENCE)
    assert guard.step(10.0 + 0.9 * SILENCE) is None
    begin = 10.0 + 1.1 * SILENCE
    first = guard.step(begin)
    assert first is not None and controller.accept(first)
    last = drive_torque(g1, driver.decode(data), sensors.q, sensors.v)
    np.testing.assert_allclose(drive_torque(g1, controller.command(sensors), sensors.q, sensors.v), last, atol=1e-9)
    assert controller.accept(guarded(guard, begin, begin + 0.0751))  # without joint states since then
    if codec.evaluated:
        torque = drive_torque(g1, controller.command(sensors), sensors.q, sensors.v)
        np.testing.assert_allclose(torque, (1.0 - 0.074 / 0.15) * last, atol=1e-9)
    made = guarded(guard, begin + 0.076, begin + 0.201, serialize_message(moving))
    assert (guard.active, guard.interventions) == (True, 1)
    guard.receive((COMMAND, made), 10.0 + 1.2 * SILENCE)  # it receives its own
    assert guard.foreign == 3 and guard.active
    assert controller.accept(made)
    torque = drive_torque(g1, controller.command(sensors), sensors.q, sensors.v)
    damping = codec.executed(damping_command(g1)).kd
    assert damping is not None and damping.min() > 0.0
    np.testing.assert_allclose(torque, np.clip(-damping * sensors.v, -g1.tau_max, g1.tau_max), atol=1e-9)
    assert controller.accept(guarded(guard, 11.0, 11.06))  # without joint states
    torque = drive_torque(g1, controller.command(sensors), sensors.q, sensors.v)
    assert np.any(torque) != codec.evaluated
    final = guard.final_command()
    assert (final is not None) == codec.evaluated
    guard.receive((COMMAND, data), 11.06)
    assert guard.step(11.061) is None and not guard.active


@pytest.mark.parametrize("command", ["effort", "pvt", "feedback"])
def test_the_file_of_the_controllers_names_every_joint_in_order(robot: RobotModel, command: str) -> None:
    text = controllers_file(robot, read_config({"command": command, "rate": 500.0}))
    assert "&" not in text and "*" not in text  # ROS 2 reads no anchors
    file = {name: each["ros__parameters"] for name, each in yaml.safe_load(text).items()}
    manager, given = file["controller_manager"], file["whole_body_controller"]
    assert manager.pop("update_rate") == 500
    assert set(manager) == set(file) - {"controller_manager"}
    joints = list(robot.joint_names)
    assert file["joint_state_broadcaster"]["joints"] == joints
    assert given[{"effort": "joints", "pvt": "gpios", "feedback": "moving_joint_names"}[command]] == joints
    if command == "feedback":
        chained = file["joint_state_estimator"]["command_interfaces"]
        assert chained[0] == f"whole_body_controller/{joints[0]}/position" and len(chained) == 3 * robot.nj


def test_topics_follow_the_names_of_the_controllers() -> None:
    config = read_config({"controllers": {"imu": "base_imu"}, "topics": {"left_foot": "/lf"}, "command": "feedback"})
    topics = config.topic_of
    assert (topics[JOINTS], topics[IMU], topics[FEET[0]]) == ("/joint_states", "/base_imu/imu", "/lf")
    assert topics[FEET[1]] == "/right_foot_broadcaster/wrench" and topics[COMMAND] == "/control"
    assert read_config({}).topic_of[COMMAND] == "/whole_body_controller/commands"
    for wrong, culprit in (({"comand": "pvt"}, "comand"), ({"command": "torque"}, "command"), ({"rate": 1}, "rate")):
        with pytest.raises(ConfigError, match=culprit):
            read_config(wrong)
