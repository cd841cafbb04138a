r"""DCM reference over footholds: closed forms of the linear inverted pendulum.

Symbols: ``xi = c + c'/omega`` the divergent component of motion, ``p`` the ZMP, ``omega = sqrt(g / z)``. The pendulum
obeys ``xi' = omega (xi - p)``. A step begins at the touchdown of the new stance foot with a double support of duration
``T_d``, in which the ZMP moves at constant speed from the old foot's point to the new one's, then stays there for the
single support ``T_s``; ``T = T_d + T_s``.

References:
    Englsberger, Ott, Albu-Schaeffer: Three-dimensional bipedal walking control based on divergent component of motion
    (2015); Khadiv, Herzog, Moosavian, Righetti: Walking control based on step timing adaptation (2020).
"""

from __future__ import annotations

import math

import numpy as np

from models.compiled import njit
from models.types import Matrix, Vector

NOTHING: Vector = np.zeros(2)
"""No reaction of the swing leg (2,) [m]."""


@njit("float64(float64, float64)", cache=True)
def transfer_share(omega: float, double: float) -> float:
    r"""``alpha = (1 - exp(-omega T_d)) / (omega T_d)``: how much of a ramp of the ZMP counts like a jump at its start.

    .. math:: \xi(T) = p_i + e^{\omega T} (\xi_0 - p_{i-1} - \alpha (p_i - p_{i-1}))
    """
    x = omega * double
    return (1.0 - math.exp(-x)) / x if x > 1e-9 else 1.0


@njit("UniTuple(float64, 2)(float64[:, ::1], float64[:, ::1], float64, float64, float64, float64[::1])", cache=True)
def touchdown_offset(
    points: Matrix, swings: Matrix, omega: float, single: float, double: float, final: Vector
) -> tuple[float, float]:
    r"""DCM offset ``b = xi - p_1`` at the coming touchdown, by backward recursion over the previewed footholds.

    .. math::
        b_i = e^{-\omega T} (b_{i+1} + p_{i+1} - p_i) - (1 - \alpha) (p_i - p_{i-1})
              + e^{-\omega T_d} d_i

    with ``d_i`` what the DCM must allow for the reaction of the leg that swings from p_{i-1} to p_{i+1}
    (``reaction.py``). The recursion contracts by ``exp(omega T)`` a step, so what stands at the end of a preview of
    three or four steps hardly matters; it is the DCM over the last foothold (capturable), or over the middle of the
    stance where the walk ends.

    Args:
        points: ZMP points p_0 (present stance), p_1 (coming touchdown), p_2, ... (1 + steps, 2) [m].
        swings: d_1, d_2, ..., one less than the coming touchdowns (steps - 1, 2) [m].
        omega: [1/s].
        single: Single support T_s [s].
        double: Double support T_d [s].
        final: DCM at the last touchdown (2,) [m].

    Returns:
        b at the touchdown on p_1 [m].
    """
    share = 1.0 - transfer_share(omega, double)
    decay = math.exp(-omega * (single + double))
    fade = math.exp(-omega * double)
    last = points.shape[0] - 1
    x, y = final[0] - points[last, 0], final[1] - points[last, 1]
    for i in range(last - 1, 0, -1):
        before, here, after, swing = points[i - 1], points[i], points[i + 1], swings[i - 1]
        x = decay * (x + after[0] - here[0]) - share * (here[0] - before[0]) + fade * swing[0]
        y = decay * (y + after[1] - here[1]) - share * (here[1] - before[1]) + fade * swing[1]
    return x, y


def single_support(
    point: Vector, end: Vector, omega: float, left: float, rest: Vector = NOTHING, offset: Vector = NOTHING
) -> tuple[Vector, Vector]:
    """DCM and its rate, ``left`` seconds before it is to be at ``end``, with the ZMP on ``point``; all (2,).

    ``rest`` is the DCM that the rest of the swing will use up [m], ``offset`` CMP minus CoP now [m]; see
    ``reaction.py``.
    """
    dcm, rate = np.empty(2), np.empty(2)
    _single_support(point, end, omega, left, rest, offset, dcm, rate)
    return dcm, rate


@njit(
    "void(float64[::1], float64[::1], float64, float64, float64[::1], float64[::1], float64[::1], float64[::1])",
    cache=True,
)
def _single_support(
    point: Vector, end: Vector, omega: float, left: float, rest: Vector, offset: Vector, dcm: Vector, rate: Vector
) -> None:
    """See ``single_support``; the last two are what it returns."""
    decay = math.exp(-omega * left)
    for i in range(2):
        dcm[i] = point[i] + decay * (end[i] - point[i]) + rest[i]
        rate[i] = omega * (dcm[i] - point[i] - offset[i])


def double_support(
    old: Vector, new: Vector, end: Vector, omega: float, elapsed: float, duration: float
) -> tuple[Vector, Vector]:
    """DCM and its rate during the transfer of the ZMP from ``old`` to ``new``.

    Args:
        old: ZMP point of the foot that is to be unloaded (2,) [m].
        new: ZMP point of the new stance foot (2,) [m].
        end: DCM at the end of the double support (2,) [m].
        omega: [1/s].
        elapsed: Time since touchdown [s].
        duration: T_d [s].
    """
    rate = (new - old) / duration
    zmp = old + rate * elapsed
    slope = rate / omega
    dcm = zmp + slope + math.exp(-omega * (duration - elapsed)) * (end - new - slope)
    return dcm, omega * (dcm - zmp)


def blend(
    start: tuple[Vector, Vector], end: tuple[Vector, Vector], elapsed: float, duration: float
) -> tuple[Vector, Vector]:
    """Cubic between two DCM states (position, rate), each (2,): the shift before the first and after the last step."""
    u = min(max(elapsed / duration, 0.0), 1.0)
    h00, h10 = (1.0 + 2.0 * u) * (1.0 - u) ** 2, u * (1.0 - u) ** 2
    h01, h11 = u * u * (3.0 - 2.0 * u), u * u * (u - 1.0)
    dcm = h00 * start[0] + h10 * duration * start[1] + h01 * end[0] + h11 * duration * end[1]
    d00, d10 = 6.0 * u * (u - 1.0), (1.0 - u) * (1.0 - 3.0 * u)
    d11 = u * (3.0 * u - 2.0)
    rate = (d00 * start[0] - d00 * end[0]) / duration + d10 * start[1] + d11 * end[1]
    return dcm, rate
