"""Bytes, checksum, clock and buttons of Unitree's protocol, each against a second way to compute them."""

import struct

import numpy as np
import pytest

from bridge.plants.hardware import RobotClock
from bridge.plants.unitree.codec import BUTTONS, G1_JOINTS, UnitreeCodec, UnitreeSample, joint_command
from bridge.plants.unitree.wire import LOW_CMD, LOW_STATE, MOTORS, checksum
from models.errors import ConfigError, MessageError
from models.robot_model import RobotModel
from models.types import JointCommand

RNG = np.random.default_rng(7)


def bitwise(structure: bytes) -> int:
    """The checksum bit by bit: a shift register over the words of the structure but the last."""
    register = 0xFFFFFFFF
    for (word,) in struct.iter_unpack("<I", structure[:-4]):
        for bit in range(31, -1, -1):
            out = register >> 31 ^ word >> bit & 1
            register = (register << 1 & 0xFFFFFFFF) ^ (0x04C11DB7 if out else 0)
    return register


def random_state() -> np.void:
    """A LowState with distinct values in every member; the padding is left at zero."""
    record = LOW_STATE.new()
    record["version"], record["mode_machine"], record["tick"] = (3, 4), 5, 123456
    for name in ("quaternion", "gyroscope", "accelerometer", "rpy"):
        record[name] = RNG.normal(size=record[name].shape)
    record["imu_temperature"] = -7
    motors = record["motor_state"]
    for name in ("q", "dq", "ddq", "tau_est", "vol"):
        motors[name] = RNG.normal(size=MOTORS)
    motors["mode"], motors["motorstate"] = 1, np.arange(MOTORS)
    motors["temperature"] = RNG.integers(-20, 120, (MOTORS, 2))
    motors["sensor"], motors["reserve"] = RNG.integers(0, 99, (MOTORS, 2)), RNG.integers(0, 99, (MOTORS, 4))
    record["wireless_remote"] = RNG.integers(0, 256, 40)
    record["reserve"] = 1, 2, 3, 4
    return record


def codec(model: RobotModel) -> UnitreeCodec:
    return UnitreeCodec(model, RobotClock(0.002, 1.0))


def sample(model: RobotModel, **changes: object) -> UnitreeSample:
    record = random_state()
    for name, value in changes.items():
        record[name] = value
    return codec(model).decode(LOW_STATE.write(record))


def test_the_checksum_is_the_bitwise_one() -> None:
    for size in (8, 1004, 2092):
        data = RNG.bytes(size)
        assert checksum(data) == bitwise(data)
    assert checksum(b"\x00" * 8) == bitwise(b"\x00" * 8)


def test_sizes_are_those_of_the_protocol() -> None:
    assert (LOW_STATE.dtype.itemsize, LOW_CMD.dtype.itemsize) == (2092, 1004)
    assert len(LOW_STATE.write(random_state())) == 2092  # 4 bytes of header, 4 fewer of padding
    assert len(LOW_CMD.write(LOW_CMD.new())) == 1004


def test_state_survives_the_wire() -> None:
    record = random_state()
    found = LOW_STATE.read(LOW_STATE.write(record))
    for name in LOW_STATE.dtype.names or ():
        if name == "crc":
            assert found["crc"] == bitwise(found.tobytes())
        elif "pad" not in name:
            assert np.array_equal(found[name], record[name]), name


def test_padding_on_the_wire_does_not_count() -> None:
    """CDR does not define its padding, and the checksum is over zeros."""
    data = bytearray(LOW_STATE.write(random_state()))
    clean = LOW_STATE.read(bytes(data))
    for pad in (75, 131, 187):
        data[pad] ^= 0x5A
    assert LOW_STATE.read(bytes(data)).tobytes() == clean.tobytes()


@pytest.mark.parametrize("byte", [4, 16, 200, 1500, 2091])
def test_a_changed_byte_is_refused(byte: int) -> None:
    data = bytearray(LOW_STATE.write(random_state()))
    data[byte] ^= 1
    with pytest.raises(MessageError, match="crc"):
        LOW_STATE.read(bytes(data))
    command = bytearray(LOW_CMD.write(LOW_CMD.new()))
    command[min(byte, 1003)] ^= 1
    with pytest.raises(MessageError, match="crc"):
        LOW_CMD.read(bytes(command))


