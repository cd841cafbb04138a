r"""Reaction of the swing leg: offset of the centroidal moment pivot (CMP) from the centre of pressure.

A leg that is accelerated forward takes angular momentum about the CoM, ``L' = -F''`` with

.. math:: F = (\lambda x + \tfrac12 \kappa (x - c)^2 + \zeta z, \; \sigma y) \, m g

``x, y, z`` is the position of its foot along the heading, sideways and up, and ``c`` the position of the CoM along the
heading; ``leg_lever`` computes the four coefficients. The line of the ground force then misses the CoM: the CMP, which
drives the DCM, is ``F'' / (m g)`` behind the CoP. Over the last ``R`` seconds of a swing, with the CoP at the origin,

.. math::
    \xi(T) = e^{\omega R} (\xi(t) - d), \quad
    d = -\int_0^R \omega e^{-\omega s} \ddot F ds
      = \omega (\dot F_0 - e^{-\omega R} \dot F_R) + \omega^2 (F_0 - e^{-\omega R} F_R)
        - \omega^3 \int_0^R e^{-\omega s} F ds

``d`` depends on the present and final position and velocity of the foot, not on its acceleration, so it is continuous
when the foothold or the time changes.

References:
    Popovic, Goswami, Herr: Ground reference points in legged locomotion, IJRR 2005 (CMP).
"""

import math
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from models.constants import GRAVITY
from models.errors import RobotModelError
from models.foot import Foot
from models.numerics.compiled import register_jitable
from models.robot_model import RobotModel
from models.spline import quintic_step
from models.types import Matrix, Vector
from planners.gait.footsteps import Point
from planners.gait.pace import Pace
from planners.gait.swing import YAW, SwingMotion, SwingShape, Z, end_acceleration
from planners.gait.tread import clearance_over, swing_shares

Body = tuple[Vector, Vector]  #: CoM [m] and its velocity [m/s] in W, each (3,)

# Gauss-Legendre on [0, 1]
_NODES = np.array([0.0694318442029737, 0.3300094782075719, 0.6699905217924281, 0.9305681557970263])
_WEIGHTS = np.array([0.1739274225687269, 0.3260725774312731, 0.3260725774312731, 0.1739274225687269])

_REACH = 0.25  # range of foot positions ahead of and behind the standing position, as a share of the leg length
_BEND = 0.06  # shortening of the leg in a swing, as a share of the leg length
_ITERATIONS = 30
_TOLERANCE = 1e-6


class LegLever(NamedTuple):
    """Angular momentum about the CoM per velocity of a foot, divided by the weight.

    For the forward velocity it is ``lever + slope x``, with the distance x of the foot ahead of the CoM. A trailing leg
    is longer from hip to ankle and swings its shank about the knee; it has about twice the momentum of a leading leg.
    """

    lever: float  # lambda, for forward velocity with the foot under the CoM [s^2]
    slope: float  # kappa, change of lambda per distance of the foot ahead of the CoM [s^2/m]
    lift: float  # zeta, for upward velocity: the knee moves forward [s^2]
    side: float  # sigma, for lateral velocity [s^2]


class SwingLeg(NamedTuple):
    """Constants of the reaction of a swing."""

    shape: SwingShape
    lever: LegLever


@register_jitable
def _allowance(
    omega: float, left: float, rise: float, waits: Point, foot: Vector, ahead: float, drift: float, lever: LegLever
) -> tuple[float, float]:
    """``d`` along the heading and sideways [m], at ``left`` [s] before touchdown and ``rise`` [s] before the apex.

    ``waits`` are the times without horizontal motion of the foot, from now on and before the touchdown [s].

    ``foot`` (16,) has position, velocity and acceleration along the heading, sideways and up; remaining displacement
    along and sideways; heights of apex and landing; vertical velocity at landing; acceleration there along and
    sideways. ``ahead`` is the distance of the foot ahead of the CoM [m], ``drift`` the CoM velocity along [m/s].
    """
    x, y, z = foot[0:3], foot[3:6], foot[6:9]
    x_end, y_end, top, floor = foot[9], foot[10], foot[11], foot[12]
    v_end, ax_end, ay_end = foot[13], foot[14], foot[15]
    rising = 0.0 < rise < left
    middle = rise if rising else 0.0
    moving = left - waits[0] - waits[1]
    integral, side = 0.0, 0.0
    for part in range(2):
        begin, span = (0.0, middle) if part == 0 else (middle, left - middle)
        if span <= 0.0:
            continue
        for i in range(4):
            t = begin + _NODES[i] * span
            weight = _WEIGHTS[i] * span * math.exp(-omega * t)
            gone = min(max(t - waits[0], 0.0), moving)
            px = quintic_step(0.0, x[1], x[2], (x_end, 0.0, ax_end), moving, gone)[0]
            if part == 0:
                pz = quintic_step(z[0], z[1], z[2], (top, 0.0, 0.0), middle, t)[0]
            elif rising:
                pz = quintic_step(top, 0.0, 0.0, (floor, v_end, 0.0), left - middle, t - middle)[0]
            else:
                pz = quintic_step(z[0], z[1], z[2], (floor, v_end, 0.0), left, t)[0]
            before = ahead + px - drift * t
            integral += weight * (lever.lever * px + 0.5 * lever.slope * before * before + lever.lift * pz)
            side += weight * lever.side * quintic_step(0.0, y[1], y[2], (y_end, 0.0, ay_end), moving, gone)[0]
    decay = math.exp(-omega * left)
    last = ahead + x_end - drift * left
    first = 0.5 * lever.slope * ahead * ahead + lever.lift * z[0]
    final = lever.lever * x_end + 0.5 * lever.slope * last * last + lever.lift * floor
    rate = lever.lever * x[1] + lever.slope * ahead * (x[1] - drift) + lever.lift * z[1]
    rate_end = -lever.slope * last * drift + lever.lift * v_end
    along = omega * (rate - decay * rate_end + omega * (first - decay * final - omega * integral))
    return along, omega * lever.side * y[1] - omega * omega * (decay * lever.side * y_end + omega * side)


