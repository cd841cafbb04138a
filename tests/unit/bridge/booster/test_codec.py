"""Bytes and marks of Booster's protocol; the joints of a model in another order than the motors."""

from pathlib import Path

import numpy as np
import pytest

from bridge.plants.booster.codec import (
    BUTTONS,
    REMOTE,
    BoosterCodec,
    BoosterConfig,
    RemoteController,
    Stamped,
    low_cmd,
    low_state,
    pack,
    read_config,
    unpack,
)
from bridge.plants.booster.guard import BoosterGuard
from bridge.plants.hardware import RobotClock, real_robot, session
from models.errors import ConfigError, MessageError
from models.robot_model import RobotModel
from models.types import JointCommand
from tests.booster.robot import write_profiles

pytestmark = pytest.mark.ros
RNG = np.random.default_rng(3)
SILENCE = real_robot().silence_max
NS = 1_000_000_000


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> RobotModel:
    return RobotModel.load(write_profiles(tmp_path_factory.mktemp("t1"))[1])


@pytest.fixture(scope="module")
def config() -> BoosterConfig:
    return read_config({})


def codec_of(model: RobotModel, config: BoosterConfig, session: int = 0, *, guard: bool = False) -> BoosterCodec:
    return BoosterCodec(model, config, RobotClock(0.002, 2.0, 1.0 / NS, 1 << 63), session, guard=guard)


def random_command(model: RobotModel) -> JointCommand:
    return JointCommand(*RNG.normal(size=(5, model.nj)).astype(np.float32).astype(np.float64))


def random_state(motors: int) -> np.ndarray:
    record = np.zeros(1, low_state(motors))[0]
    record["parallel_size"] = record["serial_size"] = motors
    for name in ("rpy", "gyro", "acc"):
        record[name] = RNG.normal(size=3)
    for kind in ("parallel", "serial"):
        for name in ("q", "dq", "ddq", "tau_est"):
            record[kind][name] = RNG.normal(size=motors)
        record[kind]["temperature"], record[kind]["lost"] = RNG.integers(20, 60, motors), RNG.integers(0, 9, motors)
        record[kind]["reserve"] = RNG.integers(0, 256, (motors, 2))
    return record


def test_a_state_has_the_serial_motors_by_the_names_of_the_joints(model: RobotModel, config: BoosterConfig) -> None:
    record, codec = random_state(model.nj), codec_of(model, config)
    sample = codec.decode(Stamped(True, pack(record), 5 * NS))
    knee, motor = model.joint_names.index("Right_Knee_Pitch"), 20  # JointIndex of Booster's SDK
    for values, name in ((sample.sensors.q, "q"), (sample.sensors.v, "dq"), (sample.sensors.tau, "tau_est")):
        assert values[knee] == record["serial"][name][motor]
    assert sample.temperature[knee, 0] == record["serial"]["temperature"][motor]
    assert sample.motor_state[knee] == record["serial"]["reserve"][motor, 0]
    np.testing.assert_array_equal(sample.sensors.accel, record["acc"].astype(np.float64))
    first = sample.sensors.t
    assert codec.decode(Stamped(True, pack(record), 5 * NS + NS // 100)).sensors.t == pytest.approx(first + 0.01)


def test_a_command_returns_and_its_ankles_are_pitch_and_roll(model: RobotModel, config: BoosterConfig) -> None:
    command, codec = random_command(model), codec_of(model, config)
    data = codec.encode(command)
    record = unpack("low_cmd", data, low_cmd(model.nj))
    assert record["cmd_type"] == 1 and record["size"] == 23 and len(data) == 656
    assert record["motors"]["q"][16] == command.q[model.joint_names.index("Left_Ankle_Roll")]
    np.testing.assert_allclose(record["motors"]["weight"], 1.0, atol=2e-5)
    found = codec.decode_command(data)
    for name in ("q", "v", "tau", "kp", "kd"):
        np.testing.assert_array_equal(getattr(found, name), getattr(command, name))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda record: record["serial"]["q"].__setitem__(4, np.nan), "not finite"),
        (lambda record: record.__setitem__("serial_size", 22), "22 motors instead of 23"),
    ],
)
def test_states_that_cannot_be_used(model: RobotModel, config: BoosterConfig, change: object, reason: str) -> None:
    record = random_state(model.nj)
    change(record)  # type: ignore[operator]
    with pytest.raises(MessageError, match=reason):
        codec_of(model, config).decode(Stamped(True, pack(record)))


def test_a_state_of_another_size_is_refused_and_padding_is_not(model: RobotModel, config: BoosterConfig) -> None:
    data, codec = pack(random_state(model.nj)), codec_of(model, config)
    codec.decode(Stamped(True, data + b"\0\0\0"))
    for wrong in (data[:-1], data + b"\0\0\0\0", b"\0\x07" + data[2:]):
        with pytest.raises(MessageError, match="another number of motors"):
            codec.decode(Stamped(True, wrong))


def test_commands_of_other_programs_are_recognised(model: RobotModel, config: BoosterConfig) -> None:
    command, own = random_command(model), codec_of(model, config, 0xA1B2C3D4)
    assert not own.is_foreign(own.encode(command))
    assert not own.is_foreign(codec_of(model, config, 0xA1B2C3D4, guard=True).encode(command))
    for guard in (False, True):  # of another graph
        assert own.is_foreign(codec_of(model, config, 0xA1B2C3D5, guard=guard).encode(command))
    for weight in (0.0, 0.5, 1.0):  # of Booster's own programs
        record = np.zeros(1, low_cmd(model.nj))[0]
        record["size"], record["motors"]["weight"] = model.nj, weight
        assert own.is_foreign(pack(record))
    assert own.is_foreign(b"\0\1\0\0short")


def test_the_guard_damps_after_the_silence_and_not_after_the_last_command(
    model: RobotModel, config: BoosterConfig
) -> None:
    guard, codec, command = BoosterGuard(model, {}), codec_of(model, config, session()), random_command(model)
    guard.receive(pack(np.zeros(1, low_cmd(model.nj))[0]), 0.0)
    assert guard.foreign == 1 and not guard.armed
    guard.receive(codec_of(model, config, session() ^ 1).encode(command), 0.5)  # a driver of another graph
    assert guard.foreign == 2 and not guard.armed
    guard.receive(codec.encode(command), 1.0)
    assert guard.step(1.0 + 0.9 * SILENCE) is None
    made = guard.step(1.0 + 1.1 * SILENCE)
    assert made is not None and guard.active and not codec.is_foreign(made)
    guard.receive(made, 1.03)  # it receives its own
    later = guard.step(2.0)
    assert later is not None and guard.foreign == 2
    damping = codec.decode_command(later)
    assert not np.any(damping.kp) and not np.any(damping.tau) and np.all(damping.kd)
    guard.receive(codec.encode(command, last=True), 2.1)
    assert not guard.armed and guard.step(3.0) is None


def test_buttons_of_the_remote_controller() -> None:
    record = np.zeros(1, REMOTE)[0]
    record["buttons"][[BUTTONS.index("lt"), BUTTONS.index("back")]] = 1
    assert RemoteController(1.0, 60.0).receive(pack(record)) == {"lt", "back"}


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"rate": 20.0}, "rate"),
        ({"clock": "tick"}, "clock"),
        ({"joints": ["a"] * 6}, "repeated"),
        ({"imu_eror": 1.0}, "imu_eror"),
    ],
)
def test_wrong_options_are_refused_by_name(options: dict[str, object], reason: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=reason):
        read_config(options)
