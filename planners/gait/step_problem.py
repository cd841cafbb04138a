r"""Step adjustment: foothold, touchdown time, DCM offset and CoP offset of the present step.

The origin is the stance ZMP, :math:`\xi` is the DCM at time t of the single support, and :math:`\tau = e^{\omega T}`.
The DCM at touchdown is

.. math::
    u + b = e^{\omega (T - t)} \xi - (e^{\omega (T - t)} - 1)\, \delta

With b eliminated, the problem is

.. math::
    \min_{u, \tau, \delta} w_u |u - \bar u|^2 + w_\tau (\tau - \bar \tau)^2 + w_b |b - \bar b|^2 + w_p |\delta|^2
    \quad \text{s.t. bounds on } u, \tau, \delta, \quad -w(T - t, -v) \le u - u_{now} \le w(T - t, v)

The offset ``b`` is a soft constraint: its error is the distance from a walk that can continue indefinitely. w is the
``reachable_distance`` of a foot of velocity v; a farther foothold may be reached later. For a given touchdown time, the
problem is quadratic in two bounded unknowns for each axis and is solved exactly. The time is found by a search.

References:
    Khadiv, Herzog, Moosavian, Righetti: Walking control based on step timing adaptation, T-RO 2020, eq. 14-21.
"""

import math
from typing import NamedTuple

from models.numerics.compiled import njit, register_jitable
from models.types import Matrix, Vector
from planners.gait.config import AdjustmentConfig
from planners.gait.foot_motion import FootLimits, reachable_distance
from planners.gait.footsteps import Point

_TIMES = 41  #: Number of touchdown times in the initial search
_NARROWED = 24  #: Number of reductions of the interval around the best of these times
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)  #: Factor of one reduction [-]
UNSOLVED = 1e6  #: Objective of a problem without a solution [-]


class StepProblem(NamedTuple):
    """One step adjustment in the stance frame; footholds are ZMP points relative to the ZMP point of the stance."""

    dcm: Vector  #: Measured DCM less its shift by the rest of the swing (2,) [m]
    elapsed: float  #: Time since the start of the single support [s]
    omega: float  #: Natural frequency of the pendulum [1/s]
    step: Vector  #: Nominal foothold (2,) [m]
    time: float  #: Nominal touchdown time [s]
    offset: Vector  #: DCM offset from the foothold at the nominal touchdown (2,) [m]
    coupling: float  #: Change of that offset per change of the foothold [-]
    lower: Vector  #: Lower bound of the foothold (2,) [m]
    upper: Vector  #: Upper bound of the foothold (2,) [m]
    soonest: float  #: Least touchdown time [s]
    latest: float  #: Largest touchdown time [s]
    cop: Vector  #: Largest CoP offset to either side (2,) [m]
    kept: bool  #: The last plan is in these bounds: the point in them nearest to the foot's path counts as reachable
    place: Vector  #: Start of the straight path to the foothold: position of the swing foot, or a corner (2,) [m]
    velocities: Matrix  #: Velocity of the swing foot there, largest backward and forward of each axis (2, 2) [m/s]
    leaves: float  #: Time at which the foot leaves ``place``, since the start of the single support [s]
    foot_limits: FootLimits  #: Limits of the swing foot along each axis


class Weights(NamedTuple):
    """Weights of a step adjustment; see ``AdjustmentConfig``."""

    position: float
    time: float
    offset: float
    cop: float


def weights_of(config: AdjustmentConfig) -> tuple[Weights, Weights]:
    """Weights of a walk that continues, and of one that ends."""
    going_on = Weights(config.position, config.time, config.offset, config.cop)
    return going_on, going_on._replace(time=config.time_ending)


@register_jitable
def _within(p: StepProblem, i: int, left: float) -> Point:
    """Bounds of the footholds along an axis that the foot reaches in the time ``left`` [m]; reversed if none."""
    least, largest = p.lower[i], p.upper[i]
    place, back, forth = p.place[i], p.velocities[i, 0], p.velocities[i, 1]
    low = place - reachable_distance(left, -back, p.foot_limits)[0]
    high = place + reachable_distance(left, forth, p.foot_limits)[0]
    if p.kept:
        low = min(low, min(max(place + 0.5 * back * left, least), largest))
        high = max(high, min(max(place + 0.5 * forth * left, least), largest))
    return max(least, low), min(largest, high)


