"""Goals of a motion in base_footprint (key poses, targets of a caller), and the stance on planted soles."""

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull

from models.errors import CommandError, ConfigError
from models.heading import base_footprint
from models.robot_model import RobotModel
from models.types import Matrix, Vector


@dataclass(frozen=True, slots=True)
class Stance:
    """Configuration on planted soles, expressed in base_footprint, midway between the soles."""

    q: Vector  # base position, base quaternion xyzw, joints (nq,) [m, rad]
    soles: tuple[pin.SE3, pin.SE3]  # left and right
    polygon: Matrix  # corners of the support polygon, counter-clockwise (n, 2) [m]
    edges: Matrix  # rows (n_x, n_y, c); -(n . p + c) is the distance of p from the edge (n, 3) [m]
    com: Vector  # (3,) [m]

    def margin(self, point: Vector) -> float:
        """Distance of a ground point from the edge of the support polygon, negative outside [m]."""
        return float(-(self.edges[:, :2] @ point[:2] + self.edges[:, 2]).max())


def plant(model: RobotModel, data: pin.Data, joints: Vector) -> tuple[Vector, tuple[pin.SE3, pin.SE3]]:
    """Configuration (nq,) of ``RobotModel.planted`` and the poses of both soles; updates the frames of ``data``."""
    q = model.planted(joints, data)
    pin.framesForwardKinematics(model.pin, data, q)
    left, right = (data.oMf[foot.frame_id].copy() for foot in model.feet)
    return q, (left, right)


def stand_on(model: RobotModel, data: pin.Data, joints: Vector) -> Stance:
    """Stance of joint positions (nj,) [rad] on both soles; the polygon is the convex hull of the contact rectangles."""
    q, soles = plant(model, data, joints)
    corners = np.vstack(
        [sole.act(corner)[:2] for sole, foot in zip(soles, model.feet, strict=True) for corner in foot.corners]
    )
    hull = ConvexHull(corners)
    com = np.array(pin.centerOfMass(model.pin, data, q))
    return Stance(q, soles, corners[hull.vertices], hull.equations, com)


#: Frames that a motion may move (REP-120 names); the soles stay planted
TARGET_FRAMES = ("base_link", "torso", "gaze", "l_wrist", "r_wrist")


@dataclass(frozen=True, slots=True)
class FrameGoal:
    """Target of one frame, one of ``TARGET_FRAMES``, in base_footprint."""

    frame: str
    position: Vector | None  # of its origin (3,) [m]; None when free
    axes: str  # axes of base_footprint along which ``position`` is a target, such as 'xyz' or 'z'
    rotation: Matrix | None  # (3, 3); None when free


@dataclass(frozen=True, slots=True)
class PoseGoal:
    """One key pose."""

    name: str  # in error messages
    frames: tuple[FrameGoal, ...]
    posture: Vector  # preferred joint positions (nj,) [rad]
    com: Vector  # preferred position of the CoM in base_footprint (2,) [m]
    base: pin.SE3  # preferred pose of base_link; only the height of its position is used
    torso: Matrix  # preferred orientation (3, 3)
    joints: dict[int, float] = field(default_factory=dict)  # target positions by index in a joint vector [rad]


def vector(values: ArrayLike, size: int, name: str) -> Vector:
    """Validate a vector given by a caller; ``CommandError`` contains its ``name``."""
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
    """Rotation matrix (3, 3) of a quaternion xyzw; ``CommandError`` unless its length is 1 within 1 %."""
    quaternion = vector(values, 4, name)
    length = float(np.linalg.norm(quaternion))
    if abs(length - 1.0) > 0.01:
        raise CommandError(f"{name}: the quaternion has length {length:.3g}, expected 1")
    return np.array(pin.Quaternion(quaternion / length).toRotationMatrix())


#: Aliases of frames that a motion may move
NICKNAMES = {"left_hand": "l_wrist", "right_hand": "r_wrist", "head": "gaze"}
#: Frames in addition to those of the robot: world frame of the estimator, and REP-120 frame between the soles
ODOM, FOOTPRINT = "odom", "base_footprint"


def frame_named(name: str) -> str:
    """Frame that a motion may move, by its name or alias; ``CommandError`` lists the valid names."""
    frame = NICKNAMES.get(name, name)
    if frame not in TARGET_FRAMES:
        known = ", ".join((*NICKNAMES, *TARGET_FRAMES))
        raise CommandError(f"frame: '{name[:32]}' cannot be moved; these can: {known}")
    return frame


def tilt_of(q: Vector) -> float:
    """Tilt of the base from upright in a configuration (nq,) [rad]."""
    return float(np.arccos(np.clip(1.0 - 2.0 * (q[3] ** 2 + q[4] ** 2), -1.0, 1.0)))


def planted_target(
    model: RobotModel,
    joints: Vector,
    frame_id: str,
    position: ArrayLike,
    orientation: ArrayLike,
    base: Vector | None,
) -> pin.SE3:
    """Target pose for ``MotionPlanner.plan_pose``, in the frame midway between the soles.

    T_SX = T_SB T_FB^-1 T_FX for a target X given in F (``frame_id``: odom, base_footprint, or a REP-120 frame). B is
    the base, S the frame midway between the soles at joint positions (nj,) [rad] (``plant``). ``base`` is position and
    quaternion xyzw of the base in odom (7,), None without odometry. Raises ``CommandError`` for an unknown frame, an
    unknown pose of the base or a malformed value.
    """
    target = pin.SE3(rotation(orientation, "target.pose.orientation"), vector(position, 3, "target.pose.position"))
    data = model.data()
    q, soles = plant(model, data, joints)
    planted = pin.XYZQUATToSE3(q[:7])
    if frame_id == ODOM:
        if base is None:
            raise CommandError(f"target: the pose of the robot in '{ODOM}' is not known: no odometry was received")
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
