"""Step adjustment: where and when to put the next foot, given where the DCM is now."""

from __future__ import annotations

import math
from dataclasses import dataclass

import daqp
import numpy as np

from models.compiled import njit
from models.types import Matrix, Vector
from planners.gait.config import AdjustmentConfig


@dataclass(slots=True)
class StepBounds:
    """What the step may be, in the stance frame.

    Attributes:
        step_lower: Foothold (2,) [m].
        step_upper: Foothold (2,) [m].
        time_lower: Time from the start of the single support to touchdown [s].
        time_upper: Time from the start of the single support to touchdown [s].
        cop: Largest CoP offset to either side (2,) [m].
        place: Where the swing foot is now (2,) [m]; None to leave its speed out.
        speed: Largest mean speed of the swing foot along each axis until touchdown [m/s].
    """

    step_lower: Vector
    step_upper: Vector
    time_lower: float
    time_upper: float
    cop: Vector
    place: Vector | None = None
    speed: float = 0.0


@dataclass(frozen=True, slots=True)
class Step:
    """The adjusted step.

    Attributes:
        step: Foothold in the stance frame (2,) [m].
        time: From the start of the single support to touchdown [s].
        offset: DCM offset from the foothold at touchdown (2,) [m].
        cop: CoP offset that is counted on for the rest of the step (2,) [m].
        solved: Whether the QP was solved; otherwise this is the nominal step inside the bounds.
    """

    step: Vector
    time: float
    offset: Vector
    cop: Vector
    solved: bool


class StepAdjustment:
    r"""Small QP over foothold, touchdown time, DCM offset and CoP offset.

    With the stance ZMP at the origin, DCM :math:`\xi` at time t of the single support, and
    :math:`\tau = e^{\omega T}`, the DCM at touchdown is affine in all of them:

    .. math::
        u + b = e^{-\omega t} \xi\, \tau - (e^{\omega (\bar T - t)} - 1)\, \delta

    so that, with b eliminated,

    .. math::
        \min_{u, \tau, \delta} w_u |u - \bar u|^2 + w_\tau (\tau - \bar \tau)^2 + w_b |b - \bar b|^2 + w_p |\delta|^2
        \quad \text{s.t. bounds on } u, \tau, \delta, \quad |u - u_{now}| \le v_{max} (T - t)

    The offset ``b`` is soft: it is the distance from a walk that can go on for ever. The product of ``delta`` and
    ``tau`` is linearised at the last time, and so is the logarithm in T of the way that the foot can still go: a foot
    that is to land farther may do so later. Units: the foothold is a ZMP point; the caller adds the sole's shape.

    Args:
        config: Weights.

    References:
        Khadiv, Herzog, Moosavian, Righetti: Walking control based on step timing adaptation, T-RO 2020, eq. 14-21.
    """

    def __init__(self, config: AdjustmentConfig) -> None:
        self._going_on = np.array([config.position, config.time, config.offset, config.cop])
        self._ending = np.array([config.position, config.time_ending, config.offset, config.cop])
        self._nowhere = np.zeros(2)
        self._lower, self._upper = np.zeros(9), np.zeros(9)
        self._hessian = np.zeros((5, 5))
        self._gradient = np.zeros(5)
        self._rows = np.zeros((4, 5))
        for i in range(2):
            self._rows[2 * i, i], self._rows[2 * i + 1, i] = 1.0, -1.0
        self._sense = np.zeros(9, dtype=np.int32)

    def solve(
        self,
        dcm: Vector,
        elapsed: float,
        omega: float,
        nominal: Step,
        planned_time: float,
        bounds: StepBounds,
        coupling: float = 0.0,
        *,
        ending: bool = False,
    ) -> Step:
        """Adjust the step.

        Args:
            dcm: Measured DCM relative to the stance ZMP point, in the stance frame (2,) [m].
            elapsed: Time since the start of the single support [s].
            omega: [1/s].
            nominal: The step that the command asks for.
            planned_time: Touchdown time of the last adjustment [s].
            bounds: Limits.
            coupling: Change of the wanted offset per change of the foothold [-].
            ending: Whether the walk comes to an end.
        """
        hessian, gradient, rows = self._hessian, self._gradient, self._rows
        lower, upper = self._lower, self._upper
        decay, ahead, wanted = _objective(
            dcm,
            elapsed,
            omega,
            nominal.step,
            nominal.time,
            nominal.offset,
            planned_time,
            coupling,
            self._ending if ending else self._going_on,
            hessian,
            gradient,
        )
        _constraints(
            omega,
            elapsed,
            planned_time,
            bounds.step_lower,
            bounds.step_upper,
            bounds.time_lower,
            bounds.time_upper,
            bounds.cop,
            self._nowhere if bounds.place is None else bounds.place,
            math.inf if bounds.place is None else bounds.speed,
            rows,
            lower,
            upper,
        )
        z, _, flag, _ = daqp.solve(hessian, gradient, rows, upper, lower, self._sense)
        solved = flag == 1 and math.isfinite(sum(z.tolist()))
        if not solved:
            z = np.clip(np.array([*nominal.step, wanted, 0.0, 0.0]), lower[:5], upper[:5])
        offset = np.array(_offset(z, dcm, decay, ahead))
        return Step(z[:2], math.log(z[2]) / omega, offset, z[3:], solved)