@register_jitable
def _along(p: StepProblem, i: int, time: float, weights: Weights) -> tuple[float, float, float]:
    """Best foothold and CoP offset along an axis for a touchdown time [m], and their part of the objective."""
    low, high = _within(p, i, time - p.leaves)
    if low > high:
        return 0.0, 0.0, math.inf
    growth = math.exp(p.omega * (time - p.elapsed))
    ahead, slope, step = growth - 1.0, 1.0 + p.coupling, p.step[i]
    # Error of the offset: free - slope u - ahead delta
    free = growth * p.dcm[i] - p.offset[i] + p.coupling * step
    cost, foothold, shift = math.inf, low, 0.0
    for bound in range(5):  # no active bound, then each of the four bounds active
        if bound == 0:
            # Stationary: position (u - step) = offset slope e, cop delta = offset ahead e, with e the error
            gain = 1.0 / weights.offset + slope * slope / weights.position + ahead * ahead / weights.cop
            missed = (free - slope * step) / gain
            u, delta = step + slope * missed / weights.position, ahead * missed / weights.cop
            if not (low <= u <= high and abs(delta) <= p.cop[i]):
                continue
        elif bound < 3:
            u = low if bound == 1 else high
            delta = weights.offset * ahead * (free - slope * u) / (weights.cop + weights.offset * ahead * ahead)
            delta = min(max(delta, -p.cop[i]), p.cop[i])
        else:
            delta = p.cop[i] if bound == 3 else -p.cop[i]
            u = weights.position * step + weights.offset * slope * (free - ahead * delta)
            u = min(max(u / (weights.position + weights.offset * slope * slope), low), high)
        error = free - slope * u - ahead * delta
        value = weights.position * (u - step) ** 2 + weights.offset * error * error + weights.cop * delta * delta
        if value < cost:
            cost, foothold, shift = value, u, delta
        if bound == 0:
            break
    return foothold, shift, 0.5 * cost


@register_jitable
def _at(p: StepProblem, time: float, weights: Weights, z: Vector) -> float:
    """Objective of the best step with a touchdown time [s], infinite if there is none; sets ``z`` (5,)."""
    tau = math.exp(p.omega * time)
    cost = 0.5 * weights.time * (tau - math.exp(p.omega * p.time)) ** 2
    z[2] = tau
    for i in range(2):
        z[i], z[3 + i], part = _along(p, i, time, weights)
        cost += part
    return cost


@njit(cache=True)
def best_step(p: StepProblem, weights: Weights, z: Vector) -> float:
    r"""Objective of the best step; fills ``z`` with the step :math:`(u, \tau, \delta)` (5,).

    The best of ``_TIMES`` times between the soonest and the latest one is refined by a golden-section search. If no
    step is in reach, the objective is ``UNSOLVED`` and ``z`` is the nominal step within its bounds.
    """
    best, at, stride = math.inf, p.soonest, (p.latest - p.soonest) / (_TIMES - 1)
    for k in range(_TIMES):
        time = p.soonest + k * stride
        cost = _at(p, time, weights, z)
        if cost < best:
            best, at = cost, time
    if not math.isfinite(best):
        for i in range(2):
            z[i], z[3 + i] = min(max(p.step[i], p.lower[i]), p.upper[i]), 0.0
        z[2] = math.exp(p.omega * min(max(p.time, p.soonest), p.latest))
        return UNSOLVED
    low, high = max(at - stride, p.soonest), min(at + stride, p.latest)
    for _ in range(_NARROWED):
        width = _GOLDEN * (high - low)
        first, last = high - width, low + width
        if _at(p, first, weights, z) <= _at(p, last, weights, z):
            high = last
        else:
            low = first
    middle = 0.5 * (low + high)
    cost = _at(p, middle, weights, z)
    return cost if cost <= best else _at(p, at, weights, z)
