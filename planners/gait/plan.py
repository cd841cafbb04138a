"""Plans the step under way and the next ones: nominal footholds, DCM offsets, adjustment to the measured DCM."""

from __future__ import annotations

import math

import numpy as np

from models.types import Matrix, Vector
from planners.gait import dcm
from planners.gait.config import GaitConfig, ReachConfig
from planners.gait.footsteps import Foothold, Velocity, limits_of, preview_poses
from planners.gait.kernels_steps import rotated
from planners.gait.preview import previewed_offset
from planners.gait.reaction import SwingReaction, whole_swing
from planners.gait.route import Route
from planners.gait.soles import Soles
from planners.gait.step_adjustment import Step, StepAdjustment, StepBounds
from planners.gait.swing import SwingFoot

Box = tuple[tuple[float, float], tuple[float, float]]
"""Least and largest of two coordinates [m]."""


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
        self._limits = limits_of(config.reach)
        self._reach = _reach(config.reach, config.reach.width_max)
        self._reach_urgent = _reach(config.reach, config.reach.width_urgent)
        self._cop = [config.adjustment.cop_share * soles.half_sole(foot) for foot in range(2)]
        self._no_cop = np.zeros(2)
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

    def nominal(self) -> tuple[Foothold, tuple[float, float]]:
        """Next foothold and the DCM offset wanted at its touchdown, in W [m]."""
        timing = self._config.timing
        poses = self._coming()
        offset = previewed_offset(
            poses,
            self.foot,
            self.steps_left is not None,
            self._soles.centres,
            self.omega,
            timing.single,
            timing.double,
            self._swing.shape,
            self._reaction.lever,
        )
        x, y, yaw = poses[1].tolist()
        return Foothold(x, y, yaw, self.stance.z), offset

    def _coming(self) -> Matrix:
        """The present stance and the coming footholds, each x, y [m] and heading [rad] in W (1 + steps, 3)."""
        config = self._config
        if self._route.left:
            steps = self._route.ahead(self.stance, config.preview)
            return np.array([self.stance.pose, *(step.pose for step in steps)])
        return preview_poses(
            self.stance, self.foot, self.velocity, config.period, self._limits, config.preview, self.steps_left
        )

    def start_of_single(self) -> Vector:
        """DCM at which the coming single support is to begin (2,) [m]."""
        step, offset = self.nominal()
        timing, soles = self._config.timing, self._soles
        landing, lifted = soles.point_of(self.foot, step), soles.point_of(self.foot, self.lifted)
        way = landing - lifted
        point = soles.point_of(1 - self.foot, self.stance)
        start = dcm.single_support(point, landing + offset, self.omega, timing.single)[0]
        swing = whole_swing(
            self.omega,
            timing.single,
            self._config.period,
            (way[0], way[1]),
            self.stance.yaw,
            self._swing.shape,
            self._reaction.lever,
        )
        begun: Vector = start + swing
        return begun

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
        stance, foot, timing = self.stance, self.foot, self._config.timing
        step, offset = self.nominal()
        centre = self._soles.centre(1 - foot)
        point = stance.moved(*centre)
        place, landing = stance.relative(step.x, step.y), stance.relative(*step.moved(*self._soles.centre(foot)))
        # From a foothold to the ZMP point in it, both in the stance frame and from the stance's own ZMP point.
        shift = landing[0] - place[0] - centre[0], landing[1] - place[1] - centre[1]
        wanted_x, wanted_y = place[0] + shift[0], place[1] + shift[1]
        wanted_offset = np.array(rotated(-stance.yaw, *offset))
        wanted = Step(np.array([wanted_x, wanted_y]), timing.single, wanted_offset, self._no_cop, True)
        used_x, used_y = self._reaction.rest(self.omega, planned - elapsed, self._swing, (target.x, target.y))
        free = rotated(-stance.yaw, measured[0] - point[0] - used_x, measured[1] - point[1] - used_y)
        bounds = self._bounds(shift, elapsed)
        coupling = self._coupling()
        adjusted = self._adjustment.solve(np.array(free), elapsed, self.omega, wanted, planned, bounds, coupling)
        self.unsolved += not adjusted.solved
        step_x, step_y = adjusted.step.tolist()
        x, y = stance.moved(step_x - shift[0], step_y - shift[1])
        way = rotated(stance.yaw, step_x, step_y)
        more = rotated(stance.yaw, coupling * (step_x - wanted_x), coupling * (step_y - wanted_y))
        end = np.array([point[0] + way[0] + offset[0] + more[0], point[1] + way[1] + offset[1] + more[1]])
        return Foothold(x, y, step.yaw, stance.z), adjusted.time, end

    def _coupling(self) -> float:
        """Change of the DCM offset wanted at touchdown per change of the foothold [-]; see ``dcm.touchdown_offset``.

        A longer step has a longer way for the ZMP in the double support, and a longer swing after it.
        """
        timing, omega = self._config.timing, self.omega
        transfer = dcm.transfer_share(omega, timing.double) - 1.0
        return transfer + math.exp(-omega * timing.double) * self._reaction.slope(omega, timing.single)

    def _bounds(self, shift: tuple[float, float], elapsed: float) -> StepBounds:
        """What the step may be.

        Args:
            shift: From a foothold to the ZMP point in it, in the stance frame [m].
            elapsed: Time since lift-off [s].
        """
        config, timing = self._config, self._config.timing
        lower, upper = (self._reach_urgent if self.urgent else self._reach)[self.foot]
        # A foot that is out of reach yet may stay in line with where it is, as far as its speed is concerned.
        forward, left = self.stance.relative(self._swing.position[0], self._swing.position[1])
        near_x, near_y = min(max(forward, lower[0]), upper[0]), min(max(left, lower[1]), upper[1])
        soonest = max(timing.single_urgent if self.urgent else timing.single_min, elapsed + config.swing.freeze)
        return StepBounds(
            np.array([lower[0] + shift[0], lower[1] + shift[1]]),
            np.array([upper[0] + shift[0], upper[1] + shift[1]]),
            soonest,
            max(timing.single_max, soonest),
            self._cop[1 - self.foot],
            np.array([near_x + shift[0], near_y + shift[1]]),
            config.swing.speed_max,
        )


def _reach(reach: ReachConfig, widest: float) -> tuple[Box, Box]:
    """Where the left and where the right foot may be put, in the frame of the other one [m]: corners of a box."""
    ahead, back, narrowest = reach.forward, reach.backward, reach.width_min
    return ((-back, narrowest), (ahead, widest)), ((-back, -widest), (ahead, -narrowest))
