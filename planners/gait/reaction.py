r"""Reaction of the swing leg: how far the line of the ground force passes from the centre of pressure.

A leg that is accelerated forward takes angular momentum about the CoM, ``L' = -F''`` with

.. math:: F = (\lambda x + \tfrac12 \kappa (x - c)^2 + \zeta z, \; \sigma y) \, m g

``x, y, z`` the place of its foot along the heading, sideways and up, ``c`` that of the CoM (``leg_lever.py``). The
ground force then passes not through the CoM but through the centroidal moment pivot, ``F'' / (m g)`` behind the CoP,
and it is the CMP that drives the DCM. Integrated over what is left of a swing, ``R`` seconds, CoP at the origin,

.. math::
    \xi(T) = e^{\omega R} (\xi(t) - d), \quad
    d = -\int_0^R \omega e^{-\omega s} \ddot F ds
      = \omega (\dot F_0 - e^{-\omega R} \dot F_R) + \omega^2 (F_0 - e^{-\omega R} F_R)
        - \omega^3 \int_0^R e^{-\omega s} F ds

It needs where the foot is and will be, not how it is accelerated, so a change of foothold or time makes no jump in it.

References:
    Popovic, Goswami, Herr: Ground reference points in legged locomotion, IJRR 2005 (CMP).
"""

from __future__ import annotations

import math

import numpy as np

from models.compiled import njit
from models.spline import quintic_step
from models.types import Matrix, Vector
from planners.gait.leg_lever import LegLever
from planners.gait.swing import YAW, SwingFoot, Z

# Gauss-Legendre on [0, 1]
_NODES = np.array([0.0694318442029737, 0.3300094782075719, 0.6699905217924281, 0.9305681557970263])
_WEIGHTS = np.array([0.1739274225687269, 0.3260725774312731, 0.3260725774312731, 0.1739274225687269])


@njit(
    "UniTuple(float64, 2)(float64, float64, float64, float64[::1], float64, float64, float64[::1])",
    cache=True,
)
def _allowance(
    omega: float, left: float, rise: float, foot: Vector, ahead: float, drift: float, lever: Vector
) -> tuple[float, float]:
    """``d`` along the heading and sideways [m].

    Args:
        omega: [1/s].
        left: R [s].
        rise: Time to the apex of the swing; not positive after it [s].
        foot: Position, velocity, acceleration along the heading, sideways, up, then way to go along the heading and
            sideways, heights of apex and landing, velocity at landing (14,).
        ahead: Of the foot, from the CoM along the heading [m].
        drift: Velocity of the CoM along the heading [m/s].
        lever: lambda, kappa, zeta, sigma (4,).
    """
    x, y, z = foot[0:3], foot[3:6], foot[6:9]
    x_end, y_end, top, floor, v_end = foot[9], foot[10], foot[11], foot[12], foot[13]
    rising = 0.0 < rise < left
    middle = rise if rising else 0.0
    integral, side = 0.0, 0.0
    for part in range(2):
        begin, span = (0.0, middle) if part == 0 else (middle, left - middle)
        if span <= 0.0:
            continue
        for i in range(4):
            t = begin + _NODES[i] * span
            weight = _WEIGHTS[i] * span * math.exp(-omega * t)
            px = quintic_step(0.0, x[1], x[2], (x_end, 0.0, 0.0), left, t)[0]
            if part == 0:
                pz = quintic_step(z[0], z[1], z[2], (top, 0.0, 0.0), middle, t)[0]
            elif rising:
                pz = quintic_step(top, 0.0, 0.0, (floor, v_end, 0.0), left - middle, t - middle)[0]
            else:
                pz = quintic_step(z[0], z[1], z[2], (floor, v_end, 0.0), left, t)[0]
            before = ahead + px - drift * t
            integral += weight * (lever[0] * px + 0.5 * lever[1] * before * before + lever[2] * pz)
            side += weight * lever[3] * quintic_step(0.0, y[1], y[2], (y_end, 0.0, 0.0), left, t)[0]
    decay = math.exp(-omega * left)
    last = ahead + x_end - drift * left
    first = 0.5 * lever[1] * ahead * ahead + lever[2] * z[0]
    final = lever[0] * x_end + 0.5 * lever[1] * last * last + lever[2] * floor
    rate = lever[0] * x[1] + lever[1] * ahead * (x[1] - drift) + lever[2] * z[1]
    rate_end = -lever[1] * last * drift + lever[2] * v_end
    along = omega * (rate - decay * rate_end + omega * (first - decay * final - omega * integral))
    return along, omega * lever[3] * y[1] - omega * omega * (decay * lever[3] * y_end + omega * side)


@njit(
    "UniTuple(float64, 2)(float64, float64, float64, UniTuple(float64, 2), float64, float64[::1], float64[::1])",
    cache=True,
)
def whole_swing(
    omega: float, duration: float, period: float, way: tuple[float, float], yaw: float, shape: Vector, lever: Vector
) -> tuple[float, float]:
    """``d`` at the lift-off of a step of a walk that goes on like this; in W [m].

    Args:
        omega: [1/s].
        duration: Of the swing [s].
        period: Of a step [s].
        way: Of the swing foot in W [m].
        yaw: Heading [rad].
        shape: Apex, clearance and landing velocity of the swing (3,).
        lever: lambda, kappa, zeta, sigma (4,).
    """
    c, s = math.cos(yaw), math.sin(yaw)
    foot = np.zeros(14)
    foot[9], foot[10] = c * way[0] + s * way[1], c * way[1] - s * way[0]
    foot[11], foot[12], foot[13] = shape[1], 0.0, -shape[2]
    drift = 0.5 * foot[9] / period
    ahead = 0.5 * (drift * duration - foot[9])  # as far behind at lift-off as ahead at touchdown
    x, y = _allowance(omega, duration, shape[0] * duration, foot, ahead, drift, lever)
    return c * x - s * y, s * x + c * y


