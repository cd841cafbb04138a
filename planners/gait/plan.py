"""Plans the step under way and the next ones: nominal footholds, DCM offsets, adjustment to the measured DCM."""

from __future__ import annotations

import numpy as np

from models.types import Matrix, Vector
from planners.gait import dcm
from planners.gait.config import GaitConfig, ReachConfig
from planners.gait.footsteps import Foothold, Velocity, limits_of, preview_poses
from planners.gait.kernels_steps import Point
from planners.gait.preview import coupled, previewed_offset, seen_from_stance, seen_from_world
from planners.gait.reaction import SwingReaction, whole_swing
from planners.gait.route import Route
from planners.gait.soles import Soles
from planners.gait.step_adjustment import Step, StepAdjustment, StepBounds
from planners.gait.swing import SwingFoot

Box = tuple[Point, Point]
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
        # What the next adjustment is about: these are the rows of one array, which a compiled function fills.
        self._seen = np.zeros((6, 2))
        step, offset, self._free, lower, upper, near = self._seen
        self._wanted = Step(step, config.timing.single, offset, np.zeros(2), True)
        self._bounds = StepBounds(lower, upper, 0.0, 0.0, self._cop[0], near, config.swing.speed_max)
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

    def nominal(self) -> tuple[Foothold, Point]:
        """Next foothold and the DCM offset wanted at its touchdown, in W [m]."""
        poses = self._coming()
        x, y, yaw = poses[1].tolist()
        return Foothold(x, y, yaw, self.stance.z), self._offset(poses)

    def _offset(self, poses: Matrix) -> Point:
        """DCM offset wanted at the touchdown on the first of the coming footholds, in W [m]."""
        timing = self._config.timing
        offset: Point = previewed_offset(
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
        return offset

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
        poses, foot, centres = self._coming(), self.foot, self._soles.centres
        timing, reaction = self._config.timing, self._reaction
        offset, coupling = self._offset(poses), coupled(self.omega, timing.single, timing.double, reaction.lever)
        lower, upper = (self._reach_urgent if self.urgent else self._reach)[foot]
        used = reaction.rest(self.omega, planned - elapsed, self._swing, (target.x, target.y))
        place, seen = self._swing.position, self._seen
        shift = seen_from_stance(poses, foot, centres, offset, measured, used, place, lower, upper, seen)
        adjusted = self._adjustment.solve(
            self._free,
            elapsed,
            self.omega,
            self._wanted,
            planned,
            self._step_bounds(elapsed),
            coupling,
            ending=self.steps_left is not None,
        )
        self.unsolved += not adjusted.solved
        (x, y), end = seen_from_world(poses, foot, centres, adjusted.step, seen, shift, offset, coupling)
        return Foothold(x, y, float(poses[1, 2]), self.stance.z), adjusted.time, np.array(end)

    def _step_bounds(self, elapsed: float) -> StepBounds:
        """What the step may be, so long after lift-off [s]."""
        timing, bounds = self._config.timing, self._bounds
        soonest = max(timing.single_urgent if self.urgent else timing.single_min, elapsed + self._swing.freeze)
        bounds.time_lower, bounds.time_upper = soonest, max(timing.single_max, soonest)
        bounds.cop = self._cop[1 - self.foot]
        return bounds


def _reach(reach: ReachConfig, widest: float) -> tuple[Box, Box]:
    """Where the left and where the right foot may be put, in the frame of the other one [m]: corners of a box."""
    ahead, back, narrowest = reach.forward, reach.backward, reach.width_min
    return ((-back, narrowest), (ahead, widest)), ((-back, -widest), (ahead, -narrowest))
