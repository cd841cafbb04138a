"""Smooth curves through points: velocities and accelerations at the points, and quintics between them."""

import math

import numpy as np
from numpy.typing import NDArray

from models.numerics.compiled import njit, register_jitable
from models.types import Matrix, Vector

_PEAK_VELOCITY = 1.875  #: Peak of ds/du of the minimum-jerk blend
_PEAK_ACCELERATION = 10.0 / math.sqrt(3.0)  #: Peak of d2s/du2 of the minimum-jerk blend


@register_jitable
def min_jerk(u: float) -> tuple[float, float, float]:
    """Minimum-jerk blend s = 10 u^3 - 15 u^4 + 6 u^5 for u in [0, 1], ds/du and d2s/du2; both are zero at both ends.

    Source: T. Flash, N. Hogan, "The coordination of arm movements", J. Neuroscience 1985, eq. (7).
    """
    left = 1.0 - u
    return (
        u * u * u * (10.0 + u * (6.0 * u - 15.0)),
        30.0 * u * u * left * left,
        60.0 * u * left * (left - u),
    )


def blend_time(change: Vector, v_max: Vector, a_max: float) -> float:
    """Minimum duration of a minimum-jerk blend: T = max_j max(1.875 |dq_j| / v_j, sqrt(5.774 |dq_j| / a)) [s]."""
    distance = np.abs(change)
    by_velocity = float((_PEAK_VELOCITY * distance / v_max).max())
    return max(by_velocity, math.sqrt(_PEAK_ACCELERATION * float(distance.max()) / a_max))


@register_jitable
def quintic_step(
    position: float, velocity: float, acceleration: float, end: tuple[float, float, float], left: float, dt: float
) -> tuple[float, float, float]:
    """Position, velocity, acceleration after ``dt`` [s] on the quintic that reaches ``end`` in ``left`` >= dt [s]."""
    h = left
    dp = end[0] - position - velocity * h - 0.5 * acceleration * h * h
    dv = end[1] - velocity - acceleration * h
    da = end[2] - acceleration
    c3 = (10.0 * dp - 4.0 * dv * h + 0.5 * da * h * h) / h**3
    c4 = (-15.0 * dp + 7.0 * dv * h - da * h * h) / h**4
    c5 = (6.0 * dp - 3.0 * dv * h + 0.5 * da * h * h) / h**5
    t = dt
    return (
        position + t * (velocity + t * (0.5 * acceleration + t * (c3 + t * (c4 + t * c5)))),
        velocity + t * (acceleration + t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5))),
        acceleration + t * (6.0 * c3 + t * (12.0 * c4 + t * 20.0 * c5)),
    )


#: Coefficients of a quintic to rest at zero per unit of initial position, velocity and acceleration (6, 3)
_TO_REST = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 0.5], [-10, -6, -1.5], [15, 8, 1.5], [-6, -3, -0.5]])


def fade_out(start: Matrix, t: float, time: float) -> Matrix:
    """Position, velocity, acceleration (3, n) at t [s] of quintics from ``start`` to rest at zero in ``time`` [s]."""
    u, scale = t / time, np.array([1.0, time, time * time])
    powers = np.array(
        [
            [1.0, u, u**2, u**3, u**4, u**5],
            [0.0, 1.0, 2.0 * u, 3.0 * u**2, 4.0 * u**3, 5.0 * u**4],
            [0.0, 0.0, 2.0, 6.0 * u, 12.0 * u**2, 20.0 * u**3],
        ]
    )
    faded: Matrix = (powers / scale[:, None]) @ _TO_REST @ (scale[:, None] * start)
    return faded


