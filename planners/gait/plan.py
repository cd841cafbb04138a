"""Plans the step under way and the next ones: nominal footholds, DCM offsets, adjustment to the measured DCM."""

from __future__ import annotations

import math

import numpy as np

from models.robot_model import RobotModel
from models.types import Vector
from planners.gait import dcm
from planners.gait.config import GaitConfig
from planners.gait.footsteps import Foothold, Velocity, preview_footholds
from planners.gait.step_adjustment import Step, StepAdjustment, StepBounds


class StepPlan:
    """Footholds and DCM of the coming steps.

    Args:
        model: The robot: its soles.
        config: The gait.

    Attributes:
        stance: Foothold of the foot that bears, or that will.
        foot: The other foot (0 left, 1 right), which swings next or now.
        velocity: What the walk is to do.
        steps_left: Touchdowns until the walk ends; None to walk on.
        omega: Of the pendulum [1/s].
    """

    def __init__(self, model: RobotModel, config: GaitConfig) -> None:
        self._config = config
        self._adjustment = StepAdjustment(config.adjustment)
        rectangles = [foot.rectangle for foot in model.feet]
        self._centres = [(0.5 * (r[0] + r[1]), 0.5 * (r[2] + r[3])) for r in rectangles]
        self._half = [np.array([0.5 * (r[1] - r[0]), 0.5 * (r[3] - r[2])]) for r in rectangles]
        self.stance = Foothold(0.0, 0.0, 0.0)
        self.foot = 0
        self.velocity: Velocity = (0.0, 0.0, 0.0)
        self.steps_left: int | None = None
        self.omega = 1.0

    def half_sole(self, foot: int) -> Vector:
        """Half length and half width of a sole (2,) [m]."""
        return self._half[foot]

    def point(self, foot: int, hold: Foothold) -> Vector:
        """ZMP point of a foothold: the middle of the sole (2,) [m]."""
        return np.array(hold.moved(*self._centres[foot]))

    def nominal(self) -> tuple[Foothold, Vector]:
        """Next foothold and the DCM offset wanted at its touchdown (2,) [m]."""
        timing, foot = self._config.timing, self.foot
        steps = preview_footholds(
            self.stance,
            foot,
            self.velocity,
            timing.single + timing.double,
            self._config.reach,
            self._config.preview,
            self.steps_left,
        )
        points = [self.point(1 - foot, self.stance)]
        points += [self.point(foot if i % 2 == 0 else 1 - foot, hold) for i, hold in enumerate(steps)]
        final = None if self.steps_left is None else 0.5 * (points[-1] + points[-2])
        return steps[0], dcm.touchdown_offset(points, self.omega, timing.single, timing.double, final)

    def start_of_single(self) -> Vector:
        """DCM at which the coming single support is to begin (2,) [m]."""
        step, offset = self.nominal()
        touchdown = self.point(self.foot, step) + offset
        return dcm.single_support(
            self.point(1 - self.foot, self.stance), touchdown, self.omega, self._config.timing.single
        )[0]

    def adjust(self, measured: Vector, elapsed: float, planned: float, swing: Vector) -> tuple[Foothold, float, Vector]:
        """Foothold and time of the step under way.

        Args:
            measured: DCM in W (2,) [m].
            elapsed: Time since lift-off [s].
            planned: Touchdown time of the last adjustment [s].
            swing: Where the swing foot is, x and y in W (2,) [m].

        Returns:
            Foothold, touchdown time since lift-off [s], and the DCM that the reference is to have there (2,) [m].
        """
        stance, foot = self.stance, self.foot
        step, offset = self.nominal()
        c, s = math.cos(stance.yaw), math.sin(stance.yaw)
        turn = np.array([[c, s], [-s, c]])  # W into the stance frame
        point = self.point(1 - foot, stance)
        place = np.array(stance.relative(step.x, step.y))
        # From a foothold to the ZMP point in it, both in the stance frame and from the stance's own ZMP point.
        shift = np.array(stance.relative(*self.point(foot, step))) - place - self._centres[1 - foot]
        wanted = Step(place + shift, self._config.timing.single, turn @ offset, np.zeros(2), True)
        bounds = self._bounds(shift, elapsed, planned, swing)
        adjusted = self._adjustment.solve(turn @ (measured - point), elapsed, self.omega, wanted, planned, bounds)
        x, y = stance.moved(*(adjusted.step - shift))
        target = point + turn.T @ (adjusted.step + wanted.offset)
        return Foothold(x, y, step.yaw, stance.z), adjusted.time, target

    def _bounds(self, shift: Vector, elapsed: float, planned: float, swing: Vector) -> StepBounds:
        config, reach, timing = self._config, self._config.reach, self._config.timing
        lower = np.array([-reach.backward, reach.width_min if self.foot == 0 else -reach.width_max])
        upper = np.array([reach.forward, reach.width_max if self.foot == 0 else -reach.width_min])
        far = config.swing.speed_max * max(planned - elapsed, 0.0)
        near = np.clip(np.array(self.stance.relative(float(swing[0]), float(swing[1]))), lower, upper)
        lower, upper = np.maximum(lower, near - far), np.minimum(upper, near + far)
        soonest = max(timing.single_min, elapsed + config.swing.freeze)
        return StepBounds(
            lower + shift,
            upper + shift,
            soonest,
            max(timing.single_max, soonest),
            config.adjustment.cop_share * self._half[1 - self.foot],
        )
