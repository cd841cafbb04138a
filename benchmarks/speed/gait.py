"""Timing of the gait planner, of the step adjustment, and of the whole-body tick in single support.

The whole-body tick without the planner runs beside placo and the bare Pinocchio calls at the same state. It is judged
like the standing tick (``tick.py``). placo evicts the caches, so it runs in every other second, and only the ratio to
placo uses these seconds. Pre-empted samples are excluded, and the garbage collector is off.
"""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from itertools import permutations
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray
from pydantic.dataclasses import dataclass as schema

from benchmarks.core.benchmark import settings
from benchmarks.core.harness import Case, percentiles
from benchmarks.core.loops import advance, start_walk
from benchmarks.core.timed_run import (
    MICRO,
    QUANTILES,
    STATUSES,
    Stopwatch,
    TimedBenchmark,
    blocks_growth,
    collector_off,
    resident_growth,
    solution_figures,
)
from benchmarks.speed.tick_peers import PinocchioCalls, PlacoTick
from bridge.closed_loop import ClosedLoop
from controllers.balance.controller import BalanceController
from models.config import STRICT, Positive
from models.errors import PoiseError
from models.types import ControlResult, Reference, RobotState
from planners.gait.adjustment import StepPlanner
from planners.gait.planner import GaitPlanner

#: Timed calls: tick of the planner; step adjustment with preview, inside of it; tick of the law with its QP, without
#: the planner; at the same state, placo's dynamics solver and the bare Pinocchio calls
SUBJECTS = ("gait", "adjustment", "tick", "placo", "pinocchio_calls")
GAIT, ADJUSTMENT, TICK, PLACO, PINOCCHIO = range(len(SUBJECTS))

#: Orders of the calls, one per tick in turn, because earlier calls affect the caches
ORDERS = tuple(permutations((TICK, PLACO, PINOCCHIO)))


class TimedWalk:
    """Times the ticks of a walk without affecting it."""

    def __init__(self, planner: GaitPlanner, controller: BalanceController, ticks: int) -> None:
        self._planner, self._controller = planner, controller
        self._plan_step, self._adjust_step = self._planner.step, StepPlanner.adjust
        self._track = self._controller.step
        self._pinocchio = PinocchioCalls(self._planner.model)
        self._placo = PlacoTick(self._planner.model, self._controller.whole_body.config)
        self.watch = Stopwatch(ticks, len(SUBJECTS))  #: Times of ``SUBJECTS``, one row per tick
        self.count = self.placo_failed = 0  #: Number of recorded ticks, and of ticks without a solution of placo
        self.with_placo = False  #: Whether placo runs on the next ticks
        #: Whether the step was adjusted, the tick was in single support (also for placo), and placo ran (ticks,)
        self.adjusted, self.single, self.beside = np.zeros((3, ticks), dtype=bool)
        self.residual = np.zeros(ticks)  #: KKT residual of the QP (ticks,) [-]
        self.status = np.zeros(ticks, dtype=np.int64)  #: Index into ``STATUSES`` (ticks,)

    @contextmanager
    def recording(self) -> Iterator[None]:
        """Time all calls within the context."""

        def adjust(plan: StepPlanner, *arguments: Any) -> Any:
            self.adjusted[self.count] = True
            return self.watch.measure(self.count, ADJUSTMENT, self._adjust_step, plan, *arguments)

        with (
            patch.object(StepPlanner, "adjust", adjust),
            patch.object(self._planner, "step", self._plan),
            patch.object(self._controller, "step", self._tick),
        ):
            yield

    def _plan(self, *arguments: Any) -> Reference:
        reference: Reference = self.watch.measure(self.count, GAIT, self._plan_step, *arguments)
        return reference

    def _tick(self, state: RobotState, dt: float) -> ControlResult:
        """Time the law and its peers in changing order; placo uses the references of the previous tick."""
        row, before = self.count, self._controller.reference.contacts
        calls: dict[int, Callable[[], Any]] = {
            TICK: lambda: self._track(state, dt),
            PINOCCHIO: lambda: self._pinocchio.step(state.q, state.v),
        }
        if self.with_placo:
            self._placo.prepare(state, self._controller)
            calls[PLACO] = self._placo.step
        order = [subject for subject in ORDERS[row % len(ORDERS)] if subject in calls]
        done = {subject: self.watch.measure(row, subject, calls[subject]) for subject in order}
        for times in (self.watch.wall, self.watch.cpu):
            times[row, TICK] -= times[row, GAIT]  # the planner runs inside the law and is counted separately
        result: ControlResult = done[TICK]
        reference = self._controller.reference
        self.single[row] = before == reference.contacts and before[0] != before[1]
        self.beside[row] = self.with_placo
        self.residual[row], self.status[row] = result.residual, STATUSES.index(result.status)
        self.placo_failed += self.with_placo and not self._placo.success
        self.count += 1
        return result


