"""Whether the legs could carry the robot one at a time, as a step asks of them."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from models.constants import GRAVITY
from models.proposal.findings import Finding, named
from models.proposal.skeleton import Skeleton
from models.types import Vector

_RESERVE = 0.5
"""Share of a knee's torque limit that standing on one leg may take; a walk bends it further and accelerates."""


def weak_knees(skeleton: Skeleton, legs: tuple[tuple[int, ...], ...], knees: list[int], q: Vector) -> list[Finding]:
    """Knees that one-legged standing already takes more than half of.

    tau = g(q) - J^T f with the weight f = m g on a point of the foot below the CoM, as far as ahead and up go; sideways
    the knee does not care.

    Args:
        skeleton: The joints.
        legs: Joints of the left and the right leg.
        knees: The knee of each.
        q: The standing configuration, base upright (nq,) [m, rad].
    """
    model = skeleton.model
    data = model.createData()
    gravity = pin.computeGeneralizedGravity(model, data, q)
    pin.computeJointJacobians(model, data, q)
    com = pin.centerOfMass(model, data, q)
    weight = GRAVITY * float(pin.computeTotalMass(model))
    weak = {}
    for leg, knee in zip(legs, knees, strict=True):
        jacobian = pin.getJointJacobian(model, data, leg[-1], pin.LOCAL_WORLD_ALIGNED)
        arm = np.array([com[0] - data.oMi[leg[-1]].translation[0], 0.0, 0.0])
        wrench = np.concatenate([[0.0, 0.0, weight], np.cross(arm, [0.0, 0.0, weight])])
        v = int(model.joints[knee].idx_v)
        torque = abs(float(gravity[v] - jacobian[:, v] @ wrench))
        if torque > _RESERVE * model.effortLimit[v]:
            weak[skeleton.name(knee)] = f"{torque:.0f} of {model.effortLimit[v]:g} N.m"
    if not weak:
        return []
    text = f"little torque to walk: standing on one leg takes {', '.join(weak.values())}"
    return [Finding("note", named("joint", weak), text, "kept: it may stand and not walk")]
