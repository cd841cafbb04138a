"""Limit of the whole-body QP that prevents collisions between the legs."""

from operator import itemgetter

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from controllers.qp.contacts import Reduction
from controllers.qp.terms import Terms
from controllers.whole_body.config import LegClearanceConfig
from controllers.whole_body.limits import UNBOUNDED, AccelerationLimit, Rows
from models.constants import JOINTS_Q, JOINTS_V
from models.leg_shapes import leg_chains, leg_shapes
from models.numerics.compiled import njit
from models.robot_model import RobotModel
from models.types import Reference

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_SCALE = 0.01  #: Scale of rows and bounds, as in ``JointLimit``; a relaxed solve violates this limit first
_LOOK_TICKS = 4  #: Ticks between two checks of all pairs while none is near
_ROWS = 3  #: Largest number of bounded pairs


class LegClearanceLimit(AccelerationLimit):
    r"""Keep the nearest shapes of the left and right leg at least ``gap`` apart.

    .. math:: \ddot d \ge \mathrm{clip}(k (g (d_{gap} - d) - \dot d), \pm \ddot d_{max}), \qquad
        \ddot d \approx n^T (J_l - J_r) \ddot q

    for up to three pairs of convex hulls nearer than ``reach``, while a foot swings. The normal n points from the
    nearest point of the right leg to the nearest point of the left leg; J are the Jacobians of these points. The
    feedback compensates the neglected drift of the acceleration. Pairs nearer than the gap in the 'stand' posture are
    excluded, since a hull is larger than its shape.

    Each tick, or each fourth tick while no pair is near, measures the three nearest known pairs and three others that
    may be near. Since the last measurement of a pair, a point of a leg has moved by at most the sum of the joint
    changes times the distances of the joints from it in the stretched leg.
    """

    def __init__(self, model: RobotModel, config: LegClearanceConfig) -> None:
        super().__init__("leg_clearance", _ROWS, model.nv)
        robot, self._config, self._geometry = model.pin, config, leg_shapes(model, hulls=True)
        self._data, standing, legs = self._geometry.createData(), model.standing_configuration(), leg_chains(model)
        pin.updateGeometryPlacements(robot, model.data(), self._geometry, self._data, standing)
        pairs = list(enumerate(self._geometry.collisionPairs))
        apart = [self._measure(k).min_distance for k, _ in pairs]
        self._pairs = [(k, pair) for k, pair in pairs if apart[k] > config.gap]
        bodies = self._geometry.geometryObjects
        above = [set(robot.supports[body.parentJoint]) for body in bodies]
        self._columns = [
            (_columns(robot, above[pair.first] & legs[0]), _columns(robot, above[pair.second] & legs[1]))
            for _, pair in self._pairs
        ]
        self._joints = np.concatenate([_columns(robot, leg) for leg in legs]) - JOINTS_V + JOINTS_Q
        levers = [_levers(robot, body) for body in bodies]
        self._levers = np.array(
            [(levers[pair.first] + levers[pair.second])[self._joints - JOINTS_Q] for _, pair in self._pairs]
        )
        self._standing = np.array([apart[k] for k, _ in self._pairs]), standing[self._joints]
        self._distances = np.empty(len(self._pairs))  # last measured distances [m]
        self._measured = np.empty((len(self._pairs), len(self._joints)))  # joint positions of that measurement [rad]
        self.reset()

    def reset(self) -> None:
        """Reset the distances to those of the 'stand' posture."""
        self._distances[:], self._measured[:] = self._standing
        self._ticks_to_look = 0

    def update(self, terms: Terms, reference: Reference, reduction: Reduction, rows: Rows) -> None:
        """Write the rows of this tick; rows without a bound are unchanged."""
        self.bound(terms, reference)
        if self.lower[0] > -UNBOUNDED or rows.lower[0] != -UNBOUNDED:
            self.write(reduction, rows)

    def bound(self, terms: Terms, reference: Reference) -> None:
        """Rows of the nearest pairs. The other rows have no bound; no row has one while both feet are planted."""
        if self.lower[0] > -UNBOUNDED:
            self.matrix[:], self.lower[:] = 0.0, -UNBOUNDED
        self._ticks_to_look -= 1
        if all(reference.contacts) or self._ticks_to_look > 0:
            return
        config, distances, measured = self._config, self._distances, self._measured
        self._ticks_to_look = _LOOK_TICKS
        near = _nearest(terms.q, self._joints, measured, distances, self._levers, config.reach)
        if not len(near):
            return
        terms.place(self._geometry, self._data)
        joints = terms.q[self._joints]
        looked: list[tuple[float, int, coal.DistanceResult]] = []
        for k in near.tolist():
            result = self._measure(self._pairs[k][0])
            distances[k], measured[k] = result.min_distance, joints
            if distances[k] < config.reach:
                looked.append((distances[k], k, result))
        for row, (distance, k, result) in enumerate(sorted(looked, key=itemgetter(0))[:_ROWS]):
            first, second = result.getNearestPoint1(), result.getNearestPoint2()
            normal = (first - second) / distance if distance > 0.0 else -result.normal
            jacobian, out = terms.joint_jacobian, self.matrix[row]
            rate = _distance_row(jacobian, terms.v, normal, first, second, *self._columns[k], out)
            target = config.velocity_gain * (config.position_gain * (config.gap - distance) - rate)
            self.lower[row] = _SCALE * min(max(target, -config.acceleration), config.acceleration)
            out *= _SCALE
            self._ticks_to_look = 0

    def _measure(self, pair: int) -> coal.DistanceResult:
        return pin.computeDistance(self._geometry, self._data, pair)


