"""Limits of torque, joint position, velocity and torque rate, applied to the output of every law."""

from typing import NamedTuple

import numpy as np

from models.numerics.compiled import njit
from models.robot_model import RobotModel
from models.types import Matrix, Vector


class TorqueLimits(NamedTuple):
    """Constants and output of ``limit_torques``."""

    high: Matrix  # position and velocity at which positive torque is zero (2, nj)
    low: Matrix  # position and velocity at which negative torque is zero (2, nj)
    fade: Matrix  # inverse of the distances before them over which torque fades (2, nj)
    most: Vector  # tau_max (nj,) [N.m]
    rate: Vector  # tau_rate_max (nj,) [N.m/s]
    tau: Vector  # limited torques (nj,) [N.m]


def torque_limits(model: RobotModel, position_margin: float, velocity_margin: float) -> TorqueLimits:
    """Limits of a robot; torque fades over ``position_margin`` [rad] and ``velocity_margin``, share of the limit."""
    nj, fastest = model.nj, (1.0 + velocity_margin) * model.v_max
    high, low = np.array([model.q_upper, fastest]), np.array([model.q_lower, -fastest])
    fade = np.array([np.full(nj, 1.0 / position_margin), 1.0 / (velocity_margin * model.v_max)])
    return TorqueLimits(high, low, fade, np.array(model.tau_max), np.array(model.tau_rate_max), np.zeros(nj))


@njit(cache=True)
def limit_torques(desired: Vector, q: Vector, v: Vector, dt: float, limits: TorqueLimits) -> bool:
    """Limit desired torques (nj,) by the limits of motors and joints; returns whether all values were finite.

    In this order:

    - tau is limited to tau_max. Torque towards a joint limit fades out over the position margin before the limit.
      Accelerating torque fades out over the velocity margin beyond the velocity limit.
    - The target is zero if the measurement or the desired torque is not finite.
    - The change since the last call is limited to tau_rate_max dt.
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
