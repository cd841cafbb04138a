"""Stance for given joints: base and soles on the floor, and the support polygon."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull

from models.robot_model import RobotModel
from models.types import Matrix, Vector


@dataclass(frozen=True, slots=True)
class Stance:
    """A configuration on planted soles; everything is expressed in base_footprint, the mid-point of the soles."""

    q: Vector  # base position, base quaternion xyzw, joints (nq,) [m, rad]
    soles: tuple[pin.SE3, pin.SE3]  # left and right
    polygon: Matrix  # corners of the support polygon, counter-clockwise (n, 2) [m]
    edges: Matrix  # rows (n_x, n_y, c) with n . p + c = minus the distance of p to the edge (n, 3) [m]
    com: Vector  # (3,) [m]

    def margin(self, point: Vector) -> float:
        """Distance of a ground point from the edge of the support polygon, negative outside [m]."""
        return float(-(self.edges[:, :2] @ point[:2] + self.edges[:, 2]).max())


def plant(model: RobotModel, data: pin.Data, joints: Vector) -> tuple[Vector, tuple[pin.SE3, pin.SE3]]:
    """Configuration (nq,) with the mean of both sole poses at the origin, and the poses of the left and the right sole.

    ``data`` holds the frames of the result afterwards; see ``RobotModel.planted``.
    """
    q = model.planted(joints, data)
    pin.framesForwardKinematics(model.pin, data, q)
    left, right = (data.oMf[foot.frame_id].copy() for foot in model.feet)
    return q, (left, right)


def stand_on(model: RobotModel, data: pin.Data, joints: Vector) -> Stance:
    """The stance that joint positions (nj,) [rad] imply when both soles are planted.

    Its polygon is the convex hull of both contact rectangles projected onto the floor.
    """
    q, soles = plant(model, data, joints)
    corners = np.vstack(
        [sole.act(corner)[:2] for sole, foot in zip(soles, model.feet, strict=True) for corner in foot.corners]
    )
    hull = ConvexHull(corners)
    com = np.array(pin.centerOfMass(model.pin, data, q))
    return Stance(q, soles, corners[hull.vertices], hull.equations, com)
