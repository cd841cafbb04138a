"""How far a leg reaches ahead of its sole and behind it, where ground beside the sole is higher."""

from itertools import product

import numpy as np
import pinocchio as pin
from coal import BVHModelBase

from models.leg_shapes import leg_shapes
from models.robot_model import RobotModel
from models.types import Matrix
from planners.gait.reaction import pose_foot

LAYER = 0.01  #: Between two heights above the sole [m]
_HIGHEST = 0.8  #: The highest one [m]
_SAMPLES = 10  #: Along each edge of a box


def leg_room(robot: RobotModel, crouch: float) -> Matrix:
    """Least and largest x, in the frame of a sole, of the leg over it up to heights ``LAYER`` apart (n, 2) [m].

    The body is upright over the sole, lower by ``crouch`` [m] than standing. Shapes are those of the links, without
    that of the foot: the sole has its rectangle.
    """
    foot, data, stand = robot.feet[0], robot.data(), robot.standing_configuration()
    pin.framesForwardKinematics(robot.pin, data, stand)
    raised = data.oMf[foot.frame_id].copy()
    raised.translation = raised.translation + np.array([0.0, 0.0, crouch])
    pin.framesForwardKinematics(robot.pin, data, pose_foot(robot, data, stand, foot, raised))
    sole, ankle = data.oMf[foot.frame_id], robot.pin.frames[foot.frame_id].parentJoint
    leg = set(robot.pin.supports[ankle]) - {ankle}
    points = [np.array([(x, 0.0) for x in foot.rectangle[:2]])]
    for body in leg_shapes(robot).geometryObjects:
        if body.parentJoint in leg:
            place = sole.actInv(data.oMi[body.parentJoint] * body.placement)
            points.append((_points(body) @ place.rotation.T + place.translation)[:, [0, 2]])
    x, z = np.concatenate(points).T
    heights = LAYER * np.arange(1, round(_HIGHEST / LAYER) + 1)
    return np.array([(x[z <= height].min(), x[z <= height].max()) for height in heights])


def _points(body: pin.GeometryObject) -> Matrix:
    """Points on a shape in its frame, the vertices of a mesh or the grid of a box around it (n, 3) [m]."""
    shape = body.geometry
    if isinstance(shape, BVHModelBase):
        vertices: Matrix = shape.vertices()
        return vertices
    shape.computeLocalAABB()
    return np.array([*product(*np.linspace(shape.aabb_local.min_, shape.aabb_local.max_, _SAMPLES).T)])
