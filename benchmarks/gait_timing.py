"""Times the gait planner, its step adjustment and the whole-body tick of a robot that walks in lockstep."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.tick_peers import PinocchioCalls
from benchmarks.tick_timing import Stopwatch
from controllers.walker import Walker
from models.types import ControlResult, Reference, RobotState
from planners.gait.gait import GaitPlanner
from planners.gait.plan import StepPlan

SUBJECTS = ("gait", "adjustment", "tick", "pinocchio_calls")
"""What is timed: the planner's tick; in it one step adjustment with its preview; the walking controller's tick with its
QP; beside it, at the same state, the bare Pinocchio calls."""

GAIT, ADJUSTMENT, TICK, PINOCCHIO = range(len(SUBJECTS))


class TimedWalk:
    """Times the ticks of a walker, which does what it always does.

    Args:
        walker: Gait planner and walking controller.
        ticks: Most ticks that are recorded.

    Attributes:
        watch: Times of each of ``SUBJECTS``, one row a tick.
        count: Ticks recorded.
        adjusted: Whether the step was adjusted on the tick (ticks,).
        single: Whether the tick was one of single support (ticks,).
    """

    def __init__(self, walker: Walker[GaitPlanner], ticks: int) -> None:
        self._planner, self._controller = walker.planner, walker.controller
        self._plan_step, self._adjust_step = self._planner.step, StepPlan.adjust
        self._track = self._controller.step
        self._pinocchio = PinocchioCalls(self._planner.model)
        self.watch = Stopwatch(ticks, len(SUBJECTS))
        self.count = 0
        self.adjusted, self.single = np.zeros(ticks, dtype=bool), np.zeros(ticks, dtype=bool)

    @contextmanager
    def recording(self) -> Iterator[None]:
        """Time what happens meanwhile."""

        def adjust(plan: StepPlan, *arguments: Any) -> Any:
            self.adjusted[self.count] = True
            return self.watch.measure(self.count, ADJUSTMENT, self._adjust_step, plan, *arguments)

        with (
            patch.object(StepPlan, "adjust", adjust),
            patch.object(self._planner, "step", self._plan),
            patch.object(self._controller, "step", self._tick),
        ):
            yield

    def _plan(self, state: RobotState, dt: float) -> Reference:
        reference: Reference = self.watch.measure(self.count, GAIT, self._plan_step, state, dt)
        return reference

    def _tick(self, state: RobotState, reference: Reference, dt: float) -> ControlResult:
        """The controller and its peer, in changing order: what ran before decides what the caches hold."""
        row, watch = self.count, self.watch
        if row % 2:
            watch.measure(row, PINOCCHIO, self._pinocchio.step, state.q, state.v)
        result: ControlResult = watch.measure(row, TICK, self._track, state, reference, dt)
        if not row % 2:
            watch.measure(row, PINOCCHIO, self._pinocchio.step, state.q, state.v)
        self.single[row] = reference.contacts[0] != reference.contacts[1]
        self.count += 1
        return result
