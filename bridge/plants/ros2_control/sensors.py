"""Decodes messages of ros2_control's broadcasters to sensor data in the joint order and frames of the robot's profile.

The first message defines the layout: order of the joints, additional joints, frame of the sensor. A message with
another layout is deserialised completely once and defines the new layout.
"""

from typing import Any

import numpy as np
import pinocchio as pin
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import Imu, JointState

from models.errors import JointNameError, MessageError
from models.nodes.cdr import Template, stamp_of
from models.nodes.messages import Codec, decode, require_finite
from models.robot_model import RobotModel
from models.types import Matrix, Vector

FIELDS = ("position", "velocity", "effort")  #: Fields of a JointState that every joint needs


class JointStateDecoder:
    """sensor_msgs/JointState of joint_state_broadcaster: all joints of the robot in any order; others are ignored."""

    def __init__(self, model: RobotModel) -> None:
        self._model = model
        self._template: Template | None = None
        self._index = np.zeros(model.nj, dtype=np.intp)

    def decode(self, data: bytes) -> tuple[int, Vector, Vector, Vector]:
        """Stamp [ns], positions [rad], velocities [rad/s] and torques [N.m], each (nj,).

        Raises ``JointNameError`` for a missing or duplicate joint, ``MessageError`` for a wrong size, NaN or infinity.
        """
        values = None if self._template is None else self._template.unpack(data)
        if values is None:
            values = self._learn(decode(data, JointState))
        ordered = [each[self._index] for each in values]
        for field, numbers in zip(FIELDS, ordered, strict=True):
            try:
                require_finite(field, numbers, self._model.joint_names)
            except MessageError as error:
                raise MessageError(f"{error}: the hardware must export the state interface '{field}'") from error
        q, v, tau = ordered
        return stamp_of(data), q, v, tau

    def _learn(self, message: Any) -> list[Vector]:
        names = list(message.name)
        values = [np.array(getattr(message, field), dtype=np.float64) for field in FIELDS]
        for field, numbers in zip(FIELDS, values, strict=True):
            if len(numbers) != len(names):
                raise MessageError(f"{field}: {len(numbers)} values for {len(names)} names")
        for name in self._model.joint_names:
            if (count := names.count(name)) != 1:
                what = "is missing" if count == 0 else f"is given {count} times"
                raise JointNameError(f"name: joint '{name}' {what}")
        self._index[:] = [names.index(name) for name in self._model.joint_names]
        self._template = Template(message, FIELDS)
        return values


class ImuDecoder:
    """sensor_msgs/Imu of imu_sensor_broadcaster, rotated from the axes of its frame to the axes of frame ``imu``.

    The measured point may be up to ``distance_max`` [m] from that frame.
    """

    def __init__(self, model: RobotModel, distance_max: float) -> None:
        self._model, self._distance_max = model, distance_max
        self._codec: Codec[tuple[int, Vector, Vector, Vector]] | None = None
        self._rotation = np.eye(3)

    def decode(self, data: bytes) -> tuple[int, Vector, Vector]:
        """Stamp [ns], angular velocity (3,) [rad/s] and specific force (3,) [m/s^2]; raises ``MessageError``."""
        if self._codec is None:
            message = decode(data, Imu)
            self._rotation = imu_rotation(self._model, message.header.frame_id, self._distance_max)
            fields = ("orientation", "angular_velocity", "linear_acceleration")
            self._codec = Codec(message, fields, ("header.frame_id",))
        stamp, _, gyro, accel = self._codec.read(data)
        require_finite("angular_velocity", gyro)
        require_finite("linear_acceleration", accel)
        return stamp, self._rotation @ gyro, self._rotation @ accel


class WrenchDecoder:
    """geometry_msgs/WrenchStamped of force_torque_sensor_broadcaster, transformed from its frame to the sole frame.

    The sensor must report the force of the ground on the robot; the broadcaster's parameter ``multiplier`` inverts the
    sign. ``foot`` is 0 for left, 1 for right.
    """

    def __init__(self, model: RobotModel, foot: int) -> None:
        self._model, self._foot = model, foot
        self._codec: Codec[tuple[int, Vector]] | None = None
        self._transform = np.eye(6)

    def decode(self, data: bytes) -> tuple[int, Vector]:
        """Stamp [ns] and ground reaction wrench in the sole frame (6,) [N, N.m]; raises ``MessageError``."""
        if self._codec is None:
            message = decode(data, WrenchStamped)
            self._transform = sole_transform(self._model, self._foot, message.header.frame_id)
            self._codec = Codec(message, ("wrench",), ("header.frame_id",))
        stamp, wrench = self._codec.decode(data)
        return stamp, self._transform @ wrench


def imu_rotation(model: RobotModel, frame: str, distance_max: float) -> Matrix:
    """Rotation (3, 3) from a URDF frame to frame ``imu``; ``MessageError`` beyond ``distance_max`` [m]."""
    placement = _placement(model, frame, model.frame_id("imu"), "imu")
    distance = float(np.linalg.norm(placement.translation))
    if distance > distance_max:
        raise MessageError(
            f"header.frame_id: '{frame}' is {1e3 * distance:.0f} mm from frame 'imu' of '{model.name}'; set frames.imu "
            f"of the profile to the place of the sensor"
        )
    return np.array(placement.rotation)


def sole_transform(model: RobotModel, foot: int, frame: str) -> Matrix:
    """Wrench transform (6, 6) from a URDF frame to a sole frame; ``MessageError`` unless both are on one link."""
    sole = model.feet[foot].frame_id
    return np.array(_placement(model, frame, sole, model.pin.frames[sole].name).toDualActionMatrix())


def _placement(model: RobotModel, frame: str, target: int, name: str) -> pin.SE3:
    """Placement of a frame in a target frame on the same link; ``MessageError`` if unknown or on another link."""
    if not model.pin.existFrame(frame):
        raise MessageError(f"header.frame_id: '{frame}' is not a frame of robot '{model.name}'")
    given, wanted = model.pin.frames[model.pin.getFrameId(frame)], model.pin.frames[target]
    if given.parentJoint != wanted.parentJoint:
        raise MessageError(f"header.frame_id: '{frame}' moves relative to frame '{name}' of robot '{model.name}'")
    return wanted.placement.actInv(given.placement)