def monotone_velocities(times: Vector, q: Matrix) -> Matrix:
    """Velocities (n, k) [rad/s] of a cubic without overshoot through the points ``q`` (n, k) [rad] at times (n,) [s].

    v_i = 0 if the slopes d on both sides differ in sign, else their weighted harmonic mean
    (w1 + w2) / (w1 / d_left + w2 / d_right), w1 = 2 T_right + T_left, w2 = T_right + 2 T_left; zero at both ends.

    Source: F. Fritsch, J. Butland, "A method for constructing local monotone piecewise cubic interpolants", 1984.
    """
    v = np.zeros_like(q)
    if len(times) < 3:
        return v
    lengths = np.diff(times)[:, None]  # (n - 1, 1)
    slopes = np.diff(q, axis=0) / lengths  # (n - 1, k)
    left, right = slopes[:-1], slopes[1:]
    w1 = 2.0 * lengths[1:] + lengths[:-1]
    w2 = lengths[1:] + 2.0 * lengths[:-1]
    same = left * right > 0.0
    denominator = w1 * np.where(same, right, 1.0) + w2 * np.where(same, left, 1.0)
    v[1:-1] = np.where(same, (w1 + w2) * left * right / denominator, 0.0)
    return v


def knot_accelerations(times: Vector, q: Matrix, v: Matrix) -> Matrix:
    """Smaller acceleration of the two adjacent cubics at each knot (n, k); 0 at the ends and if the signs differ."""
    a = np.zeros_like(q)
    lengths = np.diff(times)[:, None]  # (n - 1, 1)
    rise = 6.0 * np.diff(q, axis=0)  # (n - 1, k)
    at_start = (rise - lengths * (4.0 * v[:-1] + 2.0 * v[1:])) / lengths**2
    at_end = (-rise + lengths * (2.0 * v[:-1] + 4.0 * v[1:])) / lengths**2
    before, after = at_end[:-1], at_start[1:]  # (n - 2, k), of the inner points
    smaller = np.where(np.abs(before) < np.abs(after), before, after)
    a[1:-1] = np.where(before * after > 0.0, smaller, 0.0)
    return a


def quintic_coefficients(times: Vector, q: Matrix, v: Matrix) -> np.ndarray[tuple[int, int, int], np.dtype[np.float64]]:
    """Quintics c (n - 1, 6, k) with q = sum_j c_j u^j on each segment, accelerations from ``knot_accelerations``."""
    lengths = np.diff(times)[:, None]  # (n - 1, 1)
    a = knot_accelerations(times, q, v)
    rise = np.diff(q, axis=0)
    v0, v1 = v[:-1] * lengths, v[1:] * lengths
    a0, a1 = a[:-1] * lengths**2, a[1:] * lengths**2
    c = np.empty((len(times) - 1, 6, q.shape[1]))
    c[:, 0] = q[:-1]
    c[:, 1] = v0
    c[:, 2] = 0.5 * a0
    c[:, 3] = 10.0 * rise - 6.0 * v0 - 4.0 * v1 - 1.5 * a0 + 0.5 * a1
    c[:, 4] = -15.0 * rise + 8.0 * v0 + 7.0 * v1 + 1.5 * a0 - a1
    c[:, 5] = 6.0 * rise - 3.0 * (v0 + v1) - 0.5 * (a0 - a1)
    return c


@njit(cache=True)
def evaluate_quintic(
    coefficients: NDArray[np.float64], segment: int, u: float, length: float, curve: NDArray[np.float64]
) -> None:
    """Write position, velocity and acceleration at u in [0, 1] of a segment of ``length`` [s] to ``curve`` (3, k)."""
    c = coefficients[segment]
    for j in range(c.shape[1]):
        c1, c2, c3, c4, c5 = c[1, j], c[2, j], c[3, j], c[4, j], c[5, j]
        curve[0, j] = c[0, j] + u * (c1 + u * (c2 + u * (c3 + u * (c4 + u * c5))))
        curve[1, j] = (c1 + u * (2.0 * c2 + u * (3.0 * c3 + u * (4.0 * c4 + u * 5.0 * c5)))) / length
        curve[2, j] = (2.0 * c2 + u * (6.0 * c3 + u * (12.0 * c4 + u * 20.0 * c5))) / (length * length)


# Compile on import, not when a motion starts on a standing robot
evaluate_quintic(np.zeros((1, 6, 1)), 0, 0.0, 1.0, np.zeros((3, 1)))
