"""Last check of a planned motion, with Pinocchio alone: everything that the inverse kinematics promised."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from models.errors import UnreachableError
from models.robot_model import RobotModel
from planners.collision import SelfCollision
from planners.motion_config import MotionConfig
from planners.stance import Stance, plant
from planners.timing import JointCurve
from planners.whole_body_ik import Bounds

_ROUNDING = 1e-6
"""Slack of the joint limits [rad]."""
_SLACK = 1e-3
"""Slack of the CoM's margin, which the solver keeps at key poses only [m]."""


def check_path(
    model: RobotModel,
    config: MotionConfig,
    collision: SelfCollision,
    stance: Stance,
    bounds: Bounds,
    curve: JointCurve,
) -> None:
    """Refuse a motion that violates a bound anywhere.

    Args:
        model: The robot.
        config: Tolerances.
        collision: The robot's self-collision pairs.
        stance: Where the motion starts.
        bounds: What has to be respected.
        curve: The motion.

    Raises:
        UnreachableError: A joint leaves its limits, a sole moves against the other, the CoM leaves the shrunken support
            polygon, or bodies come too close; the message names the joint, sole or bodies and the time.
    """
    names = model.joint_names
    outside = np.maximum(bounds.lower - curve.q, curve.q - bounds.upper)  # (n, nj)
    if outside.max() > _ROUNDING:
        i, k = divmod(int(outside.argmax()), len(names))
        raise UnreachableError(
            f"after {curve.times[i]:.2f} s joint '{names[k]}' would be at {curve.q[i, k]:.4g} rad, outside "
            f"[{bounds.lower[k]:.4g}, {bounds.upper[k]:.4g}]"
        )
    data = model.data()
    between = stance.soles[0].actInv(stance.soles[1])
    every = max(1, round(config.sample_rate / config.collision.check_rate))
    for i, (time, joints) in enumerate(zip(curve.times, curve.q, strict=True)):
        q, soles = plant(model, data, joints)
        change = between.actInv(soles[0].actInv(soles[1]))
        slip, turn = float(np.linalg.norm(change.translation)), float(np.linalg.norm(pin.log3(change.rotation)))
        if slip > config.balance.sole_drift or turn > config.balance.sole_turn:
            raise UnreachableError(
                f"after {time:.2f} s the soles would move against each other by {slip:.4f} m and {turn:.4f} rad: no "
                "leg posture within the joint limits keeps both planted"
            )
        margin = stance.margin(np.array(pin.centerOfMass(model.pin, data, q)))
        if margin < bounds.com_margin - _SLACK:
            raise UnreachableError(
                f"after {time:.2f} s the CoM would be {margin:.3f} m inside the support polygon, at least "
                f"{bounds.com_margin:.3f} m"
            )
        if collision.count and (i % every == 0 or i == len(curve.times) - 1):
            distances = collision.distances(q, config.collision.margin)
            wanted = bounds.gaps - config.collision.path_slack
            pair = int((distances - wanted).argmin())
            if distances[pair] < wanted[pair]:
                raise UnreachableError(
                    f"after {time:.2f} s '{' and '.join(collision.names(pair))}' would collide "
                    f"({distances[pair]:.3f} m apart, at least {wanted[pair]:.3f} m)"
                )