@pytest.mark.parametrize("name", ["gyroscope", "accelerometer", "quaternion"])
def test_a_state_that_is_not_finite_is_refused(g1: RobotModel, name: str) -> None:
    with pytest.raises(MessageError, match="not finite"):
        sample(g1, **{name: np.nan})
    for motor, finite in ((3, False), (33, True)):  # 33 is no motor of this robot
        record = random_state()
        record["motor_state"]["q"][motor] = np.inf
        if finite:
            assert np.isfinite(codec(g1).decode(LOW_STATE.write(record)).sensors.q).all()
        else:
            with pytest.raises(MessageError, match="not finite"):
                codec(g1).decode(LOW_STATE.write(record))


def test_another_message_is_refused() -> None:
    with pytest.raises(MessageError, match="7 bytes"):
        LOW_STATE.read(b"\x00\x01\x00\x00abc")
    with pytest.raises(MessageError, match="XCDR1"):
        LOW_STATE.read(b"\x00\x00" + LOW_STATE.write(random_state())[2:])


def test_sensor_data_has_the_order_of_the_joints(g1: RobotModel) -> None:
    record = random_state()
    found = codec(g1).decode(LOW_STATE.write(record))
    assert g1.joint_names == G1_JOINTS
    motors, sensors = record["motor_state"][:29], found.sensors
    for name, values in (("q", sensors.q), ("dq", sensors.v), ("tau_est", sensors.tau)):
        assert np.array_equal(values, motors[name].astype(np.float64))
    assert np.array_equal(sensors.gyro, record["gyroscope"]) and np.array_equal(sensors.accel, record["accelerometer"])
    assert np.array_equal(found.quaternion, np.float64(record["quaternion"])[[1, 2, 3, 0]])
    assert np.isnan(sensors.wrenches).all() and sensors.t == pytest.approx(0.002)
    assert found.mode_machine == 5 and found.motor_state[3] == 3.0
    assert np.array_equal(found.temperature, motors["temperature"])


def test_commands_survive_the_wire(g1: RobotModel) -> None:
    rows = RNG.normal(size=(5, g1.nj)).astype(np.float32).astype(np.float64)
    record = LOW_CMD.read(codec(g1).encode(JointCommand(*rows), 5))
    found = joint_command(record, g1.nj)
    assert record["mode_machine"] == 5 and record["mode_pr"] == 0
    for value, given in zip((found.q, found.v, found.tau, found.kp, found.kd), rows, strict=True):
        assert np.array_equal(value, given)
    assert not record["motor_cmd"][g1.nj :]["mode"].any()  # motors that the robot lacks stay off
    default = joint_command(LOW_CMD.read(codec(g1).encode(JointCommand(*rows[:3]), 5)), g1.nj)
    assert default.kp is not None and np.allclose(default.kp, g1.kp, rtol=1e-6)


def test_another_robot_is_refused(talos: RobotModel) -> None:
    with pytest.raises(ConfigError, match=r"'talos'.*29 joints"):
        codec(talos)


def test_time_follows_the_tick() -> None:
    clock = RobotClock(0.002, 1.0)
    assert [clock.step(tick) for tick in (5000, 5002, 5002, 5004, 5010)] == pytest.approx(
        [0.002, 0.004, 0.004, 0.006, 0.012]
    )
    assert clock.restarts == 0


def test_time_goes_on_over_a_wrap_and_a_restart() -> None:
    clock = RobotClock(0.002, 1.0)
    times = [clock.step(tick) for tick in (2**32 - 2, 0, 2, 900_000, 900_002, 4, 6)]
    assert np.diff(times) == pytest.approx([0.002] * 6)
    assert clock.restarts == 2  # a jump ahead by minutes, and one back


def test_buttons(g1: RobotModel) -> None:
    for bit, name in enumerate(BUTTONS):
        remote = np.zeros(40, np.uint8)
        remote[2 + bit // 8] = 1 << bit % 8
        assert sample(g1, wireless_remote=remote).pressed == {name}
    assert sample(g1, wireless_remote=np.zeros(40, np.uint8)).pressed == frozenset()
