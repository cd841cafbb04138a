"""Extent of a leg ahead of its sole and behind it by height, for the distance to higher ground."""

from itertools import product

import numpy as np
import pinocchio as pin
from coal import BVHModelBase

from models.leg_shapes import leg_shapes
from models.numerics.compiled import register_jitable
from models.numerics.hull import convex_hull
from models.robot_model import RobotModel
from models.types import Matrix
from planners.gait.reaction import pose_foot

_LAYER = 0.01  #: Spacing of the heights above the sole [m]
_HIGHEST = 0.8  #: Largest height above the sole [m]
_SAMPLES = 20  #: Points on each edge of an outline


def leg_extent(robot: RobotModel, crouch: float) -> Matrix:
    """Least and largest x of the leg below each height of ``layer_at`` (n, 2) [m], in the frame of its sole.

    The body is upright over the sole and ``crouch`` [m] lower than in standing. Links count with the convex outline of
    their side view, the foot with the rectangle of its sole.
    """
    foot, data, stand = robot.feet[0], robot.data(), robot.standing_configuration()
    pin.framesForwardKinematics(robot.pin, data, stand)
    raised = data.oMf[foot.frame_id].copy()
    raised.translation = raised.translation + np.array([0.0, 0.0, crouch])
    pin.framesForwardKinematics(robot.pin, data, pose_foot(robot, data, stand, foot, raised))
    sole, ankle = data.oMf[foot.frame_id], robot.pin.frames[foot.frame_id].parentJoint
    leg = set(robot.pin.supports[ankle]) - {ankle}
    outlines = [np.array([(x, 0.0) for x in foot.rectangle[:2]])]
    for body in leg_shapes(robot).geometryObjects:
        if body.parentJoint in leg:
            outlines.append(_outline(body, sole.actInv(data.oMi[body.parentJoint] * body.placement)))
    x, z = np.concatenate(outlines).T
    heights = _LAYER * np.arange(1, round(_HIGHEST / _LAYER) + 1)
    return np.array([(x[z <= height].min(), x[z <= height].max()) for height in heights])


@register_jitable
def layer_at(height: float, count: int) -> int:
    """Row of ``leg_extent``, which has ``count`` rows, for ground at a height above the sole [m]."""
    return min(max(round(height / _LAYER), 1), count) - 1


def _outline(body: pin.GeometryObject, place: pin.SE3) -> Matrix:
    """Outline x, z (n, 2) [m] of a mesh, or of the bounding box of another shape, at a placement."""
    shape = body.geometry
    if isinstance(shape, BVHModelBase):
        vertices = shape.vertices()
    else:
        shape.computeLocalAABB()
        vertices = np.array([*product(*zip(shape.aabb_local.min_, shape.aabb_local.max_, strict=True))])
    points = (vertices @ place.rotation.T + place.translation)[:, [0, 2]]
    points = np.ascontiguousarray(points[np.lexsort(points.T[::-1])])  # the hull is faster for sorted points
    hull = np.empty((2 * len(points), 2))
    corners = hull[: convex_hull(points, hull)]
    shares = np.linspace(0.0, 1.0, _SAMPLES, endpoint=False)[:, None, None]
    outline: Matrix = (corners + shares * (np.roll(corners, -1, axis=0) - corners)).reshape(-1, 2)
    return outline
