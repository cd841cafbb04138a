"""Conversions between high-rate messages and state types: fast for the usual layout, and always validated.

Decoders take the serialised bytes of a raw subscription. Joint values are keyed by name and reordered to the robot's
order. Missing, unknown or duplicate names, NaN and infinity are refused; the error names field and joint.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence
from typing import Any, Generic, TypeVar

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState
from trajectory_msgs.msg import JointTrajectory as JointTrajectoryMsg
from trajectory_msgs.msg import JointTrajectoryPoint

from models.errors import JointNameError, MessageError, TrajectoryError
from models.nodes.cdr import NANOSECONDS, Template, field_of, numbers_of, stamp_of
from models.robot_model import RobotModel
from models.types import JointCommand, JointTrajectory, Mode, Vector

UNKNOWN_COVARIANCE = -1.0  #: First element of the covariance of a quantity that is not measured (sensor_msgs/Imu)


def to_ns(t: float) -> int:
    """Seconds to nanoseconds, rounded; exact for stamps of whole nanoseconds."""
    return round(t * NANOSECONDS)


def to_seconds(stamp_ns: int) -> float:
    """Nanoseconds to seconds [s]."""
    return stamp_ns / NANOSECONDS


def stamp_ns(stamp: Any) -> int:
    """builtin_interfaces/Time to nanoseconds."""
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


def set_stamp(stamp: Any, ns: int) -> None:
    """Write nanoseconds into a builtin_interfaces/Time."""
    stamp.sec, stamp.nanosec = divmod(ns, NANOSECONDS)


def clock_message(ns: int) -> Clock:
    """rosgraph_msgs/Clock of a time [ns]."""
    message = Clock()
    set_stamp(message.clock, ns)
    return message


def set_header(message: Any, stamp: int, frame_id: str) -> None:
    """Set stamp [ns] and frame of a stamped message."""
    set_stamp(message.header.stamp, stamp)
    message.header.frame_id = frame_id


def doubles(values: Vector) -> array[float]:
    """Array for a float64 message field; rclpy would copy a list element by element."""
    return array("d", np.ascontiguousarray(values, dtype=np.float64).tobytes())


def decode(data: bytes, kind: type) -> Any:
    """Decode a whole message; ``MessageError`` if the bytes are not of this type."""
    try:
        return deserialize_message(data, kind)
    except Exception as error:  # rclpy raises RuntimeError and RCLError, by version
        raise MessageError(f"{kind.__name__}: cannot be decoded: {error}") from error


def require_finite(field: str, values: Vector, names: tuple[str, ...] | None = None) -> None:
    """Raise ``MessageError`` for NaN and infinity, naming the field and the joint, if ``names`` are given."""
    finite = np.isfinite(values)
    if b"\0" in finite.tobytes():  # runs on every tick; ``finite.all()`` takes twice as long
        i = int(np.flatnonzero(~finite)[0])
        raise MessageError(f"{field} of {names[i] if names else f'element {i}'} is {values[i]}")


S = TypeVar("S", bound=tuple[Any, ...])  #: Stamp [ns] and the numbers of each field


class Codec(Generic[S]):
    """Converts serialised messages in which only the numbers of ``fields`` change.

    Args:
        message: Prototype with strings and array sizes.
        fields: Paths of the numeric fields; see ``models.nodes.cdr.field_of``.
        fixed: Paths of fields that must equal those of the prototype.
        names: Names of the numbers of each field, for errors; their index when None.
    """

    def __init__(
        self, message: Any, fields: Sequence[str], fixed: Sequence[str] = (), names: tuple[str, ...] | None = None
    ) -> None:
        self._kind, self._fields, self._names = type(message), fields, names
        self._fixed = {path: field_of(message, path) for path in fixed}
        self._template = Template(message, fields)

    def encode(self, stamp: int, *values: Vector) -> bytes:
        """Serialised message from a stamp [ns] and the numbers of each field."""
        return self._template.pack(stamp, values)

    def decode(self, data: bytes) -> S:
        """Stamp [ns] and the numbers of each field.

        Raises ``MessageError`` for NaN, infinity, bad sizes, a bad stamp, or a difference in a fixed field.
        """
        values = self._unpack(data)
        for field, numbers in zip(self._fields, values, strict=True):
            require_finite(field, numbers, self._names)
        return (stamp_of(data), *values)  # type: ignore[return-value]

    def read(self, data: bytes) -> S:
        """Like ``decode``, but accepts NaN, infinity and any stamp, for logs."""
        values = self._unpack(data)
        return (stamp_of(data, logged=True), *values)  # type: ignore[return-value]

    def _unpack(self, data: bytes) -> list[Vector]:
        values = self._template.unpack(data)
        return self._values(decode(data, self._kind)) if values is None else values

    def _values(self, message: Any) -> list[Vector]:
        for path, expected in self._fixed.items():
            if (found := field_of(message, path)) != expected:
                raise MessageError(f"{path} is '{found}', expected '{expected}'")
        return [numbers_of(field_of(message, path)) for path in self._fields]


class JointCodec(Codec[S]):
    """sensor_msgs/JointState with all joints of one robot: numbers (nj,) of ``fields``.

    Order of ``RobotModel.joint_names``. Raises ``JointNameError`` for a missing, unknown or duplicate joint.
    """

    def __init__(self, model: RobotModel, fields: Sequence[str]) -> None:
        self._model = model
        message = JointState(name=list(model.joint_names), **dict.fromkeys(fields, [0.0] * model.nj))
        super().__init__(message, fields, names=model.joint_names)

    def _values(self, message: Any) -> list[Vector]:
        return ordered(self._model, message.name, message, self._fields)


class JointStateCodec(JointCodec[tuple[int, Vector, Vector, Vector]]):
    """Positions [rad], velocities [rad/s] and torques [N.m]."""

    def __init__(self, model: RobotModel) -> None:
        super().__init__(model, ("position", "velocity", "effort"))


class TorqueCodec(JointCodec[tuple[int, Vector]]):
    """Torques [N.m]; no positions and no velocities."""

    def __init__(self, model: RobotModel) -> None:
        super().__init__(model, ("effort",))


def ordered(model: RobotModel, names: Sequence[str], message: Any, fields: Sequence[str]) -> list[Vector]:
    """Values (nj,) of the fields of a message with joint ``names``, in the order of ``RobotModel.joint_names``.

    Raises ``JointNameError`` for a missing, unknown or duplicate name, ``MessageError`` for a field of wrong size.
    """
    found = [(field, np.frombuffer(getattr(message, field), dtype=np.float64)) for field in fields]
    for field, numbers in found:
        if len(numbers) != len(names):
            raise MessageError(f"{field}: {len(numbers)} values for {len(names)} names")
    return [model.reorder(list(names), numbers) for _, numbers in found]


class ImuCodec(Codec[tuple[int, Vector, Vector]]):
    """sensor_msgs/Imu: gyro (3,) [rad/s] and accelerometer (3,) [m/s^2] only (``imu/data_raw`` of REP-145)."""

    def __init__(self, frame_id: str) -> None:
        message = Imu()
        message.header.frame_id = frame_id
        message.orientation_covariance[0] = UNKNOWN_COVARIANCE
        super().__init__(message, ("angular_velocity", "linear_acceleration"), ("header.frame_id",))


class WrenchCodec(Codec[tuple[int, Vector]]):
    """geometry_msgs/WrenchStamped of one sole: ground reaction in the sole frame (6,) [N, N.m]."""

    def __init__(self, frame_id: str) -> None:
        message = WrenchStamped()
        message.header.frame_id = frame_id
        super().__init__(message, ("wrench",), ("header.frame_id",))


class JointCommandCodec:
    """trajectory_msgs/JointTrajectory of one point: positions, velocities and feed-forward torques of all joints.

    The stamp is the stamp of the sensor samples used to compute the command.
    """

    def __init__(self, model: RobotModel) -> None:
        self._model, zero = model, [0.0] * model.nj
        point = JointTrajectoryPoint(**dict.fromkeys(_FIELDS, zero))
        message = JointTrajectoryMsg(joint_names=list(model.joint_names), points=[point])
        self._template = Template(message, [f"points.0.{field}" for field in _FIELDS])

    def encode(self, stamp: int, command: JointCommand) -> bytes:
        """Serialised message from a stamp [ns] and a command."""
        return self._template.pack(stamp, (command.q, command.v, command.tau))

    def decode(self, data: bytes) -> tuple[int, JointCommand | JointTrajectory]:
        """Stamp [ns] and an immediate setpoint, or a trajectory to interpolate.

        Raises ``JointNameError`` for a missing, unknown or duplicate joint of a setpoint, ``MessageError`` for a wrong
        size, NaN or infinity in a setpoint, or a bad stamp. ``validate_trajectory`` checks trajectories.
        """
        values = self._template.unpack(data)
        if values is None:
            message = decode(data, JointTrajectoryMsg)
            if not _is_setpoint(message):
                return stamp_of(data), trajectory_from_message(message)
            values = ordered(self._model, message.joint_names, message.points[0], _FIELDS)
        for field, numbers in zip(_FIELDS, values, strict=True):
            require_finite(field, numbers, self._model.joint_names)
        return stamp_of(data), JointCommand(*values)


_FIELDS = ("positions", "velocities", "effort")  #: Fields of a point, in the order of ``JointCommand``


def _is_setpoint(message: Any) -> bool:
    """Whether a message is an output of the whole-body controller: one immediate point with torques."""
    if len(message.points) != 1 or not message.points[0].effort:
        return False
    due = message.points[0].time_from_start
    return bool(due.sec == 0 and due.nanosec == 0)


def trajectory_from_message(message: Any) -> JointTrajectory:
    """trajectory_msgs/JointTrajectory to ``JointTrajectory``.

    Raises ``JointNameError`` for a duplicate name, ``TrajectoryError`` without joints or for points of wrong size.
    """
    names = tuple(message.joint_names)
    if not names:
        raise TrajectoryError("joint_names: empty")
    if len(set(names)) != len(names):
        raise JointNameError(f"joint_names: '{next(n for n in names if names.count(n) > 1)}' is given twice")
    return JointTrajectory(
        names,
        np.array([to_seconds(stamp_ns(p.time_from_start)) for p in message.points]),
        _column(message, "positions", len(names)),
        _column(message, "velocities", len(names)) if any(len(p.velocities) for p in message.points) else None,
        _column(message, "effort", len(names)) if any(len(p.effort) for p in message.points) else None,
    )


def trajectory_to_message(trajectory: JointTrajectory) -> JointTrajectoryMsg:
    """``JointTrajectory`` to trajectory_msgs/JointTrajectory, with a zero stamp, which means an immediate start."""
    message = JointTrajectoryMsg(joint_names=list(trajectory.joint_names))
    for i, t in enumerate(trajectory.times):
        point = JointTrajectoryPoint(positions=doubles(trajectory.positions[i]))
        if trajectory.velocities is not None:
            point.velocities = doubles(trajectory.velocities[i])
        if trajectory.efforts is not None:
            point.effort = doubles(trajectory.efforts[i])
        set_stamp(point.time_from_start, to_ns(float(t)))
        message.points.append(point)
    return message


def _column(message: Any, field: str, size: int) -> Vector:
    for i, point in enumerate(message.points):
        if len(getattr(point, field)) != size:
            raise TrajectoryError(f"{field}: point {i} has {len(getattr(point, field))} values for {size} joints")
    return np.array([list(getattr(p, field)) for p in message.points], dtype=np.float64).reshape(-1, size)


PAN, TILT = "pan", "tilt"  #: Names in the messages; the profile maps them to joints


def head_message(stamp: int, pan: float, tilt: float) -> Any:
    """sensor_msgs/JointState of pan and tilt [rad] with a stamp [ns]."""
    message = JointState(name=[PAN, TILT], position=[pan, tilt])
    set_stamp(message.header.stamp, stamp)
    return message


def head_from_message(message: Any) -> tuple[float, float]:
    """Pan and tilt [rad] of a sensor_msgs/JointState; velocities and efforts are ignored.

    Raises ``MessageError`` unless the names are exactly ``pan`` and ``tilt``, with one finite position each.
    """
    names = list(message.name)
    if sorted(names) != [PAN, TILT]:
        raise MessageError(f"name: {names[:4]}, expected '{PAN}' and '{TILT}'")
    if len(message.position) != len(names):
        raise MessageError(f"position: {len(message.position)} values for {len(names)} names")
    angles = dict(zip(names, message.position, strict=True))
    for name, angle in angles.items():
        if not math.isfinite(angle):
            raise MessageError(f"{name}: {angle} rad is not finite")
    return float(angles[PAN]), float(angles[TILT])


MODES = {mode.value: mode for mode in Mode}  #: Mode by name


def mode_named(word: str) -> Mode:
    """Mode by name; ``MessageError`` lists the valid names."""
    if word not in MODES:
        raise MessageError(f"unknown mode '{word[:32]}'; known: {', '.join(MODES)}")
    return MODES[word]
