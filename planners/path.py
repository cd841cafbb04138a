"""The path of a motion in time: minimum-jerk blends slowed to the joints' abilities, and a last check of all bounds."""

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicSpline

from models.errors import UnreachableError
from models.robot_model import RobotModel
from models.types import Matrix, Vector
from planners.collision import SelfCollision
from planners.motion_config import MotionConfig
from planners.stance import Stance, plant
from planners.whole_body_ik import Bounds

_PEAK_VELOCITY = 1.875  #: Peak of ds/du for s = 10 u^3 - 15 u^4 + 6 u^5
_PEAK_ACCELERATION = 10.0 / math.sqrt(3.0)  #: Peak of d2s/du2 for the same
_ROUNDING = 1e-6  #: Slack of the joint limits [rad]
_SLACK = 1e-3  #: Slack of the CoM's margin, which the solver keeps at key poses only [m]


@dataclass(frozen=True, slots=True)
class JointCurve:
    """Sampled joint motion."""

    times: Vector  # (n,) [s]
    q: Matrix  # (n, nj) [rad]
    v: Matrix  # (n, nj) [rad/s]
    a: Matrix  # (n, nj) [rad/s^2]


def blend_time(change: Vector, v_max: Vector, a_max: float) -> float:
    """Shortest minimum-jerk blend of a displacement (nj,) [rad] within velocity and acceleration limits [s].

    T = max_j max(1.875 |dq_j| / v_j, sqrt(5.774 |dq_j| / a))
    """
    distance = np.abs(change)
    by_velocity = float((_PEAK_VELOCITY * distance / v_max).max())
    return max(by_velocity, math.sqrt(_PEAK_ACCELERATION * float(distance.max()) / a_max))


def smooth_curve(q: Matrix, rate: float, v_max: Vector, a_max: float) -> tuple[JointCurve, float]:
    """C2 curve through points (n, nj) at a rate [Hz], at rest at both ends, and the factor by which it was slowed.

    The legs of a blend do not move by minimum jerk, so the curve may exceed a limit. It is then slowed as a whole,
    which leaves its path unchanged.
    """
    times = np.arange(len(q)) / rate
    spline = CubicSpline(times, q, bc_type="clamped")
    v, a = spline(times, 1), spline(times, 2)
    v[0] = v[-1] = 0.0
    slower = max(1.0, float((np.abs(v) / v_max).max()), math.sqrt(float(np.abs(a).max()) / a_max))
    return JointCurve(times * slower, q, v / slower, a / slower**2), slower


def check_path(
    model: RobotModel,
    config: MotionConfig,
    collision: SelfCollision,
    stance: Stance,
    bounds: Bounds,
    curve: JointCurve,
) -> None:
    """Refuse a motion that violates a bound anywhere; uses Pinocchio alone.

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
            allowed = bounds.gaps - config.collision.path_slack
            pair = int((distances - allowed).argmin())
            if distances[pair] < allowed[pair]:
                raise UnreachableError(
                    f"after {time:.2f} s '{' and '.join(collision.names(pair))}' would collide "
                    f"({distances[pair]:.3f} m apart, at least {allowed[pair]:.3f} m)"
                )
