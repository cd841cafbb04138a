"""Footsteps and goals as geometry_msgs/PoseStamped and nav_msgs/Path."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path

from models.constants import FOOT_NAMES
from models.errors import MessageError
from models.heading import heading
from models.nodes import topics
from models.nodes.messages import set_header, set_stamp, to_ns
from models.nodes.odometry import QUATERNION_TOLERANCE
from models.nodes.services import own_message
from models.robot_model import SOLE_FRAMES
from planners.gait.footsteps import LEFT, RIGHT, Foothold, Point, middle
from planners.gait.reference import sole_rotation
from planners.gait.route import Footstep
from planners.gait.tread import Tread

_UPRIGHT_MIN = 0.1  #: Least cosine of the tilt of a foothold for which a slope is computed [-]


def foothold_from_pose(name: str, pose: Any) -> Foothold:
    """Foothold at the position and heading of a geometry_msgs/Pose.

    Raises ``MessageError`` with ``name`` if a value is not finite or the quaternion is not of unit length.
    """
    position, turn = pose.position, pose.orientation
    for field, part, axes in (("position", position, "xyz"), ("orientation", turn, "xyzw")):
        for axis in axes:
            if not math.isfinite(getattr(part, axis)):
                raise MessageError(f"{name}: {field}.{axis} is {getattr(part, axis)}")
    norm = math.sqrt(turn.x**2 + turn.y**2 + turn.z**2 + turn.w**2)
    if abs(norm - 1.0) > QUATERNION_TOLERANCE:
        raise MessageError(f"{name}: orientation: quaternion of norm {norm:.4f}")
    return Foothold(position.x, position.y, heading(turn.x, turn.y, turn.z, turn.w), position.z)


def slope_from_pose(name: str, pose: Any) -> Point:
    """Slope of a sole [-] from the orientation of a geometry_msgs/Pose; ``MessageError`` if it does not face upward."""
    turn = pose.orientation
    x, y, z, w = turn.x, turn.y, turn.z, turn.w
    upright = 1.0 - 2.0 * (x * x + y * y)
    if upright <= _UPRIGHT_MIN:
        raise MessageError(f"{name}: orientation: the sole is tilted by {math.acos(max(upright, -1.0)):.2f} rad")
    return -2.0 * (x * z + w * y) / upright, -2.0 * (y * z - w * x) / upright


def goal_from_message(name: str, message: Any) -> Foothold:
    """Goal for the middle between the soles, from a PoseStamped in ``odom``; ``MessageError`` for an invalid one.

    Roll and pitch are ignored: the feet find the floor by contact.
    """
    require_odom(name, message.header.frame_id)
    return foothold_from_pose(name, message.pose)


def require_odom(name: str, frame_id: str) -> None:
    """Raise ``MessageError`` for a frame other than ``odom``."""
    if frame_id != topics.ODOM_FRAME:
        raise MessageError(f"{name}: header.frame_id: '{frame_id[:32]}' instead of '{topics.ODOM_FRAME}'")


def steps_from_path(message: Any, soles: Sequence[Foothold]) -> list[Footstep]:
    """Footsteps of a nav_msgs/Path in ``odom``; the frame_id of each pose names the sole: ``l_sole`` or ``r_sole``.

    Poses without a sole alternate; the first one is for the foot on its side of the robot, by ``soles`` (left, right).
    Heights and tilts are used. Raises ``MessageError`` for an unknown frame, and as ``foothold_from_pose``.
    """
    require_odom("footsteps", message.header.frame_id)
    here = middle(soles)
    steps: list[Footstep] = []
    for i, pose in enumerate(message.poses):
        name, frame = f"footstep {i + 1}", pose.header.frame_id
        hold = foothold_from_pose(name, pose.pose)
        if frame in SOLE_FRAMES:
            foot = SOLE_FRAMES.index(frame)
        elif frame not in ("", topics.ODOM_FRAME):
            raise MessageError(f"{name}: header.frame_id: '{frame[:32]}' names no sole: {', '.join(SOLE_FRAMES)}")
        elif steps:
            foot = 1 - steps[-1].foot
        else:
            foot = LEFT if here.relative(hold.x, hold.y)[1] >= 0.0 else RIGHT
        steps.append(Footstep(foot, hold, Tread(slope_from_pose(name, pose.pose))))
    return steps


def path_from_steps(stamp: int, steps: Sequence[Footstep], stamps: Sequence[int] | None = None) -> Any:
    """nav_msgs/Path of footsteps in ``odom``, soles as frame_id; touchdown ``stamps`` [ns] default to the path's."""
    path = Path()
    set_header(path, stamp, topics.ODOM_FRAME)
    for step, t in zip(steps, stamps or [stamp] * len(steps), strict=True):
        slope = (0.0, 0.0) if step.tread is None else step.tread.slope
        path.poses.append(pose_message(step.hold, SOLE_FRAMES[step.foot], t, slope))
    return path


def footstep_message(step: Footstep, time: float) -> Any:
    """poise_interfaces/Footstep of a step that touches down at a time [s]."""
    message = own_message("Footstep")(side=FOOT_NAMES[step.foot])
    message.pose = pose_message(step.hold, topics.ODOM_FRAME)
    set_stamp(message.time_from_start, to_ns(time))
    return message


def pose_message(hold: Foothold, frame_id: str, stamp: int = 0, slope: Point = (0.0, 0.0)) -> Any:
    """geometry_msgs/PoseStamped of a foothold on a slope [-]."""
    message = PoseStamped()
    set_header(message, stamp, frame_id)
    position, orientation = message.pose.position, message.pose.orientation
    position.x, position.y, position.z = float(hold.x), float(hold.y), float(hold.z)
    rotation = np.empty((3, 3))
    sole_rotation(hold.yaw, *slope, rotation)
    orientation.x, orientation.y, orientation.z, orientation.w = pin.Quaternion(rotation).coeffs().tolist()
    return message
