"""How much angular momentum a swing leg takes, by where its foot is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from models.constants import GRAVITY
from models.errors import RobotModelError
from models.robot_model import Foot, RobotModel
from models.types import Matrix, Vector

_REACH = 0.25  # of the leg's length: how far before and behind its stand the foot is looked at
_BEND = 0.06  # of the leg's length: by how much the leg is shorter than standing, as in a swing
_ITERATIONS = 30
_TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True)
class LegLever:
    """Angular momentum about the CoM per velocity of a foot, over the weight; ``x`` is how far the foot is ahead.

    Forward velocity: ``lever + slope x``. A trailing leg is longer from hip to ankle and swings its shank about the
    knee; it has about twice the momentum of one that is as far ahead.

    Attributes:
        lever: Of the forward velocity, foot under the CoM [s^2].
        slope: Its change per metre that the foot is ahead of the CoM [s^2/m].
        lift: Of the upward velocity: the knee comes forward [s^2].
        side: Of the sideways velocity [s^2].
    """

    lever: float
    slope: float
    lift: float
    side: float


def leg_lever(model: RobotModel) -> LegLever:
    """The levers of a robot whose legs are bent as in a swing, mean of both.

    Raises:
        RobotModelError: A foot cannot be moved to where a swing takes it.
    """
    data, q = model.data(), model.standing_configuration()
    pin.forwardKinematics(model.pin, data, q)
    hip = model.pin.supports[model.pin.frames[model.feet[0].frame_id].parentJoint][2]
    length = float(data.oMi[hip].translation[2])
    ahead, forward, lift, side = [], [], [], []
    for foot in model.feet:
        for x in (-_REACH, 0.0, _REACH):
            posed = _pose_foot(model, data, q, foot, length * np.array([x, 0.0, _BEND]))
            momentum = _momentum(model, data, posed, foot)
            ahead.append(float(data.oMf[foot.frame_id].translation[0] - data.com[0][0]))
            forward.append(-momentum[1, 0])
            lift.append(-momentum[1, 2])
            side.append(momentum[0, 1])
    weight = model.mass * GRAVITY
    slope, lever = (float(value) for value in np.polyfit(ahead, forward, 1))
    return LegLever(lever / weight, slope / weight, float(np.mean(lift)) / weight, float(np.mean(side)) / weight)


def _momentum(model: RobotModel, data: pin.Data, q: Vector, foot: Foot) -> Matrix:
    """Angular momentum about the CoM per twist of a foot that its own leg alone moves, in W (3, 6)."""
    pin.computeCentroidalMap(model.pin, data, q)
    jacobian = _jacobian(model, data, q, foot)
    momentum: Matrix = data.Ag[3:, np.array(foot.joint_ids_v)] @ np.linalg.inv(jacobian)
    return momentum


def _jacobian(model: RobotModel, data: pin.Data, q: Vector, foot: Foot) -> Matrix:
    """Of a foot by the joints of its leg, in W (6, 6); updates the frames of ``data``."""
    pin.computeJointJacobians(model.pin, data, q)
    pin.updateFramePlacements(model.pin, data)
    jacobian: Matrix = pin.getFrameJacobian(model.pin, data, foot.frame_id, pin.LOCAL_WORLD_ALIGNED)
    return jacobian[:, np.array(foot.joint_ids_v)]


def _pose_foot(model: RobotModel, data: pin.Data, q: Vector, foot: Foot, shift: Vector) -> Vector:
    """The posture with one sole moved by ``shift`` (3,) [m], still level; the base stays."""
    posed = q.copy()
    _jacobian(model, data, posed, foot)
    target = data.oMf[foot.frame_id].copy()
    target.translation = target.translation + shift
    joints = np.array(foot.joint_ids_v) + (model.nq - model.nv)
    for _ in range(_ITERATIONS):
        jacobian = _jacobian(model, data, posed, foot)
        here = data.oMf[foot.frame_id]
        turn = pin.log3(target.rotation @ here.rotation.T)
        error = np.concatenate([target.translation - here.translation, turn])
        if np.linalg.norm(error) < _TOLERANCE:
            return posed
        posed[joints] += np.linalg.solve(jacobian, error)
    raise RobotModelError(f"{model.name}: the {foot.name} foot cannot be moved by {shift.round(3)} m from 'stand'")
