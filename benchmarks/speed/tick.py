"""Timing of the whole-body tick in the closed loop, compared with placo's dynamics solver and bare Pinocchio calls.

The robot waves and is pushed from all sides, so that the active set changes. The peers run at the same state on each
tick, in changing order, so that caches and machine speed are equal for all. Pre-empted samples are excluded, and the
garbage collector is off. A separate run times the inverse kinematics of pink and mink, which would otherwise evict the
caches; another run times the complete ``ControlStack``.
"""

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, nullcontext
from functools import partial
from itertools import permutations
from time import perf_counter_ns
from typing import Annotated, Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass as schema

from benchmarks.core.benchmark import settings
from benchmarks.core.harness import Case, percentiles
from benchmarks.core.loops import advance, demand, start_walk
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
from benchmarks.speed.tick_peers import KinematicPeer, PinocchioCalls, PlacoTick, installed_peers
from benchmarks.stability.exercise import exercise, exercise_config
from bridge.closed_loop import ClosedLoop
from controllers.balance.controller import BalanceController
from controllers.qp.terms import Terms
from controllers.whole_body.controller import WholeBodyController
from models.config import STRICT, Positive
from models.robot_model import RobotModel
from models.types import ControlResult, RobotState

#: Timed on every tick: our tick, placo's, the Pinocchio calls in our tick, and Pinocchio calls for all its terms
SUBJECTS = ("tick", "placo", "own_calls", "pinocchio_calls")


#: Parts of the tick: model terms; footholds, motion, references and feedback; QP; solution; torques; setpoint
STAGES = ("terms", "references", "build", "solve", "recover", "rest")


class StageProbe:
    """Records begin and end of each stage of a tick while ``attached``."""

    def __init__(self, whole_body: WholeBodyController) -> None:
        self._stamps = np.zeros(2 * 4, dtype=np.int64)
        builder = whole_body.builder
        self._stages: list[tuple[Any, str]] = [
            *((whole_body.terms, "update"), (builder, "build"), (whole_body.solver, "solve"), (builder, "recover"))
        ]

    @contextmanager
    def attached(self) -> Iterator[None]:
        """Time the stages within the context by wrapping their methods."""
        with ExitStack() as stack:
            for index, (owner, name) in enumerate(self._stages):
                stack.enter_context(patch.object(owner, name, self._timed(getattr(owner, name), 2 * index)))
            yield

    def _timed(self, call: Callable[..., Any], slot: int) -> Callable[..., Any]:
        stamps = self._stamps

        def timed(*arguments: Any) -> Any:
            stamps[slot] = perf_counter_ns()
            result = call(*arguments)
            stamps[slot + 1] = perf_counter_ns()
            return result

        return timed

    def durations(self, total: int) -> NDArray[np.int64]:
        """Return the times of ``STAGES`` in the last tick, whose duration is ``total`` [ns]."""
        stamps = self._stamps
        terms, build, solve, recover = (int(stamps[2 * i + 1] - stamps[2 * i]) for i in range(4))
        references = int(stamps[2] - stamps[1])
        return np.array(
            [terms, references, build, solve, recover, total - terms - references - build - solve - recover]
        )


