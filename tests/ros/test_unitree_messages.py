"""The bytes of the codec are those that ROS 2 makes of the messages of ``models/interfaces``."""

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message

from bridge.plants.unitree.wire import LOW_CMD, LOW_STATE, MOTORS
from models.errors import MessageError
from models.nodes.interfaces import interface
from tests.unit.bridge.unitree.test_wire import random_state

pytestmark = pytest.mark.ros


def types() -> tuple[type, type]:
    try:
        return interface("unitree_hg", "msg", "LowState"), interface("unitree_hg", "msg", "LowCmd")
    except MessageError as error:
        pytest.skip(str(error))


def test_low_state_is_the_message() -> None:
    kind, _ = types()
    record = random_state()
    message = deserialize_message(LOW_STATE.write(record), kind)
    assert (message.tick, message.mode_machine, message.imu_state.temperature) == (123456, 5, -7)
    for name in ("q", "dq", "ddq", "tau_est", "vol", "motorstate", "mode"):
        found = [getattr(motor, name) for motor in message.motor_state]
        assert np.array_equal(np.array(found, dtype=record["motor_state"][name].dtype), record["motor_state"][name])
    assert bytes(message.wireless_remote) == record["wireless_remote"].tobytes()
    assert len(serialize_message(message)) == len(LOW_STATE.write(record)) == LOW_STATE.size


def test_low_cmd_is_the_message() -> None:
    _, kind = types()
    record = LOW_CMD.new()
    record["mode_machine"], record["motor_cmd"]["mode"] = 5, 1
    for name in ("q", "dq", "tau", "kp", "kd"):
        record["motor_cmd"][name] = np.random.default_rng(1).normal(size=MOTORS)
    message = deserialize_message(LOW_CMD.write(record), kind)
    data = bytes(serialize_message(message))
    assert len(data) == LOW_CMD.size
    found = LOW_CMD.read(data)  # padding of rclpy, checksum of ours
    assert found["motor_cmd"].tobytes() == record["motor_cmd"].tobytes()
    assert found["mode_machine"] == message.mode_machine == 5
