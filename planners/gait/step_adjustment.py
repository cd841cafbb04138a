"""Step adjustment: where and when to put the next foot, given where the DCM is now."""

from __future__ import annotations

import math
from dataclasses import dataclass

import daqp
import numpy as np

from models.types import Vector
from planners.gait.config import AdjustmentConfig


@dataclass(frozen=True, slots=True)
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
        self._config = config
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
        """
        config = self._config
        lower, upper = self._bounds(omega, bounds, elapsed, planned_time)
        ahead = math.exp(omega * max(planned_time - elapsed, 0.0)) - 1.0
        decay = math.exp(-omega * elapsed)
        wanted = math.exp(omega * nominal.time)
        hessian, gradient = self._hessian, self._gradient
        hessian[:] = 0.0
        gradient[:] = 0.0
        for i in range(2):
            # b_i - coupling (u_i - nominal u_i) - nominal b_i = row . (u_i, tau, delta_i) - goal
            index = (i, 2, 3 + i)
            row = (-1.0 - coupling, decay * dcm[i], -ahead)
            goal = nominal.offset[i] - coupling * nominal.step[i]
            for a in range(3):
                gradient[index[a]] -= config.offset * row[a] * goal
                for b in range(3):
                    hessian[index[a], index[b]] += config.offset * row[a] * row[b]
            hessian[i, i] += config.position
            gradient[i] -= config.position * nominal.step[i]
            hessian[3 + i, 3 + i] += config.cop
        hessian[2, 2] += config.time
        gradient[2] -= config.time * wanted
        z, _, flag, _ = daqp.solve(hessian, gradient, self._rows, upper, lower, self._sense)
        solved = flag == 1 and bool(np.isfinite(z).all())
        if not solved:
            z = np.clip(np.array([*nominal.step, wanted, 0.0, 0.0]), lower[:5], upper[:5])
        offset = decay * z[2] * dcm - ahead * z[3:] - z[:2]
        return Step(z[:2].copy(), math.log(z[2]) / omega, offset, z[3:].copy(), solved)

    def _bounds(self, omega: float, bounds: StepBounds, elapsed: float, planned: float) -> tuple[Vector, Vector]:
        """Bounds of the unknowns (5,) and of the rows for the swing foot's speed (4,), which are set here too."""
        lower, upper = np.empty(9), np.full(9, np.inf)
        lower[:2], lower[2], lower[3:5] = bounds.step_lower, math.exp(omega * bounds.time_lower), -bounds.cop
        upper[:2], upper[2], upper[3:5] = bounds.step_upper, math.exp(omega * bounds.time_upper), bounds.cop
        lower[5:] = -np.inf
        self._rows[:, 2] = 0.0
        if bounds.place is not None:
            # T = planned + (tau - tau_0) / (omega tau_0)
            at = min(max(planned, bounds.time_lower), bounds.time_upper)
            self._rows[:, 2] = -bounds.speed / (omega * math.exp(omega * at))
            way = bounds.speed * (at - elapsed - 1.0 / omega)
            for i in range(2):
                upper[5 + 2 * i], upper[6 + 2 * i] = way + bounds.place[i], way - bounds.place[i]
        return lower, upper