def _columns(robot: pin.Model, joints: set[int]) -> Index:
    """Velocity indices of joints with one degree of freedom."""
    return np.array([robot.idx_vs[joint] for joint in sorted(joints)], dtype=np.int64)


def _levers(robot: pin.Model, body: pin.GeometryObject) -> Array:
    """Largest distance of the points of a shape from each joint that moves it (nj,) [m]."""
    body.geometry.computeLocalAABB()
    centre, levers = body.placement.act(body.geometry.aabb_center), np.zeros(robot.nv - JOINTS_V)
    joint, distance = body.parentJoint, float(np.linalg.norm(centre) + body.geometry.aabb_radius)
    while robot.idx_vs[joint] >= JOINTS_V:
        levers[robot.idx_vs[joint] - JOINTS_V] = distance
        distance += float(np.linalg.norm(robot.jointPlacements[joint].translation))
        joint = robot.parents[joint]
    return levers


@njit(cache=True)
def _nearest(q: Array, joints: Index, measured: Array, distances: Array, levers: Array, reach: float) -> Index:
    """Up to ``_ROWS`` pairs last measured within ``reach``, and up to ``_ROWS`` others that may be within it now."""
    least, chosen = distances.copy(), np.zeros(distances.shape[0], dtype=np.bool_)
    for pair in range(least.shape[0]):
        for i in range(joints.shape[0]):
            least[pair] -= levers[pair, i] * abs(q[joints[i]] - measured[pair, i])
    for pair in np.argsort(distances)[:_ROWS]:
        chosen[pair] = distances[pair] < reach
    left = _ROWS
    for pair in np.argsort(least):
        if left > 0 and least[pair] < reach and not chosen[pair]:
            chosen[pair] = True
            left -= 1
    return np.flatnonzero(chosen)


@njit(cache=True)
def _distance_row(
    jacobian: Array, v: Array, normal: Array, first: Array, second: Array, left: Index, right: Index, row: Array
) -> float:
    """Write the gradient of a distance with respect to the joints (nv,) [m/rad]; returns its rate [m/s].

    ``jacobian`` is ``Terms.joint_jacobian``; ``normal`` (3,) points from ``second`` to ``first`` (3,).
    """
    rate = 0.0
    for sign, point, columns in ((1.0, first, left), (-1.0, second, right)):
        mx = point[1] * normal[2] - point[2] * normal[1]
        my = point[2] * normal[0] - point[0] * normal[2]
        mz = point[0] * normal[1] - point[1] * normal[0]
        for k in columns:
            linear = normal[0] * jacobian[0, k] + normal[1] * jacobian[1, k] + normal[2] * jacobian[2, k]
            row[k] = sign * (linear + mx * jacobian[3, k] + my * jacobian[4, k] + mz * jacobian[5, k])
            rate += row[k] * v[k]
    return rate
