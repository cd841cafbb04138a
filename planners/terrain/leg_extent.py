"""Extent of a leg ahead of its sole and behind it by height, for the distance to higher ground."""

from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from coal import BVHModelBase
from numpy.typing import NDArray

from models.errors import RobotModelError
from models.leg_shapes import extreme_points, leg_shapes
from models.numerics.compiled import register_jitable
from models.numerics.hull import convex_hull
from models.robot_model import RobotModel
from models.types import Matrix, Vector
from planners.gait.reaction import pose_foot

_LAYER = 0.01  #: Spacing of the heights above the sole [m]
_HIGHEST = 0.8  #: Largest height above the sole [m]
_HEIGHTS = _LAYER * np.arange(1, round(_HIGHEST / _LAYER) + 1)
_SAMPLES = 20  #: Points on each edge of an outline
_STEP = 0.075  #: Spacing of the positions of the hip, as a share of the leg length [-]
_AHEAD = 6  #: Number of positions of the hip ahead of the sole, and behind it
_LOWER = 8  #: Number of positions of the hip below its height in 'stand'
_BENT = 2  #: The one of these for which the CoM is computed: 0.15 of the leg, about the crouch on steps of 15 cm


class LegExtents(NamedTuple):
    """Extent of a leg over positions of its hip, for compiled code."""

    table: NDArray[np.float64]  #: ``leg_extent`` by hip ahead of the sole, then by hip below 'stand' (a, b, n, 2) [m]
    step: float  #: Spacing of these positions [m]
    lift: float  #: Height by which a foot that is raised raises the CoM of a robot whose base is fixed, per height [-]
    com: float  #: Position of the CoM ahead of the soles if these are under the hips and the knees bent [m]


def leg_extent(robot: RobotModel, crouch: float) -> Matrix:
    """Least and largest x of the leg below each height of ``layer_at`` (n, 2) [m], in the frame of its sole.

    The body is upright over the sole and ``crouch`` [m] lower than in standing. Links count with the convex outline of
    their side view, the foot with the rectangle of its sole.
    """
    leg = _Leg(robot)
    return leg.extent(0.0, crouch, leg.stand)[1]


@lru_cache(maxsize=8)
def leg_extents(robot: RobotModel) -> LegExtents:
    """Extents of a leg for hips ahead of the sole, behind it, and lower than in 'stand'; the sole is level.

    Where the leg does not reach a position, the next lower one of the hip counts, or else the next one nearer the sole.
    Joint limits do not count: an ankle at its limit tilts the sole instead. Between positions the extents are within
    3 cm of those of the posed leg.
    """
    leg, step = _Leg(robot, coarse=True), _STEP * robot.leg_length
    table = np.full((2 * _AHEAD + 1, _LOWER + 1, len(_HEIGHTS), 2), np.nan)
    upright = leg.stand
    for j in range(_LOWER + 1):
        for side in (1, -1):
            posed = upright
            for i in range(_AHEAD + 1):
                try:
                    posed, table[_AHEAD + side * i, j] = leg.extent(side * i * step, j * step, posed)
                except RobotModelError:
                    break
                upright = posed if i == 0 else upright
    for j in range(_LOWER - 1, -1, -1):
        short = np.isnan(table[:, j])
        table[:, j][short] = table[:, j + 1][short]
    for side in (1, -1):
        for i in range(1, _AHEAD + 1):
            row, nearer = table[_AHEAD + side * i], table[_AHEAD + side * (i - 1)]
            row[np.isnan(row)] = nearer[np.isnan(row)]
    return LegExtents(table, step, *leg.com(_BENT * step))


@register_jitable
def layer_at(height: float, count: int) -> int:
    """Row of ``leg_extent``, which has ``count`` rows, for ground at a height above the sole [m]."""
    return min(max(round(height / _LAYER), 1), count) - 1


@register_jitable
def extent_at(extents: LegExtents, ahead: float, lower: float, layer: int, end: int) -> float:
    """Least (``end`` 0) or largest (1) x of a leg [m] whose hip is ``ahead`` of the sole and ``lower`` [m]."""
    table, step = extents.table, extents.step
    a = min(max(ahead / step + _AHEAD, 0.0), 2.0 * _AHEAD - 1e-9)
    b = min(max(lower / step, 0.0), _LOWER - 1e-9)
    i, j = int(a), int(b)
    u, v = a - i, b - j
    near = (1.0 - v) * table[i, j, layer, end] + v * table[i, j + 1, layer, end]
    return float((1.0 - u) * near + u * ((1.0 - v) * table[i + 1, j, layer, end] + v * table[i + 1, j + 1, layer, end]))


