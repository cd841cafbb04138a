r"""Bounds of a push: linear inverted pendulum without and with steps, and torque limits.

A force F of duration ``T_p`` acts on a pendulum whose centre of pressure is on the edge of its support, at a distance d
ahead of the initial DCM. It moves the DCM to where it would come to rest on a point at a distance D beyond that edge:

.. math:: F (1 - e^{-\omega T_p}) = m \omega^2 (d + D)

Without a step D is zero. With N steps of length ``l`` and duration ``T``, the first of which begins with the push,

.. math:: D_N = (D_{N-1} + l_N) e^{-\omega T} = \sum_{k=1}^{N} l_k e^{-k \omega T}

and d is the distance to the edge of the stance foot; the foot that steps first bears no load.

References:
    Koolen et al.: Capturability-based analysis and control of legged locomotion, part 1, IJRR 2012, eq. 29;
    ``d_N - r_max`` in the paper is ``D_N`` here.

The torque bound is lower than the pendulum bound. The largest horizontal force on the CoM of a standing robot is the
solution of a linear programme in the wrenches ``w`` of both soles, in their frames, and the size of the force ``f``, of
direction ``d``:

.. math::
    \max f \quad \text{s.t.} \quad g(q) - J_c^T w - J_{com}^T d f = (0_6, \tau), \quad
    |\tau| \le \tau_{max}, \quad w \in \text{cone}

Without torque limits the solution is ``m g d_edge / z``: a pendulum with its centre of pressure on the edge of its
support. A push that leaves the DCM on that edge is larger by ``1 / (1 - exp(-omega T_p))``. The torque bound is the
static force of the programme times this factor.

References:
    Bretl, Lall: Testing static equilibrium for legged robots, T-RO 2008 (the programme without torques);
    Orsolino et al.: Feasible region: an actuation-aware extension of the support region, T-RO 2020 (with them).
"""

import math

import numpy as np
import pinocchio as pin
from scipy.optimize import linprog

from controllers.whole_body.limits import CONE_ROWS as ROWS
from controllers.whole_body.limits import fill_cone
from models.constants import GRAVITY
from models.errors import PoiseError
from models.robot_model import RobotModel
from models.types import Matrix, Vector
from planners.gait.config import GaitConfig
from planners.gait.regions import URGENT_REGIONS, region_boxes, region_limits


def ankle_bound(mass: float, height: float, distance: float, duration: float) -> float:
    """Return the largest force [N] for the ankle strategy; ``duration`` [s], ``distance`` from CoP to edge [m]."""
    omega = math.sqrt(GRAVITY / height)
    return mass * omega**2 * distance / (1.0 - math.exp(-omega * duration))


def step_length(gait: GaitConfig, foot: int, direction: Vector) -> float:
    """Return the largest step from the stance sole along a direction (2,) in its frame, including crossing [m]."""
    boxes = region_boxes(region_limits(gait.reach))[list(URGENT_REGIONS), foot]  # (regions, 2, 2)
    return float((boxes * direction[:2]).max(axis=1).sum(axis=1).max())


def step_distance(gait: GaitConfig, omega: float, steps: int, direction: Vector, first: int) -> float:
    """Return ``D_N`` along a direction (2,) [m] with the foot ``first``, past the edge of the other sole."""
    decay = math.exp(-omega * gait.timing.single_urgent)
    return sum(step_length(gait, (first + k) % 2, direction) * decay ** (k + 1) for k in range(steps))


def distance_with_steps(
    gait: GaitConfig, omega: float, steps: int, direction: Vector, edges: tuple[float, float]
) -> float:
    """Return ``d + D_N`` for the better first foot [m].

    ``edges``: distances from the DCM to the far edge of each sole along the direction [m]; ``-inf`` without load.
    """
    return max(edges[1 - first] + step_distance(gait, omega, steps, direction, first) for first in range(2))


FORCE_MAX = 10.0  # upper bound of a sole's normal force in robot weights, too large to be active [-]


def torque_bound(model: RobotModel, q: Vector, direction: Vector, duration: float) -> float:
    """Return the largest push [N] of ``duration`` [s] along a horizontal unit vector in W (3,), at rest, no step."""
    data = model.data()
    pin.framesForwardKinematics(model.pin, data, q)
    sole = np.mean([data.oMf[foot.frame_id].translation[2] for foot in model.feet])
    height = float(pin.centerOfMass(model.pin, data, q)[2] - sole)
    omega = math.sqrt(GRAVITY / height)
    return static_force(model, q, direction, model.tau_max) / (1.0 - math.exp(-omega * duration))


def static_force(model: RobotModel, q: Vector, direction: Vector, tau_max: Vector) -> float:
    """Return the largest force [N] on the CoM at rest along a horizontal unit vector in W; ``PoiseError`` if none."""
    gravity, contact, com = _terms(model, q)
    pulled = com.T @ direction  # (nv,)
    maps = np.column_stack((contact.T, pulled))  # (nv, 13)
    cones, upper = _cones(model)
    limited = np.isfinite(tau_max)
    joints = maps[6:][limited]
    rows = np.vstack((np.column_stack((cones, np.zeros(len(cones)))), -joints, joints))
    bounds = np.concatenate((upper, tau_max[limited] - gravity[6:][limited], tau_max[limited] + gravity[6:][limited]))
    cost = np.zeros(13)
    cost[12] = -1.0
    answer = linprog(
        cost,
        A_ub=rows,
        b_ub=bounds,
        A_eq=maps[:6],
        b_eq=gravity[:6],
        bounds=[(None, None)] * 12 + [(0.0, None)],
        method="highs",
    )
    if answer.x is None:
        raise PoiseError(f"{model.name} cannot stand in this configuration: {answer.message}")
    return float(answer.x[12])


def _terms(model: RobotModel, q: Vector) -> tuple[Vector, Matrix, Matrix]:
    """Return gravity (nv,), Jacobians of both soles in their frames (12, nv), Jacobian of the CoM in W (3, nv)."""
    data = model.data()
    gravity = np.array(pin.computeGeneralizedGravity(model.pin, data, q))
    pin.computeJointJacobians(model.pin, data, q)
    pin.updateFramePlacements(model.pin, data)
    contact = np.vstack(
        [pin.getFrameJacobian(model.pin, data, foot.frame_id, pin.ReferenceFrame.LOCAL) for foot in model.feet]
    )
    return gravity, contact, np.array(pin.jacobianCenterOfMass(model.pin, data, q))


def _cones(model: RobotModel) -> tuple[Matrix, Vector]:
    """Return the rows ``G w <= h`` of the wrenches of both soles (2 (ROWS + 1), 12)."""
    weight = model.mass * GRAVITY
    rows, upper = [], []
    for index, foot in enumerate(model.feet):
        matrix, low, high = np.zeros((ROWS, 6)), np.zeros(ROWS), np.zeros(ROWS)
        rectangle = np.array(foot.rectangle)
        fill_cone(rectangle, foot.friction, 0.0, FORCE_MAX * weight, weight, matrix, low, high)
        placed = np.zeros((ROWS + 1, 12))
        placed[:ROWS, 6 * index : 6 * index + 6] = matrix
        placed[ROWS, 6 * index : 6 * index + 6] = -matrix[-1]  # the normal force is the last row
        rows.append(placed)
        upper.append(np.append(high, -low[-1]))
    return np.vstack(rows), np.concatenate(upper)
