"""Where the robot stands: base and soles on the floor for given joints, and the polygon it may balance over."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull

from models.robot_model import RobotModel
from models.types import Matrix, Vector


@dataclass(frozen=True, slots=True)
class Stance:
    """A configuration on planted soles; everything is expressed in base_footprint, the mid-point of the soles.

    Attributes:
        q: Configuration: base position (3), base quaternion xyzw (4), joints (nj) [m, rad].
        soles: Pose of the left and the right sole.
        polygon: Corners of the support polygon, counter-clockwise (n, 2) [m].
        edges: Rows (n_x, n_y, c) of the polygon's edges; n . p + c is minus the distance of p to the edge (n, 3) [m].
        com: Centre of mass (3,) [m].
    """

    q: Vector
    soles: tuple[pin.SE3, pin.SE3]
    polygon: Matrix
    edges: Matrix
    com: Vector

    def margin(self, point: Vector) -> float:
        """Distance of a ground point from the edge of the support polygon, negative outside [m]."""
        return float(-(self.edges[:, :2] @ point[:2] + self.edges[:, 2]).max())


def plant(model: RobotModel, data: pin.Data, joints: Vector) -> tuple[Vector, tuple[pin.SE3, pin.SE3]]:
    """Place the base so that the mean of both sole poses is the origin.

    T_WB = (mean of T_BL and T_BR)^-1, with the mean rotation half-way on the geodesic from left to right.

    Args:
        model: The robot.
        data: Workspace of ``model.pin``; holds the frames of the result afterwards.
        joints: Joint positions (nj,) [rad].

    Returns:
        Configuration (nq,) [m, rad] and the poses of the left and the right sole.
    """
    q = pin.neutral(model.pin)
    q[7:] = joints
    pin.framesForwardKinematics(model.pin, data, q)
    left, right = (data.oMf[foot.frame_id] for foot in model.feet)
    rotation = left.rotation @ pin.exp3(0.5 * pin.log3(left.rotation.T @ right.rotation))
    to_world = pin.SE3(rotation, 0.5 * (left.translation + right.translation)).inverse()
    q[:7] = pin.SE3ToXYZQUAT(to_world)
    pin.framesForwardKinematics(model.pin, data, q)
    left, right = (data.oMf[foot.frame_id].copy() for foot in model.feet)
    return q, (left, right)


def stand_on(model: RobotModel, data: pin.Data, joints: Vector) -> Stance:
    """The stance that joint positions imply when both soles are planted.

    Args:
        model: The robot.
        data: Workspace of ``model.pin``.
        joints: Joint positions (nj,) [rad].

    Returns:
        The stance; its polygon is the convex hull of both contact rectangles projected onto the floor.
    """
    q, soles = plant(model, data, joints)
    corners = np.vstack(
        [sole.act(corner)[:2] for sole, foot in zip(soles, model.feet, strict=True) for corner in foot.corners]
    )
    hull = ConvexHull(corners)
    com = np.array(pin.centerOfMass(model.pin, data, q))
    return Stance(q, soles, corners[hull.vertices], hull.equations, com)
