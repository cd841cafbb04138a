r"""Reaction of the swing leg: how far the line of the ground force passes from the centre of pressure.

A leg that is accelerated forward takes angular momentum about the CoM, ``L' = -I a`` with ``a`` the acceleration of its
foot. The ground force then passes not through the CoM but through the centroidal moment pivot

.. math:: p_{cmp} = p_{cop} - \lambda a, \quad \lambda = I / (m g)

and it is the CMP that drives the DCM. Integrated over what is left of a swing, ``R`` seconds in which the foot goes
from its velocity ``v`` to rest over the way ``r``, with the CoP at the origin,

.. math::
    \xi(T) = e^{\omega R} (\xi(t) - d), \quad d = - \int_t^T \omega e^{-\omega (s - t)} \lambda a(s) \, ds
    \approx \lambda \omega v - \lambda \omega^2 e^{-\omega R / 2} (r + \omega v R^2 / 10)

by parts, with the velocity's first moment about the middle of ``R`` that of a quintic. It needs
no more of the swing than where the foot is and how fast, so a change of foothold or time makes no jump in it.

References:
    Popovic, Goswami, Herr: Ground reference points in legged locomotion, IJRR 2005 (CMP).
"""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.types import Vector


def leg_lever(model: RobotModel) -> float:
    """``lambda``: moment on the CoM per acceleration of a foot, over the weight, in the 'stand' posture [s^2].

    The mean of both feet and both horizontal directions, which differ by a tenth.
    """
    data, q = model.data(), model.standing_configuration()
    pin.computeCentroidalMap(model.pin, data, q)
    pin.computeJointJacobians(model.pin, data, q)
    pin.updateFramePlacements(model.pin, data)
    levers = []
    for foot in model.feet:
        joints = np.array(foot.joint_ids_v)
        jacobian = pin.getFrameJacobian(model.pin, data, foot.frame_id, pin.LOCAL_WORLD_ALIGNED)
        momentum = data.Ag[3:, joints] @ np.linalg.inv(jacobian[:, joints])  # (3, 6)
        levers += [-momentum[1, 0], momentum[0, 1]]
    return float(np.mean(levers)) / (model.mass * GRAVITY)


class SwingReaction:
    """What the DCM must allow for of the swing leg.

    Args:
        lever: ``lambda`` [s^2].
        share: Share of the reaction that is planned; the rest is left to the CoP under the stance sole [-].
    """

    def __init__(self, lever: float, share: float) -> None:
        self._lever = lever
        self._planned = lever * share

    def cmp_offset(self, acceleration: Vector) -> Vector:
        """CMP minus CoP while the foot accelerates so (2,) [m/s^2]; (2,) [m]."""
        return -self._lever * acceleration

    def zmp(self, acceleration: Vector) -> Vector:
        """Planned ZMP relative to the stance foot's point while the swing foot accelerates so; (2,) [m]."""
        return -self._planned * acceleration

    def whole_swing(self, omega: float, duration: float) -> float:
        """``d`` at lift-off, per metre of the swing's way [-]."""
        return -self._planned * omega * omega * math.exp(-0.5 * omega * duration)

    def rest(self, omega: float, left: float, way: Vector, velocity: Vector) -> Vector:
        """``d``: DCM that the rest of the swing will use up (2,) [m].

        Args:
            omega: [1/s].
            left: Time to touchdown [s].
            way: From the foot to where it is to land (2,) [m].
            velocity: Of the foot (2,) [m/s].
        """
        left = max(left, 0.0)
        late = 0.1 * omega * left * left * velocity  # of a quintic that starts with this velocity
        return self._planned * omega * velocity + self.whole_swing(omega, left) * (way + late)
