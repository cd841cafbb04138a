r"""Pace: duration, height and stiffness of the steps as functions of speed and disturbances.

The speed determines the pace of an undisturbed walk: slow long steps take little effort, and at high speed quick short
steps stay within reach. A disturbed walk takes quick steps at any speed, because the DCM error grows by
``exp(omega T)`` per step. Both effects are combined in the ``share`` of the fast gait,

.. math:: s = \max\left(S\left(\frac{|v| - s_0}{1 - s_0}\right), u\right)

``|v|`` is the norm of the velocity relative to the velocity of the fast gait, ``s_0`` is ``slow_share`` and ``S`` the
smooth step. ``u`` is the urgency: a smooth step of the DCM error from ``calm`` to ``alarm``, or the share of a sole
without ground under it, where the ankle cannot correct that error. It decays with the time constant ``calm_time``.

The ground bears a tangential force of up to ``mu`` times the normal force. At touchdown the CoM is half a step of
length L and width w away from the feet. A pendulum of height z then needs a friction coefficient of ``|(L, w)| / 2 z``.
On slippery ground the steps are therefore quicker; if the fast gait does not suffice, the robot walks slower:

.. math:: L^2 + w^2 \le (2 z \sigma \mu)^2, \quad L = |v| T(s)

``\sigma`` is the share of the coefficient that may be used, ``friction_share``.
"""

import math
from typing import NamedTuple

from models.numerics.compiled import register_jitable
from models.types import Matrix, Velocity
from planners.gait.config import PaceConfig


class Pace(NamedTuple):
    """Present pace of the steps."""

    single: float  #: Nominal single support [s]
    double: float  #: Double support between two steps [s]
    crouch: float  #: Height of the CoM in standing less its present height [m]
    clearance: float  #: Height of the sole at mid-swing [m]
    share: float  #: Share of the fast gait, from 0 to 1 [-]
    least_effort: float = 0.0  #: Share of the minimum-acceleration path in the swing path; the rest is minimum jerk [-]

    @property
    def period(self) -> float:
        """Nominal time of a step [s]."""
        return self.single + self.double


def pace_at(share: float, config: PaceConfig, urgency: float = 0.0) -> Pace:
    """Pace at the share of the fast gait for a speed and at the urgency of a disturbance [-]."""
    share = max(share, urgency)
    names = ("single", "double", "crouch", "clearance", "least_effort")
    single, double, crouch, clearance, effort = (config.between(share, name) for name in names)
    return Pace(single, double, crouch, clearance, share, effort)


@register_jitable
def with_single(pace: Pace, least: float) -> Pace:
    """Pace with a nominal single support of at least ``least`` [s]."""
    single, double, crouch, clearance, share, effort = pace
    return Pace(max(single, least), double, crouch, clearance, share, effort)


def share_of(velocity: Velocity, config: PaceConfig) -> float:
    """Share of the fast gait for a velocity [-]."""
    forward, left, turn = velocity
    speed = math.hypot(forward / config.forward, left / config.lateral, turn / config.turn)
    return _smooth_step((speed - config.slow_share) / (1.0 - config.slow_share))


def longest_step(friction: float, height: float, width: float, config: PaceConfig) -> float:
    """Longest step within the friction limit, for a coefficient [-], a CoM height and a step width [m]."""
    bearable = 2.0 * height * config.friction_share * friction
    return math.sqrt(max(bearable * bearable - width * width, 0.0))


def share_within(velocity: Velocity, longest: float, config: PaceConfig) -> float:
    """Least share of the fast gait at which the steps of a velocity are at most ``longest`` [m] long."""
    speed, slow, fast = math.hypot(velocity[0], velocity[1]), config.slow.period, config.fast.period
    return min(max((slow - longest / max(speed, 1e-6)) / max(slow - fast, 1e-6), 0.0), 1.0)


def velocity_within(velocity: Velocity, longest: float, config: PaceConfig) -> Velocity:
    """Velocity, reduced so that its steps are at most ``longest`` [m] long in the fast gait."""
    way = math.hypot(velocity[0], velocity[1]) * config.fast.period
    if way <= longest:
        return velocity
    forward, left, turn = (longest / way * part for part in velocity)
    return forward, left, turn


def urgency_after(urgency: float, error: float, dt: float, config: PaceConfig) -> float:
    """Urgency [-] after one tick of ``dt`` [s], at a DCM error [m]."""
    present = _smooth_step((error - config.calm) / (config.alarm - config.calm))
    return max(present, urgency - urgency * min(dt / config.calm_time, 1.0))


def lost_share(areas: Matrix, half: Matrix) -> float:
    """Largest share of a sole that does not bear, from the bearing areas (2, 4) and the half sizes (2, 2) [m].

    For a sole without half width, which rolls anyway, only the length is used.
    """
    bearing = (
        (high_x - low_x) / (2.0 * length) * ((high_y - low_y) / (2.0 * width) if width > 0.0 else 1.0)
        for (low_x, high_x, low_y, high_y), (length, width) in zip(areas.tolist(), half.tolist(), strict=True)
    )
    return max(1.0 - float(min(bearing)), 0.0)


def _smooth_step(u: float) -> float:
    u = min(max(u, 0.0), 1.0)
    return u * u * (3.0 - 2.0 * u)