@register_jitable
def whole_swing(
    omega: float, pace: Pace, way: Point, yaw: float, leg: SwingLeg, rise: float = 0.0, over: float = 0.0
) -> Point:
    """``d`` at the lift-off of a step of a steady walk, in W [m].

    ``way`` is the displacement of the foot, ``rise`` the known height of its target above lift-off, ``over`` the height
    of an obstacle above the higher of both [m].
    """
    shape, lever = leg
    c, s, foot = math.cos(yaw), math.sin(yaw), np.zeros(16)
    foot[9], foot[10] = c * way[0] + s * way[1], c * way[1] - s * way[0]
    clearance = clearance_over(rise, pace.clearance, shape.edge_clearance, over)
    length, early = math.hypot(way[0], way[1]), shape.freeze / pace.single
    shares = swing_shares(rise, clearance, length, shape.apex, shape.edge, early, over)
    apex, waits = shares[0] * pace.single, (shares[1] * pace.single, shares[2] * pace.single)
    for i in range(2):
        foot[14 + i] = end_acceleration(foot[9 + i], pace.single - waits[0] - waits[1], pace.least_effort)
        foot[2 + 3 * i] = -foot[14 + i]
    foot[11], foot[12], foot[13] = max(rise, 0.0) + clearance, rise, -shape.landing_velocity
    drift = 0.5 * foot[9] / (pace.single + pace.double)
    ahead = 0.5 * (drift * pace.single - foot[9])  # as far behind at lift-off as ahead at touchdown
    x, y = _allowance(omega, pace.single, apex, waits, foot, ahead, drift, lever)
    return c * x - s * y, s * x + c * y


@register_jitable
def rest_of_swing(omega: float, left: float, swing: SwingMotion, body: Body, leg: SwingLeg) -> Point:
    """``d``: shift of the DCM by the rest of the swing, ``left`` [s] before touchdown, in W [m]."""
    (motion, heights, shares, duration, braking, target), (com, com_velocity), (shape, lever) = swing, body, leg
    left = max(left, shape.freeze)  # the last moments are stretched, see swing.py
    rise = left - (1.0 - shares[0]) * duration
    settle = min(shares[2] * duration, left - shape.freeze)
    wait = min(max(left - (1.0 - shares[1]) * duration, 0.0) if shares[1] > 0.0 else 0.0, left - settle - shape.freeze)
    if rise <= shape.freeze:
        rise = 0.0
    foot, place = np.zeros(16), motion[0]
    c, s = math.cos(place[YAW]), math.sin(place[YAW])
    for k in range(3):
        x, y = motion[k, 0], motion[k, 1]
        foot[k], foot[3 + k], foot[6 + k] = c * x + s * y, c * y - s * x, motion[k, Z]
    way_x, way_y = target[0] - place[0], target[1] - place[1]
    foot[9], foot[10] = c * way_x + s * way_y, c * way_y - s * way_x
    foot[11], foot[12], foot[13] = heights[0], heights[1], -shape.landing_velocity
    foot[14], foot[15] = c * braking[0] + s * braking[1], c * braking[1] - s * braking[0]
    ahead = c * (place[0] - com[0]) + s * (place[1] - com[1])
    drift = c * com_velocity[0] + s * com_velocity[1]
    x, y = _allowance(omega, left, rise, (wait, settle), foot, ahead, drift, lever)
    return c * x - s * y, s * x + c * y


