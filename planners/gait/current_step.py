"""The step under way: where and when its foot is to land, the foot's way there, and the DCM meanwhile."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.types import Vector
from planners.gait.config import GaitConfig
from planners.gait.dcm_reference import DcmReference
from planners.gait.footsteps import Foothold, clamped
from planners.gait.kernels_steps import wrap
from planners.gait.measurement import GaitMeasurement
from planners.gait.orders import Orders
from planners.gait.plan import StepPlan
from planners.gait.reaction import SwingReaction
from planners.gait.soles import Soles, moved
from planners.gait.swing import SwingFoot


class CurrentStep:
    """One single support, from lift-off to a touchdown that is measured.

    Foothold and touchdown time are adjusted every few ticks from the measured DCM until shortly before the touchdown.

    Args:
        config: The gait.
        measured: CoM, DCM and soles of the last state.
        soles: Where they are planned; the foothold of the swing foot is kept here.
        orders: Velocity and touchdowns that are left.
        dcm: Reference that is led through the step.
        reaction: Of the swing leg.

    Attributes:
        swing: The swing foot's reference.
        plan: Of this step and the next ones.
        time: Planned single support [s].
    """

    def __init__(
        self,
        config: GaitConfig,
        measured: GaitMeasurement,
        soles: Soles,
        orders: Orders,
        dcm: DcmReference,
        reaction: SwingReaction,
    ) -> None:
        self._config, self._measured, self._soles, self._orders, self._dcm = config, measured, soles, orders, dcm
        self._reach_urgent = replace(config.reach, width_max=config.reach.width_urgent)
        self.swing = SwingFoot(config.swing)
        self.plan = StepPlan(soles, config, reaction, self.swing, orders.route)
        self.time = config.timing.single
        self._lifted = Foothold(0.0, 0.0, 0.0)
        self._target = np.zeros(2)  # DCM that the reference is to have at the touchdown, in W [m]
        self._next_adjustment = 0.0

    def plan_from(self, stance: int, omega: float) -> StepPlan:
        """The step plan, told that both feet are on the floor.

        Args:
            stance: The foot that will bear alone.
            omega: Of the pendulum [1/s].
        """
        return self._told(stance, self._soles.holds[1 - stance], omega)

    def far_off(self, omega: float) -> bool:
        """Whether the DCM is so far from its reference that every moment counts."""
        error = self._measured.dcm(omega) - self._dcm.dcm
        return float(np.linalg.norm(error)) > self._config.adjustment.urgent

    def lift(self, stance: int, omega: float) -> None:
        """Begin: the foot that is not the stance foot leaves the floor where it is measured."""
        foot = 1 - stance
        self._lifted = sole = self._measured.soles[foot]
        self.time = self._config.timing.single
        self.swing.lift(np.array([sole.x, sole.y, sole.z, sole.yaw]), self.time, self._soles.tilts[foot])
        self._next_adjustment = 0.0
        self.plan.urgent = self.far_off(omega)
        self._soles.holds[foot] = self._told(stance, self._lifted, omega).nominal()[0]
        self._adjust(stance, 0.0, omega)

    def step(self, stance: int, elapsed: float, omega: float, dt: float) -> None:
        """One tick.

        Args:
            stance: The foot that bears.
            elapsed: Time since lift-off [s].
            omega: Of the pendulum [1/s].
            dt: Time since the last tick [s].
        """
        config, foot, left = self._config, 1 - stance, self.time - elapsed
        if elapsed >= self._next_adjustment and left > config.swing.freeze:
            self._adjust(stance, elapsed, omega)
            self._next_adjustment = elapsed + config.timing.adjust_period
        elif left < 0.0:
            self._shift(stance, omega)
        target, sole = self._soles.holds[foot], self._measured.soles[foot]
        yaw = float(self.swing.position[3])
        height = self._soles.landing_height(foot, self._measured)
        pose = np.array([target.x, target.y, height, yaw + wrap(target.yaw - yaw)])
        if not self.plan.urgent:  # a foot in a hurry lags as if it were caught
            self.swing.heed(sole.x, sole.y, elapsed, self.time, dt)
        # A foot in a hurry lags behind its reference, and one that lands late is worse than one that lands early.
        lead = config.swing.urgent_lead if self.plan.urgent else 0.0
        self.swing.step(pose, self._soles.slope, elapsed, self.time - lead, dt)
        self._dcm.single(self._soles.point(stance), self._target, self.swing, target, omega, self.time - elapsed)

    def landed(self, stance: int, elapsed: float) -> bool:
        """Whether the foot has touched down, so long after lift-off [s]."""
        return self._measured.active[1 - stance] and elapsed > self._config.timing.landing_from * self.time

    def carry(self, way: Vector) -> None:
        """Move all that is planned in W (2,) [m]."""
        self._lifted, self._target = moved(self._lifted, way), self._target + way
        self.swing.position[:2] += way

    def _told(self, stance: int, lifted: Foothold, omega: float) -> StepPlan:
        """The step plan, told where the gait is and where the next or present swing begins."""
        plan = self.plan
        plan.stance, plan.foot, plan.lifted = self._soles.holds[stance], 1 - stance, lifted
        plan.velocity, plan.steps_left = self._orders.velocity, self._orders.steps_left
        plan.omega = omega
        return plan

    def _adjust(self, stance: int, elapsed: float, omega: float) -> None:
        """Foothold and time, from the measured DCM."""
        plan, holds = self._told(stance, self._lifted, omega), self._soles.holds
        plan.urgent = plan.urgent or self.far_off(omega)
        holds[plan.foot], self.time, self._target = plan.adjust(
            self._measured.dcm(omega), elapsed, self.time, holds[plan.foot]
        )

    def _shift(self, stance: int, omega: float) -> None:
        """A late foot goes on with the DCM, so that it lands where it was to be under it."""
        foot, holds = 1 - stance, self._soles.holds
        target, run = holds[foot], self._measured.dcm(omega) - self._target
        reach = self._reach_urgent if self.plan.urgent else self._config.reach
        shifted = clamped(holds[stance], foot, target.x + run[0], target.y + run[1], target.yaw, reach)
        self._target = self._target + np.array([shifted.x - target.x, shifted.y - target.y])
        holds[foot] = Foothold(shifted.x, shifted.y, shifted.yaw, target.z)
