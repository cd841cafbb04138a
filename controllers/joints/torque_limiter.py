"""Last guard between a law and the motors: torque, joint range, speed and torque-rate limits."""

from typing import NamedTuple

import numpy as np

from models.numerics.compiled import njit
from models.robot_model import RobotModel
from models.types import Matrix, Vector


class TorqueLimits(NamedTuple):
    """Bounds of ``TorqueLimiter``, and its output."""

    centre: Matrix  # of the box of q and v inside which no torque needs to fade (2, nj)
    inverse_half: Matrix  # inverse half width of that box (2, nj)
    most: Vector  # (nj,) [N.m]
    rate: Vector  # (nj,) [N.m/s]
    tau: Vector  # (nj,) [N.m]


class TorqueLimiter:
    """Limits desired torques to what motors and joints bear; the kernels below need ``fade`` near the limits only.

    In this order, tau (nj,) [N.m] is

    - limited to tau_max; torque towards a joint limit fades out over the last ``position_margin`` before it, torque
      that speeds a joint up further fades out over ``velocity_margin`` beyond its velocity limit;
    - zero at a joint whose measurement, or whose desired torque, is not finite;
    - limited to a change of tau_rate_max dt since the last call.

    Margins are in [rad] and as a share of the velocity limit; ``sensor_faults`` counts calls with a value that was not
    finite.
    """

    def __init__(self, model: RobotModel, position_margin: float, velocity_margin: float) -> None:
        nj = model.nj
        self.tau = np.zeros(nj)
        self.sensor_faults = 0
        self._tau_max = np.array(model.tau_max)
        half = np.maximum(0.5 * (model.q_upper - model.q_lower) - position_margin, np.finfo(np.float64).eps)
        centre = np.array([0.5 * (model.q_upper + model.q_lower), np.zeros(nj)])
        inverse_half = 1.0 / np.array([half, model.v_max])
        self.limits = TorqueLimits(centre, inverse_half, self._tau_max, np.array(model.tau_rate_max), self.tau)
        self._fade_rate = np.array([np.full(nj, 1.0 / position_margin), 1.0 / (velocity_margin * model.v_max)])
        self._fade_high = np.array([model.q_upper, (1.0 + velocity_margin) * model.v_max])
        self._fade_low = np.array([model.q_lower, -(1.0 + velocity_margin) * model.v_max])

    def fade(self, measured: Matrix, target: Vector) -> None:
        """Apply limits that shrink near those of q, v (2, nj) to torques (nj,), which are zero where not measured."""
        up = np.minimum(((self._fade_high - measured) * self._fade_rate).min(axis=0), 1.0)  # (nj,)
        down = np.minimum(((measured - self._fade_low) * self._fade_rate).min(axis=0), 1.0)
        np.minimum(target, np.maximum(up, 0.0) * self._tau_max, out=target)
        np.maximum(target, np.maximum(down, 0.0) * -self._tau_max, out=target)
        blind = ~(np.isfinite(measured).all(axis=0) & np.isfinite(target))  # (nj,)
        if blind.any():
            self.sensor_faults += 1
            target[blind] = 0.0


@njit(cache=True)
def bound_torques(q: Vector, v: Vector, limits: TorqueLimits, target: Vector) -> bool:
    """Limit torques (nj,) where none needs to fade; returns False elsewhere."""
    centre, inverse_half, most = limits.centre, limits.inverse_half, limits.most
    for j in range(target.shape[0]):
        position, speed = (q[j] - centre[0, j]) * inverse_half[0, j], (v[j] - centre[1, j]) * inverse_half[1, j]
        if not (abs(position) <= 1.0 and abs(speed) <= 1.0):  # nor where it is not a number
            return False
    for j in range(target.shape[0]):
        target[j] = np.maximum(np.minimum(target[j], most[j]), -most[j])
    return True


@njit(cache=True)
def approach_torques(target: Vector, dt: float, limits: TorqueLimits) -> None:
    """Move ``tau`` towards the target (nj,), at most at the rate for a time [s]."""
    tau, rate = limits.tau, limits.rate
    for j in range(tau.shape[0]):
        step, change = rate[j] * dt, target[j] - tau[j]
        tau[j] = target[j] if abs(change) <= step else tau[j] + np.maximum(np.minimum(change, step), -step)