class _Leg:
    """Left leg of a robot, to be posed below its hip."""

    def __init__(self, robot: RobotModel, *, coarse: bool = False) -> None:
        """``coarse`` meshes consist of their ``extreme_points``."""
        self._robot, self._data, self.stand = robot, robot.data(), robot.standing_configuration()
        self._foot = robot.feet[0]
        pin.framesForwardKinematics(robot.pin, self._data, self.stand)
        self._place = self._data.oMf[self._foot.frame_id].copy()
        ankle = robot.pin.frames[self._foot.frame_id].parentJoint
        leg = set(robot.pin.supports[ankle]) - {ankle}
        self._bodies = [
            (body.parentJoint, body.placement, _vertices(body, coarse))
            for body in leg_shapes(robot).geometryObjects
            if body.parentJoint in leg
        ]

    def extent(self, ahead: float, lower: float, near: Vector) -> tuple[Vector, Matrix]:
        """Configuration and ``leg_extent`` with the hip ahead of the sole and lower than in 'stand' [m].

        ``near`` is a configuration from which the leg is posed. Raises ``RobotModelError`` if the leg is too short.
        """
        robot, data, foot = self._robot, self._data, self._foot
        target = pin.SE3(self._place.rotation, self._place.translation + np.array([-ahead, 0.0, lower]))
        posed = pose_foot(robot, data, near, foot, target)
        pin.framesForwardKinematics(robot.pin, data, posed)
        sole = data.oMf[foot.frame_id]
        outlines = [np.array([(x, 0.0) for x in foot.rectangle[:2]])]
        outlines += [
            _outline(vertices, sole.actInv(data.oMi[joint] * place)) for joint, place, vertices in self._bodies
        ]
        x, z = np.concatenate(outlines).T
        order = np.argsort(z)
        last = np.searchsorted(z[order], _HEIGHTS, side="right") - 1
        ends = np.minimum.accumulate(x[order])[last], np.maximum.accumulate(x[order])[last]
        return posed, np.column_stack(ends)

    def com(self, bend: float) -> tuple[float, float]:
        """``LegExtents.lift``, and ``LegExtents.com`` for hips lower than in 'stand' by ``bend`` [m]."""
        raised = pin.SE3(self._place.rotation, self._place.translation + np.array([0.0, 0.0, bend]))
        posed = pose_foot(self._robot, self._data, self.stand, self._foot, raised)
        straight, bent = (pin.centerOfMass(self._robot.pin, self._data, q).copy() for q in (self.stand, posed))
        moved = bent - straight  # by one of the legs
        return float(moved[2]) / bend, float(straight[0] - self._place.translation[0] + 2.0 * moved[0])


def _vertices(body: pin.GeometryObject, coarse: bool) -> Matrix:
    """Vertices of a mesh, or of the bounding box of another shape (n, 3) [m]."""
    shape = body.geometry
    if isinstance(shape, BVHModelBase):
        return extreme_points(shape.vertices()) if coarse else np.asarray(shape.vertices())
    shape.computeLocalAABB()
    return np.array([*product(*zip(shape.aabb_local.min_, shape.aabb_local.max_, strict=True))])


def _outline(vertices: Matrix, place: pin.SE3) -> Matrix:
    """Outline x, z (n, 2) [m] of the side view of a body with these vertices (k, 3) [m] at a placement."""
    points = (vertices @ place.rotation.T + place.translation)[:, [0, 2]]
    points = np.ascontiguousarray(points[np.lexsort(points.T[::-1])])  # the hull is faster for sorted points
    hull = np.empty((2 * len(points), 2))
    corners = hull[: convex_hull(points, hull)]
    shares = np.linspace(0.0, 1.0, _SAMPLES, endpoint=False)[:, None, None]
    outline: Matrix = (corners + shares * (np.roll(corners, -1, axis=0) - corners)).reshape(-1, 2)
    return outline
