"""Shapes of a robot's legs, for laws and checks that keep them apart."""

import xml.etree.ElementTree as ET
from itertools import product

import coal
import numpy as np
import pinocchio as pin

from models.errors import RobotModelError
from models.robot_model import RobotModel
from models.urdf import read_urdf, resolve_uri

_DIRECTIONS = 200  #: Of the points of a coarse hull: within 4 mm of the hull, for a shank
MESHES = coal.CachedMeshLoader(coal.BV_OBBRSS)  #: Of this process with their hulls, by file


def leg_chains(robot: RobotModel) -> tuple[set[int], set[int]]:
    """Joints that move the left, and those that move the right sole only."""
    left, right = (set(robot.pin.supports[robot.pin.frames[foot.frame_id].parentJoint]) for foot in robot.feet)
    return left - right, right - left


def leg_shapes(robot: RobotModel, *, hulls: bool = False) -> pin.GeometryModel:
    """Shapes of all that the joints of ``leg_chains`` move, and all pairs of one shape of each leg.

    They are the visual ones of the URDF, meshes as they are or coarse convex ``hulls`` of them, and those of collision
    where a link has no visual shape. Raises ``RobotModelError`` when one cannot be loaded.
    """
    supports, sides = [set(joints) for joints in robot.pin.supports], leg_chains(robot)
    geometry = _shapes(robot, {joint for joint, above in enumerate(supports) if above & (sides[0] | sides[1])})
    bodies = geometry.geometryObjects
    for body in bodies:
        if hulls and isinstance(body.geometry, coal.BVHModelBase):
            body.geometry = _coarse_hull(body.geometry)
    legs = [[i for i, body in enumerate(bodies) if supports[body.parentJoint] & side] for side in sides]
    for pair in product(*legs):
        geometry.addCollisionPair(pin.CollisionPair(*pair))
    return geometry


def foot_size(robot: RobotModel) -> tuple[float, float]:
    """Largest length and width [m] along a sole's axes of the boxes around what moves with it; at least of the sole."""
    soles, sizes = [robot.pin.frames[foot.frame_id] for foot in robot.feet], []
    geometry = _shapes(robot, {sole.parentJoint for sole in soles})
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


def _coarse_hull(mesh: coal.BVHModelBase) -> coal.ConvexBase:
    """Convex hull of the outermost points of a mesh in ``_DIRECTIONS`` directions: few, as each distance reads some."""
    vertices = mesh.vertices()
    k = np.arange(_DIRECTIONS)  # along Fibonacci's spiral, which is evenly spread
    height, turn = 1.0 - (2.0 * k + 1.0) / _DIRECTIONS, np.pi * (1.0 + 5.0**0.5) * k
    radius = np.sqrt(1.0 - height**2)
    directions = np.column_stack((radius * np.cos(turn), radius * np.sin(turn), height))
    points = coal.StdVec_Vec3s()
    points.extend(vertices[np.unique((directions @ vertices.T).argmax(axis=1))])
    return coal.ConvexBase.convexHull(points, True, "Qt")


def _shapes(robot: RobotModel, joints: set[int]) -> pin.GeometryModel:
    """Shapes of the links that some joints move."""
    root = ET.Element("robot", {"name": robot.name})
    for element in read_urdf(robot.urdf):
        if element.tag not in ("link", "joint"):
            continue
        link = ET.SubElement(root, element.tag, dict(element.attrib))
        link.extend(element if element.tag == "joint" else element.findall("inertial"))
        frame = robot.pin.getFrameId(element.get("name", ""), pin.FrameType.BODY)
        if element.tag == "link" and robot.pin.frames[frame].parentJoint in joints:
            for shape in element.findall("visual") or element.findall("collision"):
                shape.tag = "visual"
                for mesh in shape.iterfind("geometry/mesh"):
                    mesh.set("filename", str(resolve_uri(mesh.get("filename", ""), robot.urdf.parent)))
                link.append(shape)
    text, kind = ET.tostring(root, encoding="unicode"), pin.GeometryType.VISUAL
    try:
        return pin.buildGeomFromUrdfString(robot.pin, text, kind, None, None, MESHES)
    except (RuntimeError, ValueError) as error:
        raise RobotModelError(f"{robot.urdf}: shapes of the legs: {error}") from error
