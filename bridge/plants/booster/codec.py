"""LowState and RemoteControllerState to sensor data and buttons, joint commands to LowCmd.

The messages have no checksum, no time and no reserved words. The time is taken from DDS (``Stamped``). Ankles have a
parallel set of motors (cranks) and a serial one (pitch and roll); the serial set is read and commanded. A motor's
``weight`` has no effect in mode ``custom``, in which the robot executes LowCmds. The weights of the first motors
therefore encode the sender: a byte n is the weight 1 - n ``WEIGHT_STEP``.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass as config_dataclass

from bridge.plants.hardware import RobotClock
from bridge.plants.monitors import LowSample
from models.config import STRICT, Positive, default_config, overlaid
from models.errors import ConfigError, MessageError
from models.robot_model import RobotModel
from models.types import JointCommand, SensorData, Vector

ENCAPSULATION = b"\x00\x01\x00\x00"  #: Header of a serialised message: XCDR1, little-endian
PADDING = 4  #: Serialised messages are padded to a multiple of this size [bytes]
_MOTOR_STATE = np.dtype([
    ("mode", "i1"), ("pad", "u1", 3), ("q", "<f4"), ("dq", "<f4"), ("ddq", "<f4"), ("tau_est", "<f4"),
    ("temperature", "i1"), ("pad2", "u1", 3), ("lost", "<u4"), ("reserve", "<u4", 2),
])  # fmt: skip
_MOTOR_CMD = np.dtype([
    ("mode", "i1"), ("pad", "u1", 3), ("q", "<f4"), ("dq", "<f4"), ("tau", "<f4"), ("kp", "<f4"), ("kd", "<f4"),
    ("weight", "<f4"),
])  # fmt: skip
#: Buttons of the remote controller in the order of the message, after the event and four floats
BUTTONS = (
    "a", "b", "x", "y", "lb", "rb", "lt", "rt", "ls", "rs", "back", "start", "hat_c", "hat_u", "hat_d", "hat_l",
    "hat_r", "hat_lu", "hat_ld", "hat_ru", "hat_rd",
)  # fmt: skip
REMOTE = np.dtype([("event", "<u4"), ("sticks", "<f4", 4), ("buttons", "u1", len(BUTTONS)), ("hat_pos", "u1")])
REMOVED = 0x606  #: Event of SDL 2: remote controller disconnected
DAMPING, PREPARE, CUSTOM = 0, 1, 3  #: Modes of the robot
#: Name of each mode in which the vendor's controller is active
MODES: Mapping[int, str] = {DAMPING: "damping", PREPARE: "prepare", 2: "walking", 4: "soccer"}
SERIAL = 1  #: ``cmd_type``: ankles are commanded by pitch and roll
MARK, GUARD_MARK = 0x50, 0x47  #: First byte of the marks of the driver and of its guard
WEIGHT_STEP = 2.0**-24  #: Difference between adjacent weights below 1 [-]
_MARKS = 6  #: Bytes of a mark: sender, session (4), whether it is the last command


@config_dataclass(frozen=True, slots=True, config=STRICT)
class BoosterConfig:
    """Schema of ``bridge/config/booster.yaml``, which has units and meanings."""

    rate: Annotated[float, Field(ge=100.0, le=1000.0)]
    clock: Literal["stamp", "count"]
    imu_error: Positive
    imu_window: Positive
    mode_period: Positive
    remote_age_max: Positive
    remote_event_age_max: Positive
    finish_time: Positive
    joints: Annotated[tuple[str, ...], Field(min_length=_MARKS)]

    def __post_init__(self) -> None:
        if len(set(self.joints)) != len(self.joints):
            raise ValueError("joints: a name is repeated")


def read_config(options: Mapping[str, Any]) -> BoosterConfig:
    """The packaged options, overlaid by given ones with nested keys; ``ConfigError`` names every wrong key."""
    return overlaid(default_config(BoosterConfig, "bridge", "booster"), options, "plant booster")


class Stamped(NamedTuple):
    """A serialised message with its DDS source time and number."""

    state: bool  # True for a LowState, False for a RemoteControllerState
    data: bytes
    time: int = 0  # source time by the robot's clock [ns]
    number: int = 0  # sequence number of the publisher


@dataclass(frozen=True, slots=True)
class BoosterSample(LowSample):
    """Contents of one LowState; voltages are not measured."""

    rpy: Vector  #: Orientation of the IMU estimated by the robot: roll, pitch, yaw (3,) [rad]


def low_state(motors: int) -> np.dtype[Any]:
    """Layout of a LowState with a number of motors."""
    counted = [("parallel_size", "<u4"), ("parallel", _MOTOR_STATE, motors)]
    counted += [("serial_size", "<u4"), ("serial", _MOTOR_STATE, motors)]
    return np.dtype([("rpy", "<f4", 3), ("gyro", "<f4", 3), ("acc", "<f4", 3), *counted])


def low_cmd(motors: int) -> np.dtype[Any]:
    """Layout of a LowCmd with a number of motors."""
    return np.dtype([("cmd_type", "i1"), ("pad", "u1", 3), ("size", "<u4"), ("motors", _MOTOR_CMD, motors)])


def pack(record: Any) -> bytes:
    """Serialise a record."""
    return ENCAPSULATION + bytes(record.tobytes())


def unpack(name: str, data: bytes, layout: np.dtype[Any]) -> Any:
    """Record of a serialised message; ``MessageError`` for a wrong size."""
    expected = layout.itemsize + len(ENCAPSULATION)
    if not 0 <= len(data) - expected < PADDING or data[:2] != ENCAPSULATION[:2]:
        raise MessageError(
            f"{name}: {len(data)} bytes, {expected} in little-endian XCDR1 expected: another number of motors?"
        )
    return np.frombuffer(data, layout, 1, len(ENCAPSULATION))[0]


class RemoteController:
    """Monitors the connection of the robot's remote controller by its RemoteControllerStates.

    A remote controller sends its state either periodically, which two equal messages in succession show, or only on
    events. With periodic messages, a silence of ``age_max`` [s] is a lost connection. With events only, the protocol
    does not distinguish a lost connection from idle buttons: the operator must use one every ``event_age_max`` [s].
    """

    def __init__(self, age_max: float, event_age_max: float) -> None:
        self._age_max, self._event_age_max = age_max, event_age_max
        self._data = b""  # newest message
        self._periodic = False
        self.age = 0.0  #: Age of that message [s]
        self.served = True  #: Whether a program on the robot publishes the messages
        self._removed = False

    def step(self, dt: float) -> None:
        """Advance the age by a time [s]."""
        self.age += dt

    def receive(self, data: bytes) -> frozenset[str]:
        """Pressed buttons in a serialised RemoteControllerState; ``MessageError`` for a wrong size."""
        record = unpack("remote_controller_state", data, REMOTE)
        self._periodic |= data == self._data
        self._data, self.age, self._removed = data, 0.0, bool(record["event"] == REMOVED)
        return frozenset(name for name, value in zip(BUTTONS, record["buttons"], strict=True) if value)

    @property
    def fault(self) -> str:
        """Why a stop button has no effect; empty when it has one."""
        if not self._data:
            why = "no remote_controller_state yet"
        elif self._removed:
            why = "the remote controller is disconnected"
        elif not self.served:
            why = "the robot's program for the remote controller has ended"
        elif self.age > (limit := self._age_max if self._periodic else self._event_age_max):
            why = f"no remote_controller_state for more than {limit:g} s"
        else:
            return ""
        return f"{why}, so its stop button is without effect: switch it on and press a button"


class BoosterCodec:
    """Converts between serialised messages and the records of this project.

    ``config`` names the motors in their order; ``model`` may have its joints in another order. Raises ``ConfigError``
    for a robot with other joints. Foot wrenches are NaN, because the robot does not measure them. A LowCmd contains the
    ``session`` of its graph, and the mark of the guard if ``guard``, else of the driver.
    """

    def __init__(
        self, model: RobotModel, config: BoosterConfig, clock: RobotClock, session: int = 0, *, guard: bool = False
    ) -> None:
        names = model.joint_names
        if set(names) != set(config.joints):
            other = sorted(set(names).symmetric_difference(config.joints))
            raise ConfigError(
                f"robot '{model.name}': plant booster needs exactly the joints of its motors, which are 'joints' of "
                f"--plant-options; {len(other)} differ: {', '.join(other[:4])}{', ...' * (len(other) > 4)}"
            )
        self._model, self._config, self._clock = model, config, clock
        self._motors = np.array([config.joints.index(name) for name in names])  # motor of each joint (nj,)
        self._state, self._layout = low_state(len(names)), low_cmd(len(names))
        self._wrenches, self._voltage = np.full((2, 6), np.nan), np.zeros(model.nj)
        self._record = np.zeros(1, self._layout)[0]
        self._record["cmd_type"], self._record["size"] = SERIAL, len(names)
        mark = bytes([GUARD_MARK if guard else MARK]) + session.to_bytes(4, "little")
        self._mark = np.frombuffer(mark, np.uint8)

    def decode(self, message: Stamped) -> BoosterSample:
        """Decode a LowState; ``MessageError`` for another number of motors, or non-finite values."""
        record = unpack("low_state", message.data, self._state)
        count = len(self._motors)
        if record["serial_size"] != count or record["parallel_size"] != count:
            raise MessageError(f"low_state: {record['serial_size']} motors instead of {count}")
        motors = record["serial"][self._motors]
        q, v, tau = (motors[name].astype(np.float64) for name in ("q", "dq", "tau_est"))
        rpy, gyro, accel = (record[name].astype(np.float64) for name in ("rpy", "gyro", "acc"))
        if not np.isfinite(np.concatenate([q, v, tau, rpy, gyro, accel])).all():
            raise MessageError("low_state: joints or IMU are not finite")
        t = self._clock.step(message.time if self._config.clock == "stamp" else message.number)
        return BoosterSample(
            sensors=SensorData(t, q, v, tau, gyro, accel, self._wrenches),
            rpy=rpy,
            temperature=motors["temperature"].astype(np.float64)[:, None],
            voltage=self._voltage,
            motor_state=motors["reserve"][:, 0].astype(np.float64),
        )

    def encode(self, command: JointCommand, last: bool = False) -> bytes:
        """Serialised LowCmd of a command; one with ``last`` disarms the guard."""
        motors, model, order = self._record["motors"], self._model, self._motors
        motors["q"][order], motors["dq"][order], motors["tau"][order] = command.q, command.v, command.tau
        motors["kp"][order] = model.kp if command.kp is None else command.kp
        motors["kd"][order] = model.kd if command.kd is None else command.kd
        motors["weight"] = 1.0
        motors["weight"][:_MARKS] = 1.0 - WEIGHT_STEP * np.append(self._mark, last)
        return pack(self._record)

    def decode_command(self, data: bytes) -> JointCommand:
        """Command in a serialised LowCmd; ``MessageError`` for another number of motors, or for parallel ankles."""
        record = unpack("low_cmd", data, self._layout)
        if record["size"] != len(self._motors) or record["cmd_type"] != SERIAL:
            raise MessageError(f"low_cmd: {record['size']} motors with cmd_type {record['cmd_type']}")
        motors = record["motors"][self._motors]
        return JointCommand(*(motors[name].astype(np.float64) for name in ("q", "dq", "tau", "kp", "kd")))

    def mark(self, data: bytes) -> bytes:
        """Bytes of the mark in a serialised LowCmd; empty without a mark."""
        try:
            weights = unpack("low_cmd", data, self._layout)["motors"]["weight"][:_MARKS]
        except MessageError:
            return b""
        steps = (1.0 - weights.astype(np.float64)) / WEIGHT_STEP
        return bytes(steps.astype(np.uint8)) if ((steps >= 0.0) & (steps < 256.0)).all() else b""

    def is_foreign(self, data: bytes) -> bool:
        """Whether a serialised LowCmd is neither of the driver nor of the guard of this session."""
        mark = self.mark(data)
        return mark[1:-1] != self._mark[1:].tobytes() or mark[0] not in (MARK, GUARD_MARK)
