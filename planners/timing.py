"""When a motion is where: minimum-jerk blends from rest to rest, slowed to the joints' abilities."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from models.types import Matrix, Vector

_PEAK_VELOCITY = 1.875
"""Peak of ds/du for s = 10 u^3 - 15 u^4 + 6 u^5."""
_PEAK_ACCELERATION = 10.0 / math.sqrt(3.0)
"""Peak of d2s/du2 for the same."""


@dataclass(frozen=True, slots=True)
class JointCurve:
    """Sampled joint motion.

    Attributes:
        times: (n,) [s].
        q, v, a: Positions, velocities, accelerations (n, nj) [rad, rad/s, rad/s^2].
    """

    times: Vector
    q: Matrix
    v: Matrix
    a: Matrix


def blend_time(change: Vector, v_max: Vector, a_max: float) -> float:
    """Shortest minimum-jerk blend that respects velocity and acceleration limits.

    T = max_j max(1.875 |dq_j| / v_j, sqrt(5.774 |dq_j| / a))

    Args:
        change: Joint displacement (nj,) [rad].
        v_max: Velocity limits (nj,) [rad/s].
        a_max: Acceleration limit [rad/s^2].

    Returns:
        Duration [s].
    """
    distance = np.abs(change)
    by_velocity = float((_PEAK_VELOCITY * distance / v_max).max())
    return max(by_velocity, math.sqrt(_PEAK_ACCELERATION * float(distance.max()) / a_max))


def smooth_curve(q: Matrix, rate: float, v_max: Vector, a_max: float) -> tuple[JointCurve, float]:
    """Twice continuously differentiable curve through equally spaced points, at rest at both ends.

    When it would exceed a limit (the legs of a blend do not move by minimum jerk themselves), the whole curve is
    slowed by one factor, which leaves its path as it is.

    Args:
        q: Points (n, nj) [rad].
        rate: Points per second [Hz].
        v_max: Velocity limits (nj,) [rad/s].
        a_max: Acceleration limit [rad/s^2].

    Returns:
        The curve, and the factor by which it was slowed (1 when it was not).
    """
    times = np.arange(len(q)) / rate
    spline = CubicSpline(times, q, bc_type="clamped")
    v, a = spline(times, 1), spline(times, 2)
    v[0] = v[-1] = 0.0
    slower = max(1.0, float((np.abs(v) / v_max).max()), math.sqrt(float(np.abs(a).max()) / a_max))
    return JointCurve(times * slower, q, v / slower, a / slower**2), slower
