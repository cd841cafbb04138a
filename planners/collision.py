"""Self-collision: convex hulls of the URDF's collision bodies and the distances between them."""

from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from models.leg_shapes import body_shapes
from models.robot_model import RobotModel
from models.types import Vector
from planners.motion_config import CollisionConfig


def hull_geometry(model: pin.Model, urdf: Path) -> pin.GeometryModel:
    """Collision bodies of a URDF as convex hulls, without pairs; a missing mesh is left out with a warning."""
    geometry = body_shapes(model, urdf, ("collision",))
    for body in geometry.geometryObjects:
        if isinstance(body.geometry, coal.BVHModelBase):
            if body.geometry.convex is None:
                body.geometry.buildConvexHull(True, "Qt")
            body.geometry = body.geometry.convex
    return geometry


class SelfCollision:
    """Distances between bodies of one robot.

    Bodies at most ``config.near`` joints apart touch by construction and are not compared. Bodies whose hulls overlap
    in the posture 'stand' are not compared either, because a hull is larger than its body; ``ignored`` names them.
    Raises ``RobotModelError`` when a collision mesh of the URDF cannot be read.
    """

    def __init__(self, model: RobotModel, config: CollisionConfig) -> None:
        self._model = model.pin
        self.geometry = hull_geometry(model.pin, model.urdf)
        self._joint_data = model.data()
        bodies = self.geometry.geometryObjects
        self._names = [model.pin.frames[body.parentFrame].name for body in bodies]
        pairs = [
            (i, j)
            for i in range(len(bodies))
            for j in range(i + 1, len(bodies))
            if _joints_apart(model.pin, bodies[i].parentJoint, bodies[j].parentJoint) > config.near
        ]
        for pair in pairs:
            self.geometry.addCollisionPair(pin.CollisionPair(*pair))
        for body in bodies:
            body.geometry.computeLocalAABB()
        self._radii = np.array([body.geometry.aabb_radius for body in bodies])
        self._centres = np.array([body.geometry.aabb_center for body in bodies])  # (n, 3)
        self._data = self.geometry.createData()
        self._pairs: NDArray[np.intp] = np.array(pairs, dtype=np.intp).reshape(-1, 2)
        self._active = np.ones(len(pairs), dtype=bool)
        distances = self.distances(model.standing_configuration(), 0.0)
        self._active = ~(distances < 0.0)
        self.ignored = tuple(self.names(int(k)) for k in np.flatnonzero(~self._active))
        """Pairs of links whose hulls overlap in the posture 'stand'."""

    @property
    def count(self) -> int:
        """Number of pairs."""
        return len(self._pairs)

    def names(self, pair: int) -> tuple[str, str]:
        """Names of the links of a pair."""
        first, second = self._pairs[pair]
        return self._names[first], self._names[second]

    def bodies(self, pair: int) -> tuple[int, int]:
        """Indices of a pair's bodies in ``geometry.geometryObjects``."""
        return int(self._pairs[pair][0]), int(self._pairs[pair][1])

    def distances(self, q: Vector, reach: float) -> Vector:
        """Distance of each pair at q (nq,) [m]: negative if overlapping, infinite beyond ``reach`` or if ignored."""
        pin.forwardKinematics(self._model, self._joint_data, q)
        pin.updateGeometryPlacements(self._model, self._joint_data, self.geometry, self._data)
        centres = np.array(
            [pose.act(centre) for pose, centre in zip(self._data.oMg, self._centres, strict=True)]
        ).reshape(-1, 3)  # (n, 3), also for a robot without bodies
        first, second = self._pairs.T
        gaps = np.linalg.norm(centres[first] - centres[second], axis=1) - self._radii[first] - self._radii[second]
        result = np.full(len(self._pairs), np.inf)
        for pair in np.flatnonzero((gaps <= reach) & self._active):
            result[pair] = pin.computeDistance(self.geometry, self._data, int(pair)).min_distance
        return result


def _joints_apart(model: pin.Model, first: int, second: int) -> int:
    """Number of joints between two bodies in the tree."""
    a, b = list(model.supports[first]), list(model.supports[second])
    shared = sum(1 for x, y in zip(a, b, strict=False) if x == y)
    return len(a) + len(b) - 2 * shared
