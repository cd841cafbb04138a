"""Conversions between hot messages and state types: fast for the usual layout, checked always.

Every decoder takes the serialised bytes of a raw subscription. Joint values are keyed by name: messages are reordered
to the robot's order; missing, unknown or duplicate names are refused, as are NaN and infinity, naming field and joint.
"""

from __future__ import annotations

import math
from array import array
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Imu, JointState
from trajectory_msgs.msg import JointTrajectory as JointTrajectoryMsg
from trajectory_msgs.msg import JointTrajectoryPoint

from models.errors import JointNameError, MessageError, TrajectoryError
from models.nodes.cdr import NANOSECONDS, Markers, Template, stamp_of
from models.robot_model import RobotModel
from models.types import JointCommand, JointTrajectory, Mode, Vector

UNKNOWN_COVARIANCE = -1.0  #: First element of a covariance whose quantity the sensor does not measure (sensor_msgs/Imu)


def to_ns(t: float) -> int:
    """Seconds to nanoseconds, rounded: exact for every stamp made of whole nanoseconds."""
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


def doubles(values: Vector) -> array[float]:
    """Array for a float64 message field; lists are copied an element at a time by rclpy."""
    return array("d", np.ascontiguousarray(values, dtype=np.float64).tobytes())


def decode(data: bytes, kind: type) -> Any:
    """Decode a whole message; ``MessageError`` when the bytes are no such message."""
    try:
        return deserialize_message(data, kind)
    except Exception as error:  # rclpy raises RuntimeError and RCLError, by version
        raise MessageError(f"{kind.__name__}: cannot be decoded: {error}") from error


def require_finite(field: str, values: Vector, names: tuple[str, ...] | None = None) -> None:
    """Raise ``MessageError`` for NaN and infinity, naming the field and, where given, the joint."""
    finite = np.isfinite(values)
    if b"\0" in finite.tobytes():  # every tick: ``finite.all()`` takes twice as long
        i = int(np.flatnonzero(~finite)[0])
        raise MessageError(f"{field} of {names[i] if names else f'element {i}'} is {values[i]}")


class JointStateCodec:
    """sensor_msgs/JointState with every joint of one robot, positions, velocities and efforts."""

    def __init__(self, model: RobotModel) -> None:
        self._model = model
        marks = Markers()
        slots = [marks.take(model.nj) for _ in range(3)]
        message = JointState(name=list(model.joint_names))
        message.position, message.velocity, message.effort = (doubles(slot) for slot in slots)
        self._template = Template(message, slots)

    def encode(self, stamp: int, q: Vector, v: Vector, tau: Vector) -> bytes:
        """Serialised message from a stamp [ns], positions, velocities and torques (nj,)."""
        return self._template.pack(stamp, (q, v, tau))

    def decode(self, data: bytes) -> tuple[int, Vector, Vector, Vector]:
        """Stamp [ns], positions, velocities, torques, each (nj,) in the order of ``RobotModel.joint_names``.

        Raises ``JointNameError`` for a missing, unknown or duplicate joint, ``MessageError`` for bad size or stamp, NaN
        or infinity.
        """
        stamp, *values = self.read(data)
        for field, array_ in zip(("position", "velocity", "effort"), values, strict=True):
            require_finite(field, array_, self._model.joint_names)
        return stamp, values[0], values[1], values[2]

    def read(self, data: bytes) -> tuple[int, Vector, Vector, Vector]:
        """Like ``decode``, but accepts NaN and infinity: for logs."""
        values = self._template.unpack(data)
        if values is None:
            values = self._reorder(decode(data, JointState))
        return stamp_of(data), values[0], values[1], values[2]

    def _reorder(self, message: Any) -> list[Vector]:
        names = list(message.name)
        values = []
        for field in ("position", "velocity", "effort"):
            numbers = np.frombuffer(getattr(message, field), dtype=np.float64)
            if len(numbers) != len(names):
                raise MessageError(f"{field}: {len(numbers)} values for {len(names)} names")
            values.append(self._model.reorder(names, numbers))
        return values


