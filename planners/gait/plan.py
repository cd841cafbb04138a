"""Plans the step under way and the next ones: nominal footholds, DCM offsets, adjustment to the measured DCM."""

from __future__ import annotations

import math

import numpy as np

from models.types import Vector
from planners.gait import dcm
from planners.gait.config import GaitConfig
from planners.gait.footsteps import Foothold, Velocity, preview_footholds
from planners.gait.reaction import SwingReaction
from planners.gait.route import Route
from planners.gait.soles import Soles
from planners.gait.step_adjustment import Step, StepAdjustment, StepBounds
from planners.gait.swing import SwingFoot


class StepPlan:
    """Footholds and DCM of the coming steps.

    Args:
        soles: Where their middles are.
        config: The gait.
        reaction: Of the swing leg.
        swing: The swing foot's reference.
        route: Its footholds go before those of the velocity while there are any left.

    Attributes:
        stance: Foothold of the foot that bears, or that will.
        foot: The other foot (0 left, 1 right), which swings next or now.
        lifted: Foothold that it leaves, or left.
        velocity: What the walk is to do.
        steps_left: Touchdowns until the walk ends; None to walk on.
        omega: Of the pendulum [1/s].
        unsolved: Step adjustments that found no solution and kept to the nominal step.
    """

    def __init__(
        self, soles: Soles, config: GaitConfig, reaction: SwingReaction, swing: SwingFoot, route: Route
    ) -> None:
        self._config = config
        self._adjustment = StepAdjustment(config.adjustment)
        self._soles = soles
        self._reaction, self._swing, self._route = reaction, swing, route
        self.stance = Foothold(0.0, 0.0, 0.0)
        self.lifted = Foothold(0.0, 0.0, 0.0)
        self.foot = 0
        self.velocity: Velocity = (0.0, 0.0, 0.0)
        self.steps_left: int | None = None
        self.omega = 1.0
        self.unsolved = 0
        self.urgent = False

    def nominal(self) -> tuple[Foothold, Vector]:
        """Next foothold and the DCM offset wanted at its touchdown (2,) [m]."""
        timing, foot = self._config.timing, self.foot
        steps = (
            self._route.ahead(self.stance, self._config.preview)
            if self._route.left
            else preview_footholds(
                self.stance,
                foot,
                self.velocity,
                timing.single + timing.double,
                self._config.reach,
                self._config.preview,
                self.steps_left,
            )
        )
        points = [self._soles.point_of(1 - foot, self.stance)]
        points += [self._soles.point_of(foot if i % 2 == 0 else 1 - foot, hold) for i, hold in enumerate(steps)]
        final = None if self.steps_left is None else 0.5 * (points[-1] + points[-2])
        swings = [self._whole_swing(after - before) for before, after in zip(points[:-2], points[2:], strict=True)]
        return steps[0], dcm.touchdown_offset(points, self.omega, timing.single, timing.double, final, swings)

    def start_of_single(self) -> Vector:
        """DCM at which the coming single support is to begin (2,) [m]."""
        step, offset = self.nominal()
        single, landing = self._config.timing.single, self._soles.point_of(self.foot, step)
        way = landing - self._soles.point_of(self.foot, self.lifted)
        point = self._soles.point_of(1 - self.foot, self.stance)
        start = dcm.single_support(point, landing + offset, self.omega, single)[0]
        begun: Vector = start + self._whole_swing(way)
        return begun

    def _whole_swing(self, way: Vector) -> Vector:
        """DCM that a swing of a nominal step will use up (2,) [m], by the way of its foot (2,) [m]."""
        timing = self._config.timing
        period = timing.single + timing.double
        return self._reaction.whole_swing(self.omega, timing.single, period, way, self.stance.yaw, self._swing)

    def adjust(
        self, measured: Vector, elapsed: float, planned: float, target: Foothold
    ) -> tuple[Foothold, float, Vector]:
        """Foothold and time of the step under way.

        Args:
            measured: DCM in W (2,) [m].
            elapsed: Time since lift-off [s].
            planned: Touchdown time of the last adjustment [s].
            target: Foothold of the last adjustment; at lift-off the nominal one.

        Returns:
            Foothold, touchdown time since lift-off [s], and the DCM that the reference is to have there (2,) [m].
        """
        stance, foot = self.stance, self.foot
        step, offset = self.nominal()
        c, s = math.cos(stance.yaw), math.sin(stance.yaw)
        turn = np.array([[c, s], [-s, c]])  # W into the stance frame
        point = self._soles.point_of(1 - foot, stance)
        place = np.array(stance.relative(step.x, step.y))
        # From a foothold to the ZMP point in it, both in the stance frame and from the stance's own ZMP point.
        shift = np.array(stance.relative(*self._soles.point_of(foot, step))) - place - self._soles.centre(1 - foot)
        used = self._reaction.rest(self.omega, planned - elapsed, self._swing, np.array([target.x, target.y]))
        wanted = Step(place + shift, self._config.timing.single, turn @ offset, np.zeros(2), True)
        bounds = self._bounds(shift, elapsed, self._swing.position)
        free = turn @ (measured - point - used)
        coupling = self._coupling()
        adjusted = self._adjustment.solve(free, elapsed, self.omega, wanted, planned, bounds, coupling)
        self.unsolved += not adjusted.solved
        x, y = stance.moved(*(adjusted.step - shift))
        landing = point + turn.T @ adjusted.step
        offset = offset + coupling * (turn.T @ (adjusted.step - wanted.step))
        return Foothold(x, y, step.yaw, stance.z), adjusted.time, landing + offset

    def _coupling(self) -> float:
        """Change of the DCM offset wanted at touchdown per change of the foothold [-]; see ``dcm.touchdown_offset``.

        A longer step has a longer way for the ZMP in the double support, and a longer swing after it.
        """
        timing, omega = self._config.timing, self.omega
        transfer = dcm.transfer_share(omega, timing.double) - 1.0
        return transfer + math.exp(-omega * timing.double) * self._reaction.slope(omega, timing.single)

    def _bounds(self, shift: Vector, elapsed: float, swing: Vector) -> StepBounds:
        config, reach, timing = self._config, self._config.reach, self._config.timing
        widest = reach.width_urgent if self.urgent else reach.width_max
        lower = np.array([-reach.backward, reach.width_min if self.foot == 0 else -widest])
        upper = np.array([reach.forward, widest if self.foot == 0 else -reach.width_min])
        # A foot that is out of reach yet may stay in line with where it is, as far as its speed is concerned.
        near = np.clip(np.array(self.stance.relative(float(swing[0]), float(swing[1]))), lower, upper)
        soonest = max(timing.single_urgent if self.urgent else timing.single_min, elapsed + config.swing.freeze)
        return StepBounds(
            lower + shift,
            upper + shift,
            soonest,
            max(timing.single_max, soonest),
            config.adjustment.cop_share * self._soles.half_sole(1 - self.foot),
            near + shift,
            config.swing.speed_max,
        )