class TimedController:
    """Times each tick of a law, and the peers at the same state before or after it.

    One tick per ``stage_period`` is split by stage. A row within ``active_tolerance`` of its bound is active [-].
    """

    def __init__(
        self,
        controller: BalanceController,
        *,
        ticks: int,
        stage_period: int,
        active_tolerance: float,
        kinematic: Mapping[str, KinematicPeer] | None = None,
    ) -> None:
        model = controller.whole_body.model
        self.controller, self._track = controller, controller.step
        self._placo = PlacoTick(model, controller.whole_body.config)
        self._pinocchio = PinocchioCalls(model)
        self._terms = Terms(model)
        self._probe = StageProbe(controller.whole_body)
        self._period, self._tolerance = stage_period, active_tolerance
        self._kinematic = list((kinematic or {}).values())
        self._calls: tuple[Callable[[], None], ...] = (
            self._own,
            self._placo.step,
            self._terms.call_pinocchio,
            lambda: self._pinocchio.step(self._terms.q, self._terms.v),
            *(peer.step for peer in self._kinematic),
        )
        self.subjects = (*SUBJECTS, *(kinematic or {}))  #: ``SUBJECTS`` and the names of ``kinematic``
        #: Orders of the calls, one per tick in turn, because earlier calls affect the caches
        self._orders = tuple(permutations(range(len(self.subjects))))
        self.count = self.placo_failed = 0  #: Number of recorded ticks, and of ticks without a solution of placo
        self._watch = watch = Stopwatch(ticks, len(self.subjects))
        #: Records of ``Stopwatch`` (ticks, subjects)
        self.wall, self.cpu, self.preempted = watch.wall, watch.cpu, watch.preempted
        #: Times of ``STAGES`` (ticks, 6) [ns]; zero on ticks that were not split
        self.stages = np.zeros((ticks, len(STAGES)), dtype=np.int64)
        self.residual = np.zeros(ticks)  #: KKT residual of the QP (ticks,) [-]
        self.status = np.zeros(ticks, dtype=np.int64)  #: Index into ``STATUSES`` (ticks,)
        self.active = np.zeros(ticks, dtype=np.int64)  #: Active rows (ticks,)
        #: Whether the active set differs from the previous tick (ticks,)
        self.changed = np.zeros(ticks, dtype=bool)
        self._set = b""

    @contextmanager
    def recording(self) -> Iterator[None]:
        """Time the ticks within the context."""
        with patch.object(self.controller, "step", self.step):
            yield

    def step(self, state: RobotState, dt: float) -> ControlResult:
        """Run one tick of the controller and its peers."""
        self._state, self._dt, row = state, dt, self.count
        # placo uses the references of the previous tick because it may run first.
        self._placo.prepare(state, self.controller)
        self._terms.q[:], self._terms.v[:] = state.q, state.v
        for peer in self._kinematic:
            peer.prepare(state)
        split = (row + 1) % self._period == 0
        with self._probe.attached() if split else nullcontext():
            for subject in self._orders[row % len(self._orders)]:
                self._watch.measure(row, subject, self._calls[subject])
        self.stages[row] = self._probe.durations(int(self.wall[row, 0])) if split else 0
        self._judge(row)
        self.count += 1
        return self._result

    def _own(self) -> None:
        self._result = self._track(self._state, self._dt)

    def _judge(self, row: int) -> None:
        whole_body = self.controller.whole_body
        self.residual[row] = self._result.residual
        self.status[row] = STATUSES.index(self._result.status)
        self.placo_failed += not self._placo.success
        z, qp = whole_body.solution.z, whole_body.problem
        if z is None or qp is None:
            return
        values = qp.matrix @ z
        slack = np.minimum(values - qp.lower, qp.upper - values)
        active = slack < self._tolerance * (1.0 + np.abs(values))
        bits = active.tobytes()
        self.active[row] = np.count_nonzero(active)
        self.changed[row] = bits != self._set
        self._set = bits


MODES = ("stand", "walk")  # tasks in ``time_stack``, in this order


def time_stack(model: RobotModel, seed: int, *, warm_up: float, duration: float, speed: float) -> dict[str, float]:
    """Time the control stack while standing, then walking at ``speed`` [m/s], for ``duration`` [s] each."""
    loop = ClosedLoop(robot=model, seed=seed, record=False)
    figures: dict[str, float] = {}
    for mode in MODES:
        if mode == "walk":
            start_walk(loop, speed)
        advance(loop, warm_up)
        watch = Stopwatch(round(duration / loop.plant.period) + 1, 2)
        with collector_off(), watch.timing(loop.stack, "step", 0), watch.timing(loop.stack, "supervise", 1):
            advance(loop, duration)
        figures |= percentiles(watch.times(0, 1), f"stack_{mode}_us")
    return figures


@schema(frozen=True, slots=True, config=STRICT)
class TickConfig:
    """Settings of the tick test; the units are in ``benchmarks/config/tick.yaml``."""

    duration: Positive
    kinematics_duration: Positive
    stack_warm_up: Positive
    stack_duration: Positive
    stack_speed: Positive
    memory_time: Positive
    stage_period: Annotated[int, Field(ge=2)]
    active_tolerance: Positive


tick_config = partial(settings, TickConfig, "tick")


def _timed_loop(
    model: RobotModel, seed: int, duration: float, peers: Mapping[str, KinematicPeer] | None = None
) -> tuple[TimedController, ClosedLoop]:
    """Prepare a waving robot, warmed up with its peers, for timing over ``duration`` [s]; it takes no steps."""
    config, warm_up, law = tick_config(), exercise_config().warm_up, BalanceController(model)
    loop = ClosedLoop(robot=model, seed=seed, record=False, controller=law)
    law.gait = None  # the gait planner has a separate benchmark
    timed = TimedController(
        law,
        ticks=round((warm_up + duration) / loop.plant.period) + 1,
        stage_period=config.stage_period,
        active_tolerance=config.active_tolerance,
        kinematic=peers,
    )
    demand(loop, exercise_config().motion)
    with timed.recording():
        loop.run(warm_up)
    timed.count = timed.placo_failed = 0
    return timed, loop


