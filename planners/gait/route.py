"""A walk with an end: the footsteps still to be taken, to a goal or as they were listed."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

from models.errors import PoiseError
from planners.gait.config import GaitConfig
from planners.gait.footstep_plan import Footstep, check_footsteps, plan_to_pose
from planners.gait.footsteps import Foothold, clamped


class Route:
    """Hands out the coming footholds while they are being taken.

    They are fixed in W, so what one step misses, for a push or a slip, the next ones make up for as far as the reach
    allows. A route to a goal is planned anew when a foot lands farther than ``offset_max`` from where it was to.

    Args:
        config: The gait.

    Attributes:
        outcome: Why the last route ended: ``done`` once all its steps were taken; empty before and meanwhile.
    """

    def __init__(self, config: GaitConfig) -> None:
        self._config = config
        self._steps: deque[Footstep] = deque()
        self._goal: Foothold | None = None
        self.outcome = ""

    @property
    def left(self) -> int:
        """Touchdowns until it ends; 0: there is no route."""
        return len(self._steps)

    @property
    def foot(self) -> int:
        """The foot that steps next, while there is a route."""
        return self._steps[0].foot

    def take(self, steps: Sequence[Footstep], soles: Sequence[Foothold]) -> None:
        """Begin a list of footsteps from where the soles stand; see ``check_footsteps`` for what is raised."""
        check_footsteps(steps, soles, self._config)
        self._begin(steps, None)

    def towards(
        self, goal: Foothold, soles: Sequence[Foothold], foot: int | None, under_way: Footstep | None = None
    ) -> None:
        """Begin a route to a pose; see ``plan_to_pose`` for what is raised.

        Args:
            goal: Pose of the middle between the soles at the end.
            soles: Left and right sole, or the target of the one in the air.
            foot: The foot that steps next; None for either.
            under_way: The step that is being taken.
        """
        steps = plan_to_pose(goal, soles, self._config, foot)
        self._begin([under_way, *steps] if under_way is not None else steps, goal)

    def _begin(self, steps: Sequence[Footstep], goal: Foothold | None) -> None:
        self._steps, self._goal = deque(steps), goal
        self.outcome = "" if steps else "done"

    def end(self, reason: str) -> None:
        """Forget the steps that are left."""
        if self._steps:
            self._steps.clear()
            self.outcome = reason

    def ahead(self, stance: Foothold, count: int) -> list[Foothold]:
        """The next footholds, alternating feet, each brought into reach of the one before; at most so many."""
        holds: list[Foothold] = []
        for step in list(self._steps)[:count]:
            hold = step.hold
            stance = clamped(stance, step.foot, hold.x, hold.y, hold.yaw, self._config.reach)
            holds.append(stance)
        return holds

    def landed(self, soles: Sequence[Foothold]) -> None:
        """The next step has been taken, and the soles are there now."""
        step = self._steps.popleft()
        hold = soles[step.foot]
        missed = math.hypot(hold.x - step.hold.x, hold.y - step.hold.y) > self._config.route.offset_max
        if missed and self._goal is not None:
            try:
                self._steps = deque(plan_to_pose(self._goal, soles, self._config, 1 - step.foot))
            except PoiseError as error:
                self._steps.clear()
                self.outcome = str(error)
        if not self._steps and not self.outcome:
            self.outcome = "done"
