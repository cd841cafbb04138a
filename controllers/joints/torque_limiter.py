"""Last guard between a law and the motors: torque, joint range, speed and torque-rate limits."""

from typing import NamedTuple

import numpy as np

from models.numerics.compiled import njit
from models.robot_model import RobotModel
from models.types import Matrix, Vector


class TorqueLimits(NamedTuple):
    """Constants and output of ``limit_torques``."""

    high: Matrix  # position and velocity at which no torque acts upwards (2, nj)
    low: Matrix  # likewise downwards (2, nj)
    fade: Matrix  # inverse of the way before them over which torque fades (2, nj)
    most: Vector  # tau_max (nj,) [N.m]
    rate: Vector  # tau_rate_max (nj,) [N.m/s]
    tau: Vector  # limited torques (nj,) [N.m]


def torque_limits(model: RobotModel, position_margin: float, velocity_margin: float) -> TorqueLimits:
    """Limits of a robot; torque fades over the margins in [rad] and as a share of the velocity limit."""
    nj, fastest = model.nj, (1.0 + velocity_margin) * model.v_max
    high, low = np.array([model.q_upper, fastest]), np.array([model.q_lower, -fastest])
    fade = np.array([np.full(nj, 1.0 / position_margin), 1.0 / (velocity_margin * model.v_max)])
    return TorqueLimits(high, low, fade, np.array(model.tau_max), np.array(model.tau_rate_max), np.zeros(nj))


@njit(cache=True)
def limit_torques(desired: Vector, q: Vector, v: Vector, dt: float, limits: TorqueLimits) -> bool:
    """Limit desired torques (nj,) to what motors and joints bear; returns whether all values were finite.

    In this order, tau is

    - limited to tau_max; torque towards a joint limit fades out over the position margin before it, torque that speeds
      a joint up further fades out over the velocity margin beyond its velocity limit;
    - zero at a joint whose measurement, or whose desired torque, is not finite;
    - limited to a change of tau_rate_max dt since the last call.
    """
    high, low, fade, most, rate, tau = limits
    finite = True
    for j in range(tau.shape[0]):
        up = min((high[0, j] - q[j]) * fade[0, j], (high[1, j] - v[j]) * fade[1, j], 1.0)
        down = min((q[j] - low[0, j]) * fade[0, j], (v[j] - low[1, j]) * fade[1, j], 1.0)
        target = np.maximum(np.minimum(desired[j], max(up, 0.0) * most[j]), -max(down, 0.0) * most[j])
        if not (np.isfinite(q[j]) and np.isfinite(v[j]) and np.isfinite(target)):
            target, finite = 0.0, False
        step, change = rate[j] * dt, target - tau[j]
        tau[j] = target if abs(change) <= step else tau[j] + max(min(change, step), -step)
    return finite