def measure(robot: str, seed: int) -> Case:
    """Time the ticks of one run; returns ``figures``, and ``quantiles`` [us] of every subject at ``QUANTILES``."""
    config, model = tick_config(), RobotModel.load(robot)
    timed, loop = _timed_loop(model, seed, config.duration)
    blocks = []
    with collector_off(), timed.recording():
        for _ in exercise(loop, config.duration, exercise_config()):
            blocks.append(sys.getallocatedblocks())
    figures = summarise(timed)
    figures["allocated_blocks_growth"] = blocks_growth(blocks, loop.plant.period)
    figures["resident_growth_kib"] = resident_growth(loop.run, exercise_config().push_period, config.memory_time)
    kept = timed.wall[: timed.count] * MICRO
    quantiles = {name: np.percentile(kept[:, i], QUANTILES).tolist() for i, name in enumerate(SUBJECTS)}
    figures |= beside_kinematics(model, seed, config)
    figures |= time_stack(
        model, seed, warm_up=config.stack_warm_up, duration=config.stack_duration, speed=config.stack_speed
    )
    return {"figures": figures, "quantiles": quantiles, "blocks": blocks}


def beside_kinematics(model: RobotModel, seed: int, config: TickConfig) -> dict[str, float]:
    """Time pink and mink if installed: ``<name>_us_p50`` and ``_p99`` [us], and ``ratio_to_<name>`` of the tick."""
    peers = installed_peers(model)
    if not peers:
        return {}
    timed, loop = _timed_loop(model, seed, config.kinematics_duration, peers)
    with collector_off(), timed.recording():
        for _ in exercise(loop, config.kinematics_duration, exercise_config()):
            pass
    wall, kept = timed.wall[: timed.count] * MICRO, ~timed.preempted[: timed.count]
    figures: dict[str, float] = {}
    kept[timed.stages[: timed.count].any(axis=1), 0] = False
    tick = float(np.median(wall[kept[:, 0], 0]))
    for i, name in enumerate(timed.subjects[len(SUBJECTS) :], start=len(SUBJECTS)):
        p50, p99 = np.percentile(wall[kept[:, i], i], [50.0, 99.0])
        figures |= {f"{name}_us_p50": float(p50), f"{name}_us_p99": float(p99), f"ratio_to_{name}": tick / float(p50)}
    return figures


def summarise(timed: TimedController) -> dict[str, float]:
    """Compute the figures of the recorded ticks, with the unit in the name."""
    n = timed.count
    wall, cpu = timed.wall[:n] * MICRO, timed.cpu[:n] * MICRO
    staged = timed.stages[:n].any(axis=1)
    kept = ~timed.preempted[:n]
    kept[staged, 0] = False
    whole = ~staged
    figures = percentiles(wall[kept[:, 0], 0], "tick_us")
    figures["p99_over_median"] = figures["tick_us_p99"] / figures["tick_us_p50"]
    median = {name: float(np.median(wall[kept[:, i], i])) for i, name in enumerate(SUBJECTS)}
    for name in SUBJECTS[1:]:
        figures[f"ratio_to_{name}"] = median["tick"] / median[name]
    for i, name in enumerate(SUBJECTS[1:], start=1):
        figures |= {f"{name}_us_p50": median[name], f"{name}_us_p99": float(np.percentile(wall[kept[:, i], i], 99.0))}
    for i, stage in enumerate(STAGES):
        figures[f"{stage}_us_p50"] = float(np.median(timed.stages[:n][staged & ~timed.preempted[:n, 0], i])) * MICRO
    figures |= percentiles(wall[whole, 0], "tick_ungated_us")
    figures |= percentiles(cpu[whole, 0], "tick_cpu_us")
    figures["ratio_to_placo_cpu"] = float(np.median(cpu[whole, 0]) / np.median(cpu[:, 1]))
    figures["preempted_fraction"] = float(timed.preempted[:n][whole, 0].mean())
    figures["ticks"] = float(n)
    figures |= solution_figures(timed.residual[:n], timed.status[:n])
    figures["active_set_changes"] = float(np.count_nonzero(timed.changed[:n]))
    figures["active_rows_mean"] = float(timed.active[:n].mean())
    figures["active_rows_max"] = float(timed.active[:n].max())
    figures["placo_failed"] = float(timed.placo_failed)
    return figures


class Tick(TimedBenchmark):
    """See the docstring of the module."""

    measure = staticmethod(measure)