@schema(frozen=True, slots=True, config=STRICT)
class GaitBenchConfig:
    """Settings of the walk; the units are in ``benchmarks/config/gait.yaml``."""

    forward: float
    warm_up: Positive
    duration: Positive
    memory_time: Positive


_config = partial(settings, GaitBenchConfig, "gait")


def measure(robot: str, seed: int) -> Case:
    """Time the ticks of one walk; returns ``figures``, and ``quantiles`` [us] of every subject at ``QUANTILES``."""
    config = _config()
    loop = ClosedLoop(robot=robot, seed=seed, record=False)
    start_walk(loop, config.forward)
    advance(loop, config.warm_up)
    law = loop.controller
    if not isinstance(law, BalanceController):
        raise PoiseError(f"{robot}: the controller of the loop is not the whole-body controller")
    timed = TimedWalk(loop.gait, law, round(config.duration / loop.plant.period) + 1)
    with collector_off(), timed.recording():
        for second in range(round(config.duration)):
            timed.with_placo = second % 2 == 1
            advance(loop, 1.0)
    blocks: list[int] = []
    settle = 2  # seconds

    def walk_alone(time: float) -> None:
        """Walk without peers or recording, so that nothing else allocates."""
        for _ in range(round(time)):
            advance(loop, 1.0)
            blocks.append(sys.getallocatedblocks())

    figures = summarise(timed)
    figures["resident_growth_kib"] = resident_growth(walk_alone, settle, config.memory_time)
    figures["allocated_blocks_growth"] = blocks_growth(blocks[settle:], loop.plant.period)
    rows = _rows(timed)
    quantiles = {
        name: np.percentile(timed.watch.wall[rows[:, i], i] * MICRO, QUANTILES).tolist()
        for i, name in enumerate(SUBJECTS)
    }
    return {"figures": figures, "quantiles": quantiles}


def _rows(timed: TimedWalk) -> NDArray[np.bool_]:
    """Return the ticks that count for each subject, pre-empted or not (ticks, 5)."""
    rows = np.zeros(timed.watch.wall.shape, dtype=bool)
    n = timed.count
    alone, single = ~timed.beside[:n], timed.single[:n]
    rows[:n, GAIT] = alone
    rows[:n, ADJUSTMENT] = alone & timed.adjusted[:n]
    rows[:n, TICK] = rows[:n, PINOCCHIO] = alone & single
    rows[:n, PLACO] = ~alone & single
    return rows


def summarise(timed: TimedWalk) -> dict[str, float]:
    """Compute the figures of a recorded walk; ``ValueError`` when a kind of tick is missing."""
    rows, wall, preempted = _rows(timed), timed.watch.wall * MICRO, timed.watch.preempted
    figures: dict[str, float] = {}
    kept = rows & ~preempted
    for i, name in enumerate(SUBJECTS):
        figures |= percentiles(wall[kept[:, i], i], f"{name}_us")
        figures[f"{name}_ungated_us_p99"] = float(np.percentile(wall[rows[:, i], i], 99.0))
    beside = rows[:, PLACO] & ~preempted[:, TICK]
    figures["tick_beside_placo_us_p50"] = float(np.median(wall[beside, TICK]))
    figures["ratio_to_placo"] = figures["tick_beside_placo_us_p50"] / figures["placo_us_p50"]
    figures["ratio_to_pinocchio_calls"] = figures["tick_us_p50"] / figures["pinocchio_calls_us_p50"]
    figures["p99_over_median"] = figures["tick_us_p99"] / figures["tick_us_p50"]
    figures["pinocchio_calls_p99_over_median"] = figures["pinocchio_calls_us_p99"] / figures["pinocchio_calls_us_p50"]
    figures["preempted_fraction"] = 1.0 - float(kept[:, GAIT].sum() / rows[:, GAIT].sum())
    counted = {"ticks": rows[:, GAIT], "adjustments": rows[:, ADJUSTMENT], "ticks_single_support": rows[:, TICK]}
    figures |= {name: float(chosen.sum()) for name, chosen in counted.items()}
    figures |= solution_figures(timed.residual[: timed.count], timed.status[: timed.count])
    figures["placo_failed"] = float(timed.placo_failed)
    return figures


class Gait(TimedBenchmark):
    """See the docstring of the module."""

    measure = staticmethod(measure)
