"""What a walk is to do: follow a velocity or take a route, and after how many touchdowns to end."""

from __future__ import annotations

import math
from collections.abc import Sequence

from models.errors import CommandError
from planners.gait.config import GaitConfig
from planners.gait.footstep_plan import Footstep
from planners.gait.footsteps import Foothold, Velocity
from planners.gait.route import Route
from planners.gait.velocity import VelocityLimiter


class Orders:
    """Takes commands and counts down the last steps.

    Args:
        config: The gait.

    Attributes:
        route: Footsteps that are being taken instead of a velocity's.
        steps_left: Touchdowns until the walk ends; None to walk on.
    """

    def __init__(self, config: GaitConfig) -> None:
        self._preview = config.preview
        self._limiter = VelocityLimiter(config.velocity)
        self._muted = False
        self.route = Route(config)
        self.steps_left: int | None = None

    @property
    def wanted(self) -> Velocity:
        """What is commanded, within the limits of size."""
        return self._limiter.wanted

    @property
    def velocity(self) -> Velocity:
        """What the walk is to do now, within the limits of size and acceleration."""
        return self._limiter.velocity

    @property
    def moving(self) -> bool:
        """Whether there is anything to walk for."""
        return self._limiter.moving or bool(self.route.left)

    @property
    def over(self) -> bool:
        """Whether the last touchdown was that of the last step."""
        return self.steps_left is not None and self.steps_left <= 0

    @property
    def first_foot(self) -> int:
        """The foot that is to make the first step: that of the route, or the one on the side of the velocity."""
        if self.route.left:
            return self.route.foot
        _, left, turn = self._limiter.wanted
        lean = left if abs(left) > 1e-6 else turn
        return 0 if lean >= 0.0 else 1

    def reset(self) -> None:
        """The robot stands, and nothing is wanted."""
        self._limiter.reset()
        self.route.end("the walk began anew")
        self.steps_left = None
        self._muted = False

    def set_velocity(self, forward: float, left: float, turn: float) -> None:
        """Take a velocity [m/s, m/s, rad/s]; see ``GaitPlanner.set_velocity``."""
        if not all(math.isfinite(value) for value in (forward, left, turn)):
            raise CommandError(f"velocity ({forward}, {left}, {turn}) refused: not finite")
        self._muted = self._muted and any((forward, left, turn))
        if self._muted:
            return
        self._limiter.set(forward, left, turn)
        if self._limiter.moving:
            self._leave_route("a velocity was commanded")

    def stop(self) -> None:
        """Want nothing any more."""
        self._limiter.set(0.0, 0.0, 0.0)
        self._leave_route("stopped")

    def cancel(self, reason: str) -> None:
        """Want nothing any more, and heed no velocity until zero has been commanded once."""
        self._limiter.reset()
        self._leave_route(reason)
        self._muted = True

    def walk_to(
        self, goal: Foothold, soles: Sequence[Foothold], foot: int | None, under_way: Footstep | None = None
    ) -> None:
        """Take a route to a pose; see ``Route.towards``."""
        self.route.towards(goal, soles, foot, under_way)
        self._limiter.reset()

    def take_steps(self, steps: Sequence[Footstep], soles: Sequence[Foothold]) -> None:
        """Take listed footsteps; see ``Route.take``."""
        self.route.take(steps, soles)
        self._limiter.reset()

    def heed(self, stepping: bool, dt: float) -> None:
        """Advance the velocity by a time [s]; count down the last two steps once none is wanted.

        Args:
            stepping: Whether steps are being taken, so that the walk needs an end.
            dt: Time since the last tick [s].
        """
        if self.route.left:
            self.steps_left = self.route.left if self.route.left <= self._preview else None
        elif self._limiter.moving:
            self._limiter.step(dt)
            self.steps_left = None
        elif stepping and self.steps_left is None:
            self.steps_left = 2
        elif not stepping:
            self._limiter.reset()

    def landed(self, soles: Sequence[Foothold]) -> None:
        """A step has been taken, and the soles are there now."""
        if self.route.left:
            self.route.landed(soles)
            self.steps_left = self.route.left + 1
        if self.steps_left is not None:
            self.steps_left -= 1

    def _leave_route(self, reason: str) -> None:
        if self.route.left:
            self.route.end(reason)
            self.steps_left = None
