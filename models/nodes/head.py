"""Pan and tilt as sensor_msgs/JointState, by name."""

from __future__ import annotations

import math
from typing import Any

from sensor_msgs.msg import JointState

from models.errors import MessageError
from models.nodes.messages import set_stamp

PAN, TILT = "pan", "tilt"
"""Names in the messages; which joints they are is the profile's business."""


def head_message(stamp: int, pan: float, tilt: float) -> Any:
    """sensor_msgs/JointState with a stamp [ns] of two angles [rad]."""
    message = JointState(name=[PAN, TILT], position=[pan, tilt])
    set_stamp(message.header.stamp, stamp)
    return message


def head_from_message(message: Any) -> tuple[float, float]:
    """Pan and tilt of a sensor_msgs/JointState [rad]; velocities and efforts are left out.

    Raises:
        MessageError: Other names than ``pan`` and ``tilt``, one of them missing or given twice, not a position for
            each, or one that is not finite; names it.
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
