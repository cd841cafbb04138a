"""Times the gait planner, its step adjustment and the whole-body tick of a robot that walks in lockstep."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import permutations
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.tick_peers import PinocchioCalls, PlacoTick
from benchmarks.tick_timing import STATUSES, Stopwatch
from controllers.walker import Walker
from models.types import ControlResult, Reference, RobotState
from planners.gait.gait import GaitPlanner
from planners.gait.plan import StepPlan

SUBJECTS = ("gait", "adjustment", "tick", "placo", "pinocchio_calls")
"""What is timed: the planner's tick; in it one step adjustment with its preview; the walking controller's tick with its
QP; beside it, at the same state, placo's dynamics solver and the bare Pinocchio calls."""

GAIT, ADJUSTMENT, TICK, PLACO, PINOCCHIO = range(len(SUBJECTS))

ORDERS = tuple(permutations((TICK, PLACO, PINOCCHIO)))
"""Orders that the ticks go through in turn: what ran before decides what the caches hold."""


class TimedWalk:
    """Times the ticks of a walker, which does what it always does.

    Args:
        walker: Gait planner and walking controller.
        ticks: Most ticks that are recorded.

    Attributes:
        watch: Times of each of ``SUBJECTS``, one row a tick.
        count: Ticks recorded.
        adjusted: Whether the step was adjusted on the tick (ticks,).
        single: Whether the tick was one of single support, for placo too (ticks,).
        beside: Whether placo ran beside it (ticks,).
        with_placo: Whether placo runs beside the ticks to come.
        residual: KKT residual of the walking controller's QP (ticks,) [-].
        status: Index into ``STATUSES`` (ticks,).
        placo_failed: Ticks on which placo found no solution.
    """

    def __init__(self, walker: Walker[GaitPlanner], ticks: int) -> None:
        self._planner, self._controller = walker.planner, walker.controller
        self._plan_step, self._adjust_step = self._planner.step, StepPlan.adjust
        self._track = self._controller.step
        self._pinocchio = PinocchioCalls(self._planner.model)
        self._placo = PlacoTick(self._planner.model, self._controller.whole_body.config)
        self.watch = Stopwatch(ticks, len(SUBJECTS))
        self.count = 0
        self.adjusted, self.single = np.zeros(ticks, dtype=bool), np.zeros(ticks, dtype=bool)
        self.beside, self.with_placo = np.zeros(ticks, dtype=bool), False
        self.residual, self.status = np.zeros(ticks), np.zeros(ticks, dtype=np.int64)
        self.placo_failed = 0

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
        """The controller and its peers, in changing order. placo gets the references of the tick before."""
        row, before = self.count, self._controller.reference.contacts
        calls: dict[int, Callable[[], Any]] = {
            TICK: lambda: self._track(state, reference, dt),
            PINOCCHIO: lambda: self._pinocchio.step(state.q, state.v),
        }
        if self.with_placo:
            self._placo.prepare(state, self._controller)
            calls[PLACO] = self._placo.step
        order = [subject for subject in ORDERS[row % len(ORDERS)] if subject in calls]
        done = {subject: self.watch.measure(row, subject, calls[subject]) for subject in order}
        result: ControlResult = done[TICK]
        self.single[row] = before == reference.contacts and before[0] != before[1]
        self.beside[row] = self.with_placo
        self.residual[row], self.status[row] = result.residual, STATUSES.index(result.status)
        self.placo_failed += self.with_placo and not self._placo.success
        self.count += 1
        return result
