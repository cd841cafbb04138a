"""nav_msgs/Odometry, contact flags, and walking velocities as geometry_msgs/Twist."""

import math
from functools import cache
from typing import Any

import numpy as np
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message
from std_msgs.msg import MultiArrayDimension, UInt8MultiArray

from models.constants import FOOT_NAMES
from models.errors import MessageError
from models.nodes.cdr import stamp_of
from models.nodes.messages import Codec, require_finite
from models.nodes.topics import BASE_FRAME, ODOM_FRAME
from models.types import ContactState, Matrix, RobotState, Vector, Velocity

QUATERNION_TOLERANCE = 1e-3  #: Accepted deviation of a quaternion's norm from 1 [-]


class OdometryCodec:
    """Pose of the base in ``odom`` and its twist in ``base_link`` (REP-105): ``q[:7]`` and ``v[:6]`` of a state."""

    def __init__(self) -> None:
        message = Odometry(child_frame_id=BASE_FRAME)
        message.header.frame_id = ODOM_FRAME
        fields = ("pose.pose", "pose.covariance", "twist.twist", "twist.covariance")
        fixed = ("header.frame_id", "child_frame_id")
        self._codec = Codec[tuple[int, Vector, Vector, Vector, Vector]](message, fields, fixed)
        self._covariance = np.zeros((2, 36))

    def set_covariance(self, pose: Matrix, twist: Matrix) -> None:
        """Set the covariances (6, 6) of pose (rotation about fixed axes) and twist; initially 0, meaning unknown."""
        self._covariance[:] = pose.ravel(), twist.ravel()

    def encode(self, stamp: int, state: RobotState) -> bytes:
        """Serialised message from a stamp [ns] and a state."""
        pose, twist = self._covariance
        return self._codec.encode(stamp, state.q[:7], pose, state.v[:6], twist)

    def decode(self, data: bytes) -> tuple[int, Vector, Vector]:
        """Stamp [ns], pose (7,) and twist in the base frame (6,); ``MessageError`` for unusable values."""
        _, pose, _, twist, _ = self._codec.read(data)
        require_finite("pose", pose)
        require_finite("twist", twist)
        norm = float(np.linalg.norm(pose[3:]))
        if abs(norm - 1.0) > QUATERNION_TOLERANCE:
            raise MessageError(f"pose.orientation: quaternion of norm {norm:.4f}")
        return stamp_of(data), pose, twist


def contacts_to_bytes(contacts: tuple[ContactState, ContactState]) -> bytes:
    """Serialised message with 1 for each foot that bears load; ``FOOT_NAMES`` are the labels of the layout."""
    return _contacts_bytes(tuple(bool(contact.active) for contact in contacts))


@cache
def _contacts_bytes(flags: tuple[bool, ...]) -> bytes:
    message = UInt8MultiArray(data=[int(flag) for flag in flags])
    message.layout.dim = [MultiArrayDimension(label=name, size=1, stride=1) for name in FOOT_NAMES]
    return bytes(serialize_message(message))


def contacts_from_message(message: UInt8MultiArray) -> tuple[bool, bool]:
    """Whether each foot bears load, in the order of ``FOOT_NAMES``; ``MessageError`` for other labels or sizes."""
    labels = tuple(dim.label for dim in message.layout.dim)
    if labels != FOOT_NAMES or len(message.data) != len(FOOT_NAMES):
        raise MessageError(f"layout: labels {labels} with {len(message.data)} values, expected {FOOT_NAMES}")
    return bool(message.data[0]), bool(message.data[1])


def velocity_to_twist(velocity: Velocity) -> Any:
    """geometry_msgs/Twist of a walking velocity."""
    message = Twist()
    message.linear.x, message.linear.y, message.angular.z = (float(value) for value in velocity)
    return message


def velocity_from_twist(message: Any) -> Velocity:
    """Walking velocity of a geometry_msgs/Twist; ignores other components. ``MessageError`` for NaN or infinity."""
    for part in ("linear", "angular"):
        for axis in ("x", "y", "z"):
            value = getattr(getattr(message, part), axis)
            if not math.isfinite(value):
                raise MessageError(f"{part}.{axis} is {value}")
    return message.linear.x, message.linear.y, message.angular.z


def require_base_frame(frame_id: str) -> None:
    """Raise ``MessageError`` for a velocity in another frame; an empty frame means the base."""
    if frame_id not in ("", BASE_FRAME):
        raise MessageError(f"header.frame_id: '{frame_id[:32]}' instead of '{BASE_FRAME}'")
