"""Goals of a motion: key poses and a caller's targets, validated and in base_footprint, the mid-point of the soles."""

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from models.errors import CommandError, ConfigError
from models.heading import base_footprint
from models.robot_model import RobotModel
from models.types import Matrix, Vector
from planners.stance import plant

#: Frames that a motion may move (REP-120 names); the soles stay planted
TARGET_FRAMES = ("base_link", "torso", "gaze", "l_wrist", "r_wrist")


@dataclass(frozen=True, slots=True)
class FrameGoal:
    """Target of one frame, one of ``TARGET_FRAMES``, in base_footprint."""

    frame: str
    position: Vector | None  # of its origin (3,) [m]; None when free
    axes: str  # axes of base_footprint along which ``position`` counts, such as 'xyz' or 'z'
    rotation: Matrix | None  # (3, 3); None when free


@dataclass(frozen=True, slots=True)
class PoseGoal:
    """One key pose."""

    name: str  # in error messages
    frames: tuple[FrameGoal, ...]
    posture: Vector  # preferred joint positions (nj,) [rad]
    com: Vector  # preferred place of the CoM in base_footprint (2,) [m]
    base: pin.SE3  # preferred pose of base_link; of its position only the height counts
    torso: Matrix  # preferred orientation (3, 3)
    joints: dict[int, float] = field(default_factory=dict)  # index in a joint vector to target position [rad]


def vector(values: ArrayLike, size: int, name: str) -> Vector:
    """A caller's vector, checked; raises ``CommandError`` with its name."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise CommandError(f"{name}: not numbers: {error}") from error
    if array.shape != (size,):
        raise CommandError(f"{name}: expected {size} numbers, found shape {array.shape}")
    if not np.isfinite(array).all():
        raise CommandError(f"{name}: {array[~np.isfinite(array)][0]} is not a finite number")
    return array.copy()


def rotation(values: ArrayLike, name: str) -> Matrix:
    """Rotation of a quaternion xyzw; raises ``CommandError`` unless it has length 1 (to 1 %)."""
    quaternion = vector(values, 4, name)
    length = float(np.linalg.norm(quaternion))
    if abs(length - 1.0) > 0.01:
        raise CommandError(f"{name}: the quaternion has length {length:.3g}, expected 1")
    return np.array(pin.Quaternion(quaternion / length).toRotationMatrix())


#: Everyday names of frames that a motion may move
NICKNAMES = {"left_hand": "l_wrist", "right_hand": "r_wrist", "head": "gaze"}
#: Frames beside those of the robot: the estimator's world, and REP-120's between the soles
ODOM, FOOTPRINT = "odom", "base_footprint"


def frame_named(name: str) -> str:
    """Frame that a motion may move, by its name or nickname.

    Raises:
        CommandError: There is none of that name; the message lists the known ones.
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
        orientation: Of the target in F, quaternion xyzw (4,).
        base: Position and quaternion xyzw of the base in odom (7,) [m]; None without odometry.

    Raises:
        CommandError: The frame or its pose is unknown, or a value is malformed.
    """
    target = pin.SE3(rotation(orientation, "target.pose.orientation"), vector(position, 3, "target.pose.position"))
    data = model.data()
    q, soles = plant(model, data, joints)
    planted = pin.XYZQUATToSE3(q[:7])
    if frame_id == ODOM:
        if base is None:
            raise CommandError(f"target: the pose of the robot in '{ODOM}' is not known: no odometry has arrived")
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