@register_jitable
def cmp_offset(motion: Matrix, com: Vector, com_velocity: Vector, lever: LegLever) -> Point:
    """Present CMP minus CoP, in W [m]; arguments as for ``rest_of_swing``."""
    place, velocity, acceleration = motion[0], motion[1], motion[2]
    c, s = math.cos(place[YAW]), math.sin(place[YAW])
    ax, ay = acceleration[0], acceleration[1]
    x = c * (place[0] - com[0]) + s * (place[1] - com[1])
    v = c * (velocity[0] - com_velocity[0]) + s * (velocity[1] - com_velocity[1])
    along = (lever.lever + lever.slope * x) * (c * ax + s * ay) + lever.slope * v * v + lever.lift * acceleration[Z]
    across = lever.side * (c * ay - s * ax)
    return s * across - c * along, -s * along - c * across


@register_jitable
def swing_slope(omega: float, duration: float, lever: LegLever) -> float:
    """Approximate change of ``d`` at lift-off per change of the foot's displacement [-]; swing ``duration`` in [s]."""
    return -lever.lever * omega * omega * math.exp(-0.5 * omega * duration)


def leg_lever(model: RobotModel) -> LegLever:
    """Mean levers of both legs, bent as in a swing; ``RobotModelError`` if the legs cannot reach the foot positions."""
    data, q = model.data(), model.standing_configuration()
    length = model.leg_length
    ahead, forward, lift, side = [], [], [], []
    for foot in model.feet:
        _jacobian(model, data, q, foot)
        sole = data.oMf[foot.frame_id].copy()
        for x in (-_REACH, 0.0, _REACH):
            place = pin.SE3(sole.rotation, sole.translation + length * np.array([x, 0.0, _BEND]))
            posed = pose_foot(model, data, q, foot, place)
            momentum = _momentum(model, data, posed, foot)
            ahead.append(float(data.oMf[foot.frame_id].translation[0] - data.com[0][0]))
            forward.append(-momentum[1, 0])
            lift.append(-momentum[1, 2])
            side.append(momentum[0, 1])
    weight = model.mass * GRAVITY
    slope, lever = (float(value) for value in np.polyfit(ahead, forward, 1))
    return LegLever(lever / weight, slope / weight, float(np.mean(lift)) / weight, float(np.mean(side)) / weight)


def _momentum(model: RobotModel, data: pin.Data, q: Vector, foot: Foot) -> Matrix:
    """Angular momentum about the CoM per velocity of a foot that only its leg moves, in W (3, 3)."""
    pin.computeCentroidalMap(model.pin, data, q)
    jacobian = _jacobian(model, data, q, foot)
    momentum: Matrix = data.Ag[3:, np.array(foot.joint_ids_v)] @ _solve(jacobian, np.eye(len(jacobian))[:, :3])
    return momentum


def _solve(jacobian: Matrix, right: Matrix) -> Matrix:
    """Joint motion of a leg for a motion of its foot; of least norm for a redundant leg."""
    square = jacobian.shape[0] == jacobian.shape[1]
    return np.asarray(np.linalg.solve(jacobian, right) if square else np.linalg.lstsq(jacobian, right)[0], dtype=float)


def _held(foot: Foot) -> list[int]:
    """Components of a twist of the sole that its leg controls, without the free rotations."""
    return [0, 1, 2, *(3 + axis for axis in range(3) if not foot.free[axis])]


def _jacobian(model: RobotModel, data: pin.Data, q: Vector, foot: Foot) -> Matrix:
    """Jacobian of a foot for the joints of its leg, in W, rows of ``_held``; updates the frames of ``data``."""
    pin.computeJointJacobians(model.pin, data, q)
    pin.updateFramePlacements(model.pin, data)
    jacobian: Matrix = pin.getFrameJacobian(model.pin, data, foot.frame_id, pin.LOCAL_WORLD_ALIGNED)
    return jacobian[np.ix_(_held(foot), foot.joint_ids_v)]


def pose_foot(model: RobotModel, data: pin.Data, q: Vector, foot: Foot, target: pin.SE3) -> Vector:
    """Configuration with one sole at a pose in W and a fixed base; ``RobotModelError`` if the pose is out of reach."""
    posed, held = q.copy(), _held(foot)
    joints = np.array(foot.joint_ids_v) + (model.nq - model.nv)
    for _ in range(_ITERATIONS):
        jacobian = _jacobian(model, data, posed, foot)
        here = data.oMf[foot.frame_id]
        turn = pin.log3(target.rotation @ here.rotation.T)
        error = np.concatenate([target.translation - here.translation, turn])[held]
        if np.linalg.norm(error) < _TOLERANCE:
            return posed
        posed[joints] += _solve(jacobian, error)
    way = (target.translation - here.translation).round(3)
    raise RobotModelError(f"{model.name}: the {foot.name} foot cannot be moved by {way} m: out of its leg's reach")
