"""Times the whole-body tick inside the closed loop, tick by tick beside its peers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import permutations
from time import perf_counter_ns
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.core.harness import percentiles
from benchmarks.core.loops import advance, demand
from benchmarks.core.timed_run import Stopwatch, collector_off
from benchmarks.speed.tick_peers import KinematicPeer, PinocchioCalls, PlacoTick
from bridge.closed_loop import ClosedLoop
from controllers.balance.controller import BalanceController
from controllers.qp.terms import Terms
from controllers.whole_body.controller import WholeBodyController
from models.robot_model import RobotModel
from models.types import ControlResult, JointTrajectory, Reference, RobotState, SolveStatus

#: What is timed on every tick: ours, placo's, the few calls that ours is left with, and all calls for its terms
SUBJECTS = ("tick", "placo", "own_calls", "pinocchio_calls")


def orders(subjects: int) -> tuple[tuple[int, ...], ...]:
    """Orders that the ticks go through in turn: what ran before decides what is in the caches."""
    return tuple(permutations(range(subjects)))


#: Parts of the tick: model terms; footholds, motion, references and feedback; QP; solution; torques; set-point
STAGES = ("terms", "references", "build", "solve", "recover", "rest")
STATUSES = tuple(SolveStatus)


def solution_figures(residual: NDArray[np.float64], status: NDArray[np.int64]) -> dict[str, float]:
    """Figures of the QPs, from KKT residuals (ticks,) [-] and indices into ``STATUSES`` (ticks,)."""
    figures = {"kkt_residual_max": float(residual.max())}
    for index, name in enumerate(STATUSES):
        figures[f"ticks_{name.value}"] = float(np.count_nonzero(status == index))
    certified = (SolveStatus.OPTIMAL, SolveStatus.FALLBACK_SOLVER)
    figures["ticks_uncertified"] = len(status) - sum(figures[f"ticks_{name.value}"] for name in certified)
    return figures


class StageProbe:
    """Records when each stage of a tick begins and ends, while attached, by wrapping the stages' methods."""

    def __init__(self, whole_body: WholeBodyController) -> None:
        self._stamps = np.zeros(2 * 4, dtype=np.int64)
        stages: list[tuple[Any, str]] = [
            (whole_body.terms, "update"),
            (whole_body.builder, "build"),
            (whole_body.solver, "solve"),
            (whole_body.builder, "recover"),
        ]
        self._wrapped = [
            (owner, name, self._timed(getattr(owner, name), 2 * index)) for index, (owner, name) in enumerate(stages)
        ]

    def _timed(self, call: Callable[..., Any], slot: int) -> Callable[..., Any]:
        stamps = self._stamps

        def timed(*arguments: Any) -> Any:
            stamps[slot] = perf_counter_ns()
            result = call(*arguments)
            stamps[slot + 1] = perf_counter_ns()
            return result

        return timed

    def attach(self) -> None:
        """Time the stages from now on."""
        self._stamps[:] = 0
        for owner, name, timed in self._wrapped:
            setattr(owner, name, timed)

    def detach(self) -> None:
        """Leave the controller as it was."""
        for owner, name, _ in self._wrapped:
            delattr(owner, name)

    def durations(self, total: int) -> NDArray[np.int64]:
        """Time of each of ``STAGES`` on the last tick, which took ``total`` [ns]."""
        stamps = self._stamps
        terms, build, solve, recover = (int(stamps[2 * i + 1] - stamps[2 * i]) for i in range(4))
        references = int(stamps[2] - stamps[1])
        return np.array(
            [terms, references, build, solve, recover, total - terms - references - build - solve - recover]
        )


