"""Targets that are given in a frame of the robot or of the world, in the frame that the planner plans in."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from models.errors import CommandError, ConfigError
from models.footprint import base_footprint
from models.robot_model import RobotModel
from models.types import Vector
from planners.arguments import rotation, vector
from planners.goals import TARGET_FRAMES
from planners.stance import plant

NICKNAMES = {"left_hand": "l_wrist", "right_hand": "r_wrist", "head": "gaze"}
"""What people call the frames that a motion may move."""

ODOM, FOOTPRINT = "odom", "base_footprint"
"""Frames beside those of the robot: of the world as the estimator knows it, and REP-120's between the soles."""


def frame_named(name: str) -> str:
    """Frame that a motion may move, by its name or what people call it.

    Raises:
        CommandError: There is none of that name; those that there are are listed.
    """
    frame = NICKNAMES.get(name, name)
    if frame not in TARGET_FRAMES:
        known = ", ".join((*NICKNAMES, *TARGET_FRAMES))
        raise CommandError(f"frame: '{name[:32]}' cannot be moved; these can: {known}")
    return frame


def planted_target(
    model: RobotModel,
    joints: Vector,
    frame_id: str,
    position: ArrayLike,
    orientation: ArrayLike,
    base: Vector | None,
) -> pin.SE3:
    """A pose as ``MotionPlanner.plan_pose`` takes it: in the frame midway between the soles.

    T_SX = T_SB T_FB^-1 T_FX for a target X given in F, B the base and S midway between the soles (``stance.plant``).

    Args:
        model: The robot.
        joints: Its posture (nj,) [rad]; both soles stand.
        frame_id: F: odom, base_footprint, or a REP-120 frame of the robot.
        position: Of the target in F (3,) [m].
        orientation: The same, quaternion xyzw (4,).
        base: Position and quaternion xyzw of the base in odom (7,) [m]; None while it is not known.

    Returns:
        The target in S.

    Raises:
        CommandError: The frame is not known, where it is is not known, or a value is malformed.
    """
    target = pin.SE3(rotation(orientation, "target.pose.orientation"), vector(position, 3, "target.pose.position"))
    data = model.data()
    q, soles = plant(model, data, joints)
    planted = pin.XYZQUATToSE3(q[:7])
    if frame_id == ODOM:
        if base is None:
            raise CommandError(f"target: where the robot is in '{ODOM}' is not known: no odometry has arrived")
        return planted * pin.XYZQUATToSE3(base).inverse() * target
    if frame_id == FOOTPRINT:
        origins = [sole.translation for sole in soles]
        return planted * pin.XYZQUATToSE3(base_footprint(q[:7], np.array(origins))) * target
    try:
        frame = model.frame_id(frame_id)
    except ConfigError as error:
        known = ", ".join((ODOM, FOOTPRINT, *model.frame_names))
        raise CommandError(f"target: header.frame_id: unknown frame '{frame_id[:32]}'; known: {known}") from error
    return data.oMf[frame] * target
