"""Both feet on the floor: how the weight moves between them."""

from __future__ import annotations

import numpy as np

from planners.gait.config import GaitConfig
from planners.gait.current_step import CurrentStep
from planners.gait.dcm_reference import DcmReference
from planners.gait.phase import GaitPhase
from planners.gait.soles import Soles


class WeightShift:
    """Leads the DCM to where the next step needs it, or to the middle, and shares the weight out.

    Args:
        config: The gait.
        soles: Where they are planted.
        dcm: Reference that is led.
        step: The step before and after.
    """

    def __init__(self, config: GaitConfig, soles: Soles, dcm: DcmReference, step: CurrentStep) -> None:
        self._config, self._soles, self._dcm, self._step = config, soles, dcm, step

    def to_middle(self, elapsed: float) -> bool:
        """One tick on the way to stand on both feet, so long after the last step [s]; returns whether it is there."""
        duration = self._config.timing.finish
        self._dcm.blend(self._soles.middle(), np.zeros(2), elapsed, duration)
        return elapsed >= duration

    def to_first(self, stance: int, elapsed: float, omega: float) -> bool:
        """One tick from standing to the first stance foot.

        Args:
            stance: The foot.
            elapsed: Time since the robot stood [s].
            omega: Of the pendulum [1/s].

        Returns:
            Whether it is there, so that the other foot can lift.
        """
        duration = self._config.timing.start
        end = self._step.plan_from(stance, omega).start_of_single()
        self._dcm.blend(end, omega * (end - self._soles.point(stance)), elapsed, duration)
        return elapsed >= duration

    def to_next(self, stance: int, elapsed: float, omega: float) -> bool:
        """One tick from one foot to the other.

        Args:
            stance: The foot that has landed.
            elapsed: Time since the touchdown was planned [s].
            omega: Of the pendulum [1/s].

        Returns:
            Whether it is there, or the next step has to begin at once.
        """
        duration = self._config.timing.double
        end = self._step.plan_from(stance, omega).start_of_single()
        self._dcm.double(self._soles.point(stance), end, omega, elapsed, duration)
        return elapsed >= duration or self._step.far_off(omega)

    def loads(self, phase: GaitPhase, stance: int, omega: float) -> tuple[float, float]:
        """Share of the weight that each foot is to bear, from where the reference's ZMP lies between them."""
        if phase is GaitPhase.STAND:
            return 1.0, 1.0
        if phase is GaitPhase.SINGLE:
            return (1.0, 0.0) if stance == 0 else (0.0, 1.0)
        if self._step.plan.urgent:
            return 1.0, 1.0  # whatever catches it
        return self._soles.shares(self._dcm.zmp(omega))