class ImuCodec:
    """sensor_msgs/Imu with angular velocity and specific force only (``imu/data_raw`` of REP-145)."""

    def __init__(self, frame_id: str) -> None:
        marks = Markers()
        slots = [marks.take(3) for _ in range(2)]
        message = Imu()
        message.header.frame_id = frame_id
        message.orientation_covariance[0] = UNKNOWN_COVARIANCE
        for vector, slot in ((message.angular_velocity, slots[0]), (message.linear_acceleration, slots[1])):
            vector.x, vector.y, vector.z = slot.tolist()
        self._frame_id = frame_id
        self._template = Template(message, slots)

    def encode(self, stamp: int, gyro: Vector, accel: Vector) -> bytes:
        """Serialised message from a stamp [ns], gyro (3,) [rad/s] and accelerometer (3,) [m/s^2]."""
        return self._template.pack(stamp, (gyro, accel))

    def decode(self, data: bytes) -> tuple[int, Vector, Vector]:
        """Stamp [ns], gyro and accelerometer (3,) in the IMU frame; ``MessageError``: other frame, NaN, infinity."""
        stamp, gyro, accel = self.read(data)
        require_finite("angular_velocity", gyro)
        require_finite("linear_acceleration", accel)
        return stamp, gyro, accel

    def read(self, data: bytes) -> tuple[int, Vector, Vector]:
        """Like ``decode``, but accepts NaN and infinity: for logs."""
        values = self._template.unpack(data)
        if values is None:
            message = decode(data, Imu)
            if message.header.frame_id != self._frame_id:
                raise MessageError(f"header.frame_id is '{message.header.frame_id}', expected '{self._frame_id}'")
            w, a = message.angular_velocity, message.linear_acceleration
            values = [np.array([w.x, w.y, w.z]), np.array([a.x, a.y, a.z])]
        return stamp_of(data), values[0], values[1]


class WrenchCodec:
    """geometry_msgs/WrenchStamped of one sole: ground reaction in the sole frame."""

    def __init__(self, frame_id: str) -> None:
        slots = [Markers().take(6)]
        message = WrenchStamped()
        message.header.frame_id = frame_id
        _fill_wrench(message.wrench, slots[0])
        self._frame_id = frame_id
        self._template = Template(message, slots)

    def encode(self, stamp: int, wrench: Vector) -> bytes:
        """Serialised message from a stamp [ns] and a wrench (6,) [N, N.m]."""
        return self._template.pack(stamp, (wrench,))

    def decode(self, data: bytes) -> tuple[int, Vector]:
        """Stamp [ns] and wrench (6,) in the sole frame; ``MessageError`` for another frame, NaN or infinity."""
        stamp, wrench = self.read(data)
        require_finite("wrench", wrench)
        return stamp, wrench

    def read(self, data: bytes) -> tuple[int, Vector]:
        """Like ``decode``, but accepts NaN and infinity: for logs."""
        values = self._template.unpack(data)
        if values is None:
            message = decode(data, WrenchStamped)
            if message.header.frame_id != self._frame_id:
                raise MessageError(f"header.frame_id is '{message.header.frame_id}', expected '{self._frame_id}'")
            values = [wrench_vector(message.wrench)]
        return stamp_of(data), values[0]


class JointCommandCodec:
    """trajectory_msgs/JointTrajectory of one point: positions, velocities and feed-forward torques of every joint.

    The stamp is that of the sensor samples from which the command was computed.
    """

    def __init__(self, model: RobotModel) -> None:
        self._model = model
        marks = Markers()
        slots = [marks.take(model.nj) for _ in range(3)]
        point = JointTrajectoryPoint()
        point.positions, point.velocities, point.effort = (doubles(slot) for slot in slots)
        self._template = Template(JointTrajectoryMsg(joint_names=list(model.joint_names), points=[point]), slots)

    def encode(self, stamp: int, command: JointCommand) -> bytes:
        """Serialised message from a stamp [ns] and a command."""
        return self._template.pack(stamp, (command.q, command.v, command.tau))

    def decode(self, data: bytes) -> tuple[int, JointCommand | JointTrajectory]:
        """Stamp [ns] and a set-point for now, or a trajectory to interpolate.

        Raises ``JointNameError`` when a set-point has a missing, unknown or duplicate joint, ``MessageError`` for bad
        size, NaN or infinity in it. Trajectories are checked by ``validate_trajectory``.
        """
        values = self._template.unpack(data)
        if values is None:
            message = decode(data, JointTrajectoryMsg)
            if not _is_set_point(message):
                return stamp_of(data), trajectory_from_message(message)
            point = message.points[0]
            values = [self._ordered(message.joint_names, point, field) for field in _FIELDS]
        for field, numbers in zip(_FIELDS, values, strict=True):
            require_finite(field, numbers, self._model.joint_names)
        return stamp_of(data), JointCommand(*values)

    def _ordered(self, names: list[str], point: Any, field: str) -> Vector:
        numbers = np.frombuffer(getattr(point, field), dtype=np.float64)
        if len(numbers) != len(names):
            raise MessageError(f"{field}: {len(numbers)} values for {len(names)} names")
        return self._model.reorder(names, numbers)


