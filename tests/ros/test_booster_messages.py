"""The bytes of the codec are those that ROS 2 makes of the messages of ``models/interfaces``, and modes are read."""

import json

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message

from bridge.plants.booster.codec import BUTTONS, PADDING, REMOTE, low_cmd, low_state, pack, unpack
from bridge.plants.booster.link import mode_of
from models.errors import MessageError
from models.nodes.interfaces import interface
from tests.unit.bridge.booster.test_codec import random_state

pytestmark = pytest.mark.ros
MOTORS = 23


def kind(name: str) -> type:
    try:
        return interface("booster_interface", "msg", name)
    except MessageError as error:
        pytest.skip(str(error))


def assert_same(data: bytes, expected: bytes) -> None:
    assert data[:2] == expected[:2] and 0 <= len(data) - len(expected) < PADDING


def test_low_state_is_the_message() -> None:
    record = random_state(MOTORS)
    message = deserialize_message(pack(record), kind("LowState"))
    np.testing.assert_array_equal(message.imu_state.acc, record["acc"])
    for name, motors in (("serial", message.motor_state_serial), ("parallel", message.motor_state_parallel)):
        for field in ("q", "dq", "ddq", "tau_est", "temperature", "lost"):
            np.testing.assert_array_equal([getattr(motor, field) for motor in motors], record[name][field])
        np.testing.assert_array_equal([motor.reserve for motor in motors], record[name]["reserve"])
    data = bytes(serialize_message(message))
    assert_same(data, pack(record))
    np.testing.assert_array_equal(unpack("low_state", data, low_state(MOTORS))["serial"]["q"], record["serial"]["q"])


def test_low_cmd_is_the_message() -> None:
    record = np.zeros(1, low_cmd(MOTORS))[0]
    record["cmd_type"], record["size"] = 1, MOTORS
    for name in ("q", "dq", "tau", "kp", "kd", "weight"):
        record["motors"][name] = np.random.default_rng(1).normal(size=MOTORS)
    message = deserialize_message(pack(record), kind("LowCmd"))
    assert message.cmd_type == message.SERIAL and len(message.motor_cmd) == MOTORS
    found = unpack("low_cmd", bytes(serialize_message(message)), low_cmd(MOTORS))
    for name in ("q", "dq", "tau", "kp", "kd", "weight"):
        np.testing.assert_array_equal(found["motors"][name], record["motors"][name])


def test_the_remote_controller_is_the_message() -> None:
    record = np.zeros(1, REMOTE)[0]
    record["buttons"] = np.random.default_rng(2).integers(0, 2, len(BUTTONS))
    message = deserialize_message(pack(record), kind("RemoteControllerState"))
    assert [getattr(message, name) for name in BUTTONS] == record["buttons"].astype(bool).tolist()
    assert_same(bytes(serialize_message(message)), pack(record))


def test_the_mode_of_a_response() -> None:
    assert mode_of('{"status": 0}', json.dumps({"mode": 3})) == 3
    for header, body, reason in (
        ('{"status": 502}', "", "status 502"),
        ("{}", "", "no mode"),
        ('{"status": 0}', "[]", "no mode"),
    ):
        with pytest.raises(MessageError, match=reason):
            mode_of(header, body)
