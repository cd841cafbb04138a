"""Geometry of a robot's legs, for laws and checks that avoid collisions between them."""

import warnings
import xml.etree.ElementTree as ET
from collections.abc import Container, Sequence
from functools import lru_cache
from itertools import product
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin

from models.errors import RobotModelError
from models.robot_model import RobotModel
from models.types import Matrix
from models.urdf import read_urdf, shapes_of

_DRAWN = ("visual", "collision")  #: Kinds of shapes that represent the surface of a link, in order of preference
_DIRECTIONS = 200  #: Number of directions of a coarse hull; for a shank it is within 4 mm of the exact hull [1]
_MESHES = coal.CachedMeshLoader(coal.BV_OBBRSS)  #: Meshes of this process with their hulls, by file


def leg_chains(robot: RobotModel) -> tuple[set[int], set[int]]:
    """Joints that move only the left sole, and joints that move only the right sole."""
    left, right = (set(robot.pin.supports[robot.pin.frames[foot.frame_id].parentJoint]) for foot in robot.feet)
    return left - right, right - left


def leg_shapes(robot: RobotModel, *, hulls: bool = False) -> pin.GeometryModel:
    """Geometry of the bodies moved by the joints of ``leg_chains``, and collision pairs between the two legs.

    Uses the visual shapes of the URDF, or the collision shapes of a link without visual shapes. With ``hulls``, meshes
    are replaced by coarse convex hulls. Missing meshes are skipped with a warning.
    """
    supports, sides = [set(joints) for joints in robot.pin.supports], leg_chains(robot)
    moving = {joint for joint, above in enumerate(supports) if above & (sides[0] | sides[1])}
    geometry = body_shapes(robot.pin, robot.urdf, _DRAWN, moving)
    bodies = geometry.geometryObjects
    for body in bodies:
        if hulls and isinstance(body.geometry, coal.BVHModelBase):
            body.geometry = _coarse_hull(body.geometry.vertices().tobytes())
    legs = [[i for i, body in enumerate(bodies) if supports[body.parentJoint] & side] for side in sides]
    for pair in product(*legs):
        geometry.addCollisionPair(pin.CollisionPair(*pair))
    return geometry


def foot_size(robot: RobotModel) -> tuple[float, float]:
    """Length and width [m] along the sole's axes of the bounding box of the foot and its sole, maximum of both feet."""
    soles, sizes = [robot.pin.frames[foot.frame_id] for foot in robot.feet], []
    geometry = body_shapes(robot.pin, robot.urdf, _DRAWN, {sole.parentJoint for sole in soles})
    for foot, frame in zip(robot.feet, soles, strict=True):
        x_min, x_max, y_min, y_max = foot.rectangle
        points = [np.array([[x_min, y_min, 0.0], [x_max, y_max, 0.0]])]
        for body in geometry.geometryObjects:
            if body.parentJoint == frame.parentJoint:
                body.geometry.computeLocalAABB()
                box, place = body.geometry.aabb_local, frame.placement.actInv(body.placement)
                corners = np.array([*product(*zip(box.min_, box.max_, strict=True))])
                points.append(corners @ place.rotation.T + place.translation)
        sizes.append(np.ptp(np.concatenate(points), axis=0))
    length, width, _ = np.max(sizes, axis=0).tolist()
    return length, width


@lru_cache(maxsize=64)
def _coarse_hull(vertices: bytes) -> coal.ConvexBase:
    """Convex hull of the extreme points of a mesh in ``_DIRECTIONS`` directions; few points keep distances fast.

    Found once per process for each mesh. ``vertices`` are float64 (n, 3).
    """
    points = coal.StdVec_Vec3s()
    points.extend(extreme_points(np.frombuffer(vertices).reshape(-1, 3)))
    return coal.ConvexBase.convexHull(points, True, "Qt")


def extreme_points(vertices: Matrix) -> Matrix:
    """Extreme points (k, 3) of a mesh (n, 3) in ``_DIRECTIONS`` directions."""
    k = np.arange(_DIRECTIONS)  # evenly spread along a Fibonacci spiral
    height, turn = 1.0 - (2.0 * k + 1.0) / _DIRECTIONS, np.pi * (1.0 + 5.0**0.5) * k
    radius = np.sqrt(1.0 - height**2)
    directions = np.column_stack((radius * np.cos(turn), radius * np.sin(turn), height))
    extreme: Matrix = vertices[np.unique((directions @ vertices.T).argmax(axis=1))]
    return extreme


def body_shapes(
    robot: pin.Model, urdf: Path, kinds: Sequence[str], joints: Container[int] | None = None
) -> pin.GeometryModel:
    """Shapes of the links of a URDF moved by ``joints``, all links when None; see ``shapes_of`` for ``kinds``.

    Missing meshes are skipped with a warning. Raises ``RobotModelError`` when a mesh cannot be read.
    """
    root, bare = ET.Element("robot", {"name": urdf.stem}), []
    for element in read_urdf(urdf):
        if element.tag == "joint":
            root.append(element)
        elif element.tag == "link":
            name = element.get("name", "")
            link = ET.SubElement(root, "link", name=name)
            link.extend(element.findall("inertial"))
            if joints is None or robot.frames[robot.getFrameId(name, pin.FrameType.BODY)].parentJoint in joints:
                link.extend(shapes_of(element, urdf.parent, kinds))
                if link.find("visual") is None and any(element.find(kind) is not None for kind in kinds):
                    bare.append(name)
    if bare:
        warnings.warn(
            f"{urdf}: meshes of {', '.join(bare)} are missing: no clearance is kept from these links", stacklevel=2
        )
    text, kind = ET.tostring(root, encoding="unicode"), pin.GeometryType.VISUAL
    try:
        return pin.buildGeomFromUrdfString(robot, text, kind, None, None, _MESHES)
    except (RuntimeError, ValueError) as error:
        raise RobotModelError(f"{urdf}: shapes: {error}") from error
