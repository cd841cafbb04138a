"""Legs that touch each other, by the shapes of their links: the same check for every controller."""

import xml.etree.ElementTree as ET
from itertools import product

import coal
import pinocchio as pin

from models.errors import RobotModelError
from models.robot_model import RobotModel
from models.types import Vector
from models.urdf import read_urdf, resolve_uri

_meshes = coal.CachedMeshLoader(coal.BV_OBBRSS)  #: Meshes of this process, by file


class LegContact:
    """Whether surfaces of the left and of the right leg intersect.

    A leg is what the joints move that carry one sole only. Its shapes are the visual ones of the URDF, meshes as they
    are; those of collision where a link has no visual shape. Raises ``RobotModelError`` when one cannot be loaded.
    """

    def __init__(self, robot: RobotModel) -> None:
        self._model, self._data = robot.pin, robot.data()
        supports = [set(joints) for joints in robot.pin.supports]
        chains = [supports[robot.pin.frames[foot.frame_id].parentJoint] for foot in robot.feet]
        own = chains[0] - chains[1], chains[1] - chains[0]
        self._geometry = _shapes(robot, {joint for joint, above in enumerate(supports) if above & (own[0] | own[1])})
        bodies = self._geometry.geometryObjects
        sides = [[i for i, body in enumerate(bodies) if supports[body.parentJoint] & side] for side in own]
        for pair in product(*sides):
            self._geometry.addCollisionPair(pin.CollisionPair(*pair))
        self._contacts = self._geometry.createData()

    def find(self, q: Vector) -> str:
        """The first two links that touch at a configuration (nq,); empty when none do."""
        if not pin.computeCollisions(self._model, self._data, self._geometry, self._contacts, q, True):
            return ""
        results = zip(self._geometry.collisionPairs, self._contacts.collisionResults, strict=True)
        pair = next(pair for pair, result in results if result.isCollision())
        names = [self._geometry.geometryObjects[i].parentFrame for i in (pair.first, pair.second)]
        return " and ".join(self._model.frames[name].name for name in names)


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
        return pin.buildGeomFromUrdfString(robot.pin, text, kind, None, None, _meshes)
    except (RuntimeError, ValueError) as error:
        raise RobotModelError(f"{robot.urdf}: shapes of the legs: {error}") from error
