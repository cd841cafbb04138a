"""LowState to sensor data, joint commands to LowCmd, and the buttons of the remote controller."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bridge.plants.hardware import RobotClock
from bridge.plants.monitors import LowSample
from bridge.plants.unitree.wire import LOW_CMD, LOW_STATE, MOTORS
from models.errors import ConfigError, MessageError
from models.robot_model import RobotModel
from models.types import JointCommand, SensorData, Vector

#: Joints of a G1 with 29 degrees of freedom in the order of its motors
G1_JOINTS = tuple(
    f"{name}_joint"
    for name in (
        *(f"{side}_{joint}" for side in ("left", "right") for joint in (
            "hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")),
        "waist_yaw", "waist_roll", "waist_pitch",
        *(f"{side}_{joint}" for side in ("left", "right") for joint in (
            "shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow", "wrist_roll", "wrist_pitch", "wrist_yaw")),
    )
)  # fmt: skip
PITCH_ROLL = 0  #: ``mode_pr``: ankles are commanded by pitch and roll
ENABLED = 1  #: ``mode`` of a drive that executes its command
#: First reserved word of a LowCmd of the driver and of its guard; the robot ignores it
MARK, GUARD_MARK = 0x504F4953, 0x504F4947
_MARK_AT, _SESSION_AT = -20, -12  #: Offsets of that word and of the session from the end of a serialised LowCmd [bytes]
#: Buttons of the remote controller by bit, from byte 2 of ``wireless_remote``
BUTTONS = ("R1", "L1", "start", "select", "R2", "L2", "F1", "F2", "A", "B", "X", "Y", "up", "right", "down", "left")
PRESS_IT = "press it, to check that it is received"  #: Part of the finding that asks for a stop button
RATES = (500.0, 1000.0)  #: Supported rates of state and command [Hz]
SPEED_MIN = 0.1  #: Least speed of a simulated robot; the guard's ``silence_max`` over it must be below ``guard_time``
_XYZW = [1, 2, 3, 0]  #: Indices that reorder a quaternion from wxyz to xyzw
_BUTTONS_AT = 2  #: Offset of the first eight buttons in ``wireless_remote`` [bytes]


def read_times(options: Mapping[str, Any]) -> tuple[float, float]:
    """``rate`` [Hz] and ``speed`` [-] in the options of a ``UnitreePlant``; ``ConfigError`` for unsupported values."""
    rate, speed = options.get("rate", RATES[0]), options.get("speed", 1.0)
    if rate not in RATES:
        raise ConfigError(f"rate: {rate!r} Hz; the robot runs at {' or '.join(f'{each:g}' for each in RATES)} Hz")
    if type(speed) not in (int, float) or not SPEED_MIN <= speed <= 1.0:
        raise ConfigError(f"speed: {speed!r} is not a number from {SPEED_MIN:g} to 1, the speed of a real robot")
    return float(rate), float(speed)


@dataclass(frozen=True, slots=True)
class UnitreeSample(LowSample):
    """Contents of one LowState; each motor has the temperatures of its housing and its winding."""

    tick: int  #: Tick of the robot [ms]
    mode_machine: int  #: Type of the robot
    quaternion: Vector  #: Orientation of the IMU estimated by the robot, xyzw (4,)
    remote: bytes  #: State of the remote controller, ``wireless_remote``

    @property
    def pressed(self) -> frozenset[str]:
        """Pressed buttons of the remote controller."""
        word = int.from_bytes(self.remote[_BUTTONS_AT : _BUTTONS_AT + 2], "little")
        return frozenset(name for bit, name in enumerate(BUTTONS) if word >> bit & 1) if word else frozenset()


class UnitreeCodec:
    """Converts between serialised messages and the records of this project.

    The motors are in the order of the joints of ``model``; ``ConfigError`` for a robot with other joints than the G1.
    Foot wrenches are NaN, because the robot does not measure them. A LowCmd contains the ``session`` of its driver.
    """

    def __init__(self, model: RobotModel, clock: RobotClock, session: int = 0) -> None:
        if model.joint_names != G1_JOINTS:
            raise ConfigError(
                f"robot '{model.name}': unitree_hg is known for the 29 joints of a G1 in their order; this robot has "
                f"{model.nj} joints; use a profile that extends g1"
            )
        self._nj, self._clock = model.nj, clock
        self._wrenches = np.full((2, 6), np.nan)
        self._record = LOW_CMD.new()
        self._record["mode_pr"] = PITCH_ROLL
        self._record["reserve"][0], self._record["reserve"][2] = MARK, session
        self._motors = self._record["motor_cmd"][: self._nj]
        self._motors["mode"] = ENABLED
        self._kp, self._kd = model.kp, model.kd

    def decode(self, data: bytes) -> UnitreeSample:
        """Decode a serialised LowState; ``MessageError`` for a wrong size or checksum, or non-finite values."""
        record = LOW_STATE.read(data)
        motors = record["motor_state"][: self._nj]
        measured = [motors[name] for name in ("q", "dq", "tau_est")]
        imu = [record[name] for name in ("quaternion", "gyroscope", "accelerometer")]
        if not np.isfinite(np.concatenate([*measured, *imu])).all():
            raise MessageError("lowstate: joints or IMU are not finite")
        tick = int(record["tick"])
        sensors = SensorData(
            t=self._clock.step(tick),
            q=motors["q"].astype(np.float64),
            v=motors["dq"].astype(np.float64),
            tau=motors["tau_est"].astype(np.float64),
            gyro=record["gyroscope"].astype(np.float64),
            accel=record["accelerometer"].astype(np.float64),
            wrenches=self._wrenches,
        )
        return UnitreeSample(
            tick=tick,
            mode_machine=int(record["mode_machine"]),
            sensors=sensors,
            quaternion=record["quaternion"].astype(np.float64)[_XYZW],
            temperature=motors["temperature"].astype(np.float64),
            voltage=motors["vol"].astype(np.float64),
            motor_state=motors["motorstate"].astype(np.float64),
            remote=record["wireless_remote"].tobytes(),
        )

    def encode(self, command: JointCommand, mode_machine: int, tick: int = 0, last: bool = False) -> bytes:
        """Serialised LowCmd of a command, with the robot's ``mode_machine`` and newest ``tick`` [ms].

        A command with ``last`` disarms the guard.
        """
        set_command(self._motors, command, self._kp, self._kd)
        self._record["mode_machine"], self._record["reserve"][1] = mode_machine, tick
        self._record["reserve"][3] = last
        return LOW_CMD.write(self._record)


def set_command(motors: Any, command: JointCommand, kp: Vector, kd: Vector) -> None:
    """Write a command to the motors of a LowCmd record, with default gains ``kp`` and ``kd`` (nj,)."""
    motors["q"], motors["dq"], motors["tau"] = command.q, command.v, command.tau
    motors["kp"] = kp if command.kp is None else command.kp
    motors["kd"] = kd if command.kd is None else command.kd


def is_foreign(data: bytes, session: int) -> bool:
    """Whether a serialised LowCmd is neither of the driver nor of the guard of a session; ignores the checksum."""
    mark, other = (int.from_bytes(data[at : at + 4], "little") for at in (_MARK_AT, _SESSION_AT))
    return mark not in (MARK, GUARD_MARK) or other != session


def joint_command(record: Any, nj: int) -> JointCommand:
    """Command of the first ``nj`` motors in a LowCmd record; gains and torque of a disabled drive are zero."""
    motors = record["motor_cmd"][: min(nj, MOTORS)]
    on = (motors["mode"] == ENABLED).astype(np.float64)
    return JointCommand(
        q=motors["q"].astype(np.float64),
        v=motors["dq"].astype(np.float64),
        tau=on * motors["tau"],
        kp=on * motors["kp"],
        kd=on * motors["kd"],
    )