@njit(
    "UniTuple(float64, 2)(float64, float64, float64, float64[:, ::1], float64, float64[::1],"
    " UniTuple(float64, 2), float64[::1], float64[::1], float64[::1])",
    cache=True,
)
def _rest(
    omega: float,
    left: float,
    rise: float,
    motion: Matrix,
    floor: float,
    shape: Vector,
    target: tuple[float, float],
    com: Vector,
    com_velocity: Vector,
    lever: Vector,
) -> tuple[float, float]:
    """``d`` of the rest of a swing; in W [m].

    Args:
        omega: [1/s].
        left: Time to touchdown [s].
        rise: Time to the apex of the swing; not positive after it [s].
        motion: Position, velocity and acceleration of the foot: x, y, z, yaw in W (3, 4).
        floor: Height that it lifted from [m].
        shape: Apex, clearance and landing velocity of the swing (3,).
        target: Where it is to land, in W [m].
        com: In W (2,) [m].
        com_velocity: In W (2,) [m/s].
        lever: lambda, kappa, zeta, sigma (4,).
    """
    foot, place = np.zeros(14), motion[0]
    c, s = math.cos(place[YAW]), math.sin(place[YAW])
    for k in range(3):
        x, y = motion[k, 0], motion[k, 1]
        foot[k], foot[3 + k], foot[6 + k] = c * x + s * y, c * y - s * x, motion[k, Z]
    way_x, way_y = target[0] - place[0], target[1] - place[1]
    foot[9], foot[10] = c * way_x + s * way_y, c * way_y - s * way_x
    foot[11], foot[12], foot[13] = floor + shape[1], floor, -shape[2]
    ahead = c * (place[0] - com[0]) + s * (place[1] - com[1])
    drift = c * com_velocity[0] + s * com_velocity[1]
    x, y = _allowance(omega, left, rise, foot, ahead, drift, lever)
    return c * x - s * y, s * x + c * y


@njit("UniTuple(float64, 2)(float64[:, ::1], float64[::1], float64[::1], float64[::1])", cache=True)
def _cmp_offset(motion: Matrix, com: Vector, com_velocity: Vector, lever: Vector) -> tuple[float, float]:
    """CMP minus CoP at one moment of a swing; in W [m]. Arguments as for ``_rest``."""
    place, velocity, acceleration = motion[0], motion[1], motion[2]
    c, s = math.cos(place[YAW]), math.sin(place[YAW])
    ax, ay = acceleration[0], acceleration[1]
    x = c * (place[0] - com[0]) + s * (place[1] - com[1])
    v = c * (velocity[0] - com_velocity[0]) + s * (velocity[1] - com_velocity[1])
    along = (lever[0] + lever[1] * x) * (c * ax + s * ay) + lever[1] * v * v + lever[2] * acceleration[Z]
    across = lever[3] * (c * ay - s * ax)
    return s * across - c * along, -s * along - c * across


@njit("float64(float64, float64, float64[::1])", cache=True)
def slope(omega: float, duration: float, lever: Vector) -> float:
    """Change of ``d`` at lift-off per change of the swing's way [-], about; arguments as for ``whole_swing``."""
    return -float(lever[0]) * omega * omega * math.exp(-0.5 * omega * duration)


class SwingReaction:
    """What the DCM must allow for of the swing leg.

    Args:
        lever: Of the legs.

    Attributes:
        lever: lambda, kappa, zeta, sigma (4,).
        com: Of the robot now, in W (2,) [m]; its owner keeps it up to date.
        com_velocity: In W (2,) [m/s].
    """

    def __init__(self, lever: LegLever) -> None:
        self.lever = np.array([lever.lever, lever.slope, lever.lift, lever.side])
        self.com, self.com_velocity = np.zeros(2), np.zeros(2)

    def cmp_offset(self, swing: SwingFoot) -> Vector:
        """CMP minus CoP at this moment of a swing; in W (2,) [m]."""
        return np.array(_cmp_offset(swing.motion, self.com, self.com_velocity, self.lever))

    def rest(self, omega: float, left: float, swing: SwingFoot, target: tuple[float, float]) -> Vector:
        """``d``: DCM that the rest of the swing will use up; in W (2,) [m].

        Args:
            omega: [1/s].
            left: Time to touchdown [s].
            swing: The swing foot now.
            target: Where it is to land, in W [m].
        """
        left = max(left, swing.freeze)  # the last moments are stretched, see swing.py
        rise = left - (1.0 - swing.apex) * swing.duration
        return np.array(
            _rest(
                omega,
                left,
                rise if rise > swing.freeze else 0.0,
                swing.motion,
                swing.floor,
                swing.shape,
                target,
                self.com,
                self.com_velocity,
                self.lever,
            )
        )