_FIELDS = ("positions", "velocities", "effort")


def _is_set_point(message: Any) -> bool:
    """One point, due at once, with torques: the output of the whole-body controller."""
    if len(message.points) != 1 or not message.points[0].effort:
        return False
    due = message.points[0].time_from_start
    return bool(due.sec == 0 and due.nanosec == 0)


def trajectory_from_message(message: Any) -> JointTrajectory:
    """trajectory_msgs/JointTrajectory to the state type.

    Raises ``JointNameError`` for a duplicate name, ``TrajectoryError`` without joints or when the points differ in
    size.
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
    """State type to trajectory_msgs/JointTrajectory, with a zero stamp: start at once."""
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


def wrench_vector(wrench: Any) -> Vector:
    """geometry_msgs/Wrench to force, torque (6,) [N, N.m]."""
    f, m = wrench.force, wrench.torque
    return np.array([f.x, f.y, f.z, m.x, m.y, m.z])


def _fill_wrench(wrench: Any, values: Vector) -> None:
    f, m = wrench.force, wrench.torque
    f.x, f.y, f.z, m.x, m.y, m.z = values.tolist()


def _column(message: Any, field: str, size: int) -> Vector:
    for i, point in enumerate(message.points):
        if len(getattr(point, field)) != size:
            raise TrajectoryError(f"{field}: point {i} has {len(getattr(point, field))} values for {size} joints")
    return np.array([list(getattr(p, field)) for p in message.points], dtype=np.float64).reshape(-1, size)


class TorqueCodec:
    """Torques of every joint of one robot, by name; no positions and no velocities."""

    def __init__(self, model: RobotModel) -> None:
        self._model = model
        slot = Markers().take(model.nj)
        self._template = Template(JointState(name=list(model.joint_names), effort=doubles(slot)), [slot])

    def encode(self, stamp: int, tau: Vector) -> bytes:
        """Serialised message from a stamp [ns] and torques (nj,) [N.m]."""
        return self._template.pack(stamp, (tau,))

    def decode(self, data: bytes) -> tuple[int, Vector]:
        """Stamp [ns] and torques (nj,) [N.m] in the order of ``joint_names``; errors as ``JointStateCodec.decode``."""
        values = self._template.unpack(data)
        if values is None:
            message = decode(data, JointState)
            numbers = np.frombuffer(message.effort, dtype=np.float64)
            if len(numbers) != len(message.name):
                raise MessageError(f"effort: {len(numbers)} values for {len(message.name)} names")
            values = [self._model.reorder(list(message.name), numbers)]
        require_finite("effort", values[0], self._model.joint_names)
        return stamp_of(data), values[0]


PAN, TILT = "pan", "tilt"  #: Names in the messages; the profile maps them to joints


def head_message(stamp: int, pan: float, tilt: float) -> Any:
    """sensor_msgs/JointState with a stamp [ns] of two angles [rad]."""
    message = JointState(name=[PAN, TILT], position=[pan, tilt])
    set_stamp(message.header.stamp, stamp)
    return message


def head_from_message(message: Any) -> tuple[float, float]:
    """Pan and tilt of a sensor_msgs/JointState [rad]; velocities and efforts are ignored.

    Raises ``MessageError`` unless it has one finite position for each of ``pan`` and ``tilt``, and no other name.
    """
    names = list(message.name)
    if sorted(names) != [PAN, TILT]:
        raise MessageError(f"name: {names[:4]}, expected '{PAN}' and '{TILT}'")
    if len(message.position) != len(names):
        raise MessageError(f"position: {len(message.position)} values for {len(names)} names")
    angles = dict(zip(names, message.position, strict=True))
    for name, angle in angles.items():
        if not math.isfinite(angle):
            raise MessageError(f"{name}: {angle} rad is no angle")
    return float(angles[PAN]), float(angles[TILT])


MODES = {mode.value: mode for mode in Mode}  #: Mode by its word


def mode_named(word: str) -> Mode:
    """Mode of a word; ``MessageError`` lists the valid ones."""
    if word not in MODES:
        raise MessageError(f"unknown mode '{word[:32]}'; known: {', '.join(MODES)}")
    return MODES[word]
