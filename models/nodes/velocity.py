"""Walking velocities as geometry_msgs/Twist and TwistStamped."""

from __future__ import annotations

import math
from typing import Any

from geometry_msgs.msg import Twist

from models.errors import MessageError
from models.nodes.topics import BASE_FRAME

Velocity = tuple[float, float, float]
"""Forward [m/s], left [m/s], turn [rad/s], of ``base_link`` in its own frame."""


def velocity_to_twist(velocity: Velocity) -> Any:
    """geometry_msgs/Twist of a walking velocity."""
    message = Twist()
    message.linear.x, message.linear.y, message.angular.z = (float(value) for value in velocity)
    return message


def velocity_from_twist(message: Any) -> Velocity:
    """Walking velocity of a geometry_msgs/Twist; what a walk on the floor cannot do is left out.

    Raises:
        MessageError: A value is not finite; it is named.
    """
    for part in ("linear", "angular"):
        for axis in ("x", "y", "z"):
            value = getattr(getattr(message, part), axis)
            if not math.isfinite(value):
                raise MessageError(f"{part}.{axis} is {value}")
    return message.linear.x, message.linear.y, message.angular.z


def require_base_frame(frame_id: str) -> None:
    """Refuse a velocity of another frame; no frame means the base.

    Raises:
        MessageError: The frame is named.
    """
    if frame_id not in ("", BASE_FRAME):
        raise MessageError(f"header.frame_id: '{frame_id[:32]}' instead of '{BASE_FRAME}'")