class TimedController:
    """A ``BalanceController`` that times each tick, and the peers at the same state before or after it.

    Every ``stage_period`` ticks one is split by stage. A row within ``active_tolerance`` of its bound, relative to its
    size, is active [-]. ``kinematic`` are other inverse kinematics, by name.

    Attributes:
        subjects: ``SUBJECTS`` and the names of ``kinematic``.
        controller: The timed controller.
        peers: Whether the peers run too.
        recording: Whether samples are kept.
        count: Ticks recorded.
        wall, cpu, preempted: Of ``Stopwatch`` (ticks, subjects).
        stages: Time of each of ``STAGES`` (ticks, 6) [ns]; zero on ticks that were not split.
        residual: KKT residual (ticks,) [-].
        status: Index into ``STATUSES`` (ticks,).
        active: Active rows (ticks,).
        changed: Whether the set of active rows differs from that of the tick before (ticks,).
        placo_failed: Ticks on which placo found no solution.
    """

    def __init__(
        self,
        model: RobotModel,
        *,
        ticks: int,
        stage_period: int,
        active_tolerance: float,
        kinematic: Mapping[str, KinematicPeer] | None = None,
    ) -> None:
        self.controller = BalanceController(model)
        self._placo = PlacoTick(model, self.controller.whole_body.config)
        self._pinocchio = PinocchioCalls(model)
        self._terms = Terms(model)
        self._probe = StageProbe(self.controller.whole_body)
        self._period, self._tolerance = stage_period, active_tolerance
        self._calls: tuple[Callable[[], None], ...] = (
            self._own,
            self._placo.step,
            self._terms.call_pinocchio,
            self._call_pinocchio,
            *(peer.step for peer in (kinematic or {}).values()),
        )
        self._kinematic = list((kinematic or {}).values())
        self.subjects = (*SUBJECTS, *(kinematic or {}))
        self._orders = orders(len(self.subjects))
        self.peers, self.recording, self.count, self.placo_failed = True, False, 0, 0
        self._watch = watch = Stopwatch(ticks, len(self.subjects))
        self.wall, self.cpu, self.preempted = watch.wall, watch.cpu, watch.preempted
        self.stages = np.zeros((ticks, len(STAGES)), dtype=np.int64)
        self.residual = np.zeros(ticks)
        self.status = np.zeros(ticks, dtype=np.int64)
        self.active = np.zeros(ticks, dtype=np.int64)
        self.changed = np.zeros(ticks, dtype=bool)
        self._row = 0
        self._set = b""

    @property
    def motion_active(self) -> bool:
        """Whether a motion is being executed."""
        return self.controller.motion_active

    @property
    def reference(self) -> Reference:
        """What the last tick tracked."""
        return self.controller.reference

    def reset(self, state: RobotState) -> None:
        """Start over from a state."""
        self.controller.reset(state)
        self._started = False

    def follow(self, trajectory: JointTrajectory) -> None:
        """Start a motion."""
        self.controller.follow(trajectory)

    def stop_motion(self) -> None:
        """Hold the posture that the motion has reached."""
        self.controller.stop_motion()

    def step(self, state: RobotState, dt: float) -> ControlResult:
        """One tick of the controller, beside its peers."""
        self._state, self._dt = state, dt
        if not self.peers or not self._started:
            self._own()
            self._started = True
            return self._result
        # placo gets the references of the tick before: it may run first.
        self._placo.prepare(state, self.controller)
        self._terms.q[:], self._terms.v[:] = state.q, state.v
        for peer in self._kinematic:
            peer.prepare(state)
        row = self.count if self.recording else 0
        self._row += 1
        staged = self._row % self._period == 0
        if staged:
            self._probe.attach()
        for subject in self._orders[self._row % len(self._orders)]:
            self._watch.measure(row, subject, self._calls[subject])
        self.stages[row] = 0
        if staged:
            self._probe.detach()
            self.stages[row] = self._probe.durations(int(self.wall[row, 0]))
        if self.recording:
            self._judge(row)
            self.count += 1
        return self._result

    def _own(self) -> None:
        self._result = self.controller.step(self._state, self._dt)

    def _call_pinocchio(self) -> None:
        self._pinocchio.step(self._terms.q, self._terms.v)

    def _judge(self, row: int) -> None:
        """Residual, status and active rows of the tick; not timed."""
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


MODES = ("stand", "walk")  # of ``time_stack``, in this order


def time_stack(model: RobotModel, seed: int, *, warm_up: float, duration: float, speed: float) -> dict[str, float]:
    """Time the stack of a robot that stands, then walks at ``speed`` [m/s], for ``duration`` [s] each, without peers.

    Returns:
        ``stack_<mode>_us_p50``, ``_p99``, ... of the ticks that were not pre-empted.

    Raises:
        PoiseError: The robot fell, or would not walk.
    """
    loop = ClosedLoop(robot=model, seed=seed, record=False)
    figures: dict[str, float] = {}
    for mode in MODES:
        if mode == "walk":
            demand(loop, "walk")
            loop.set_velocity(speed, 0.0, 0.0)
        advance(loop, warm_up)
        watch = Stopwatch(round(duration / loop.plant.period) + 1, 2)
        with collector_off(), watch.timing(loop.stack, "step", 0), watch.timing(loop.stack, "supervise", 1):
            advance(loop, duration)
        figures |= percentiles(watch.times(0, 1), f"stack_{mode}_us")
    return figures