@njit("UniTuple(float64, 2)(float64[::1], float64[::1], float64, float64)", cache=True)
def _offset(z: Vector, dcm: Vector, decay: float, ahead: float) -> tuple[float, float]:
    """``b`` of a solution (5,)."""
    return decay * z[2] * dcm[0] - ahead * z[3] - z[0], decay * z[2] * dcm[1] - ahead * z[4] - z[1]


@njit(
    "UniTuple(float64, 3)(float64[::1], float64, float64, float64[::1], float64, float64[::1], float64, float64,"
    " float64[::1], float64[:, ::1], float64[::1])",
    cache=True,
)
def _objective(
    dcm: Vector,
    elapsed: float,
    omega: float,
    step: Vector,
    time: float,
    offset: Vector,
    planned: float,
    coupling: float,
    weights: Vector,
    hessian: Matrix,
    gradient: Vector,
) -> tuple[float, float, float]:
    r"""Hessian (5, 5) and gradient (5,) of the objective in :math:`(u, \tau, \delta)`.

    ``step``, ``time`` and ``offset`` are the nominal ones, ``weights`` those of foothold, time, offset and CoP (4,).

    Returns:
        :math:`e^{-\omega t}`, :math:`e^{\omega (\bar T - t)} - 1` and :math:`\bar \tau`.
    """
    ahead = math.exp(omega * max(planned - elapsed, 0.0)) - 1.0
    decay = math.exp(-omega * elapsed)
    wanted = math.exp(omega * time)
    hessian[:] = 0.0
    gradient[:] = 0.0
    for i in range(2):
        # b_i - coupling (u_i - nominal u_i) - nominal b_i = row . (u_i, tau, delta_i) - goal
        index = (i, 2, 3 + i)
        row = (-1.0 - coupling, decay * dcm[i], -ahead)
        goal = offset[i] - coupling * step[i]
        for a in range(3):
            gradient[index[a]] -= weights[2] * row[a] * goal
            for b in range(3):
                hessian[index[a], index[b]] += weights[2] * row[a] * row[b]
        hessian[i, i] += weights[0]
        gradient[i] -= weights[0] * step[i]
        hessian[3 + i, 3 + i] += weights[3]
    hessian[2, 2] += weights[1]
    gradient[2] -= weights[1] * wanted
    return decay, ahead, wanted


@njit(
    "void(float64, float64, float64, float64[::1], float64[::1], float64, float64, float64[::1], float64[::1],"
    " float64, float64[:, ::1], float64[::1], float64[::1])",
    cache=True,
)
def _constraints(
    omega: float,
    elapsed: float,
    planned: float,
    step_lower: Vector,
    step_upper: Vector,
    time_lower: float,
    time_upper: float,
    cop: Vector,
    place: Vector,
    speed: float,
    rows: Matrix,
    lower: Vector,
    upper: Vector,
) -> None:
    """Bounds of the unknowns (5,), below them those of the rows for the swing foot's speed (4,), and these rows (4, 5).

    The other arguments are those of ``StepBounds``; an infinite speed leaves the rows without bounds.
    """
    lower[2], upper[2] = math.exp(omega * time_lower), math.exp(omega * time_upper)
    for i in range(2):
        lower[i], upper[i] = step_lower[i], step_upper[i]
        lower[3 + i], upper[3 + i] = -cop[i], cop[i]
    lower[5:], upper[5:] = -np.inf, np.inf
    rows[:, 2] = 0.0
    if speed < np.inf:
        # T = planned + (tau - tau_0) / (omega tau_0)
        at = min(max(planned, time_lower), time_upper)
        rows[:, 2] = -speed / (omega * math.exp(omega * at))
        way = speed * (at - elapsed - 1.0 / omega)
        for i in range(2):
            upper[5 + 2 * i], upper[6 + 2 * i] = way + place[i], way - place[i]
