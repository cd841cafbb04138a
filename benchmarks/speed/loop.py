"""Speed of a complete closed loop on one core, as a multiple of real time, and its time by stage.

The robot stands, then walks, with sensor noise and delay, without a log. Each second runs three pieces in turn: the
plain loop, an equal loop with ticks split by stage (Python remains slower after patching), and the physics alone.
Ratios are of the same run. The speed is judged by processor time, without the garbage collector.
"""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from time import perf_counter_ns, process_time_ns, thread_time_ns
from typing import Any
from unittest.mock import patch

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from numpy.typing import NDArray
from pydantic.dataclasses import dataclass as schema

from benchmarks.core.benchmark import settings
from benchmarks.core.harness import Case, Report, percentiles
from benchmarks.core.loops import advance, keep_upright, start_walk
from benchmarks.core.timed_run import MICRO, QUANTILES, Stopwatch, TimedBenchmark, collector_off
from bridge.closed_loop import ClosedLoop
from bridge.loop.lockstep import PlantMonitor
from bridge.plants.world import BarePhysics
from controllers.safety.supervisor import Supervisor
from models.config import STRICT, Count, Positive
from models.nodes.realtime import each_thread

#: Parts of a tick of the loop: MuJoCo's step; sensor model; estimator; gait planner (walking only); whole-body
#: controller with its QP; joint drivers; supervisor and fall monitor (every tenth tick); the rest, such as delay line,
#: joint monitor and head
STAGES = ("physics", "sensors", "estimator", "planner", "whole_body", "drivers", "supervise", "rest")
PHYSICS, SENSORS, ESTIMATOR, PLANNER, WHOLE_BODY, DRIVERS, SUPERVISE, REST = range(len(STAGES))

PIECE = 1.0  # simulated duration of a piece [s]


@dataclass(frozen=True, slots=True)
class Span:
    """Wall time, processor time of all threads, and processor time of this thread [ns]."""

    wall: int
    process: int
    thread: int


def spanned(call: Callable[[], object]) -> Span:
    """Time a call."""
    thread, process, wall = thread_time_ns(), process_time_ns(), perf_counter_ns()
    call()
    end = perf_counter_ns()
    return Span(end - wall, process_time_ns() - process, thread_time_ns() - thread)


@contextmanager
def one_core() -> Iterator[None]:
    """Pin every thread of this process to its last core; interrupts tend to use the first core."""
    allowed = os.sched_getaffinity(0)
    before: dict[int, set[int]] = {}
    each_thread(lambda thread: before.update({thread: os.sched_getaffinity(thread)}))
    try:
        each_thread(lambda thread: os.sched_setaffinity(thread, {max(allowed)}))
        yield
    finally:
        each_thread(lambda thread: os.sched_setaffinity(thread, before.get(thread, allowed)))


class SplitLoop:
    """Times the ticks of a loop by stage; the clock calls take some microseconds per tick, counted in ``rest``."""

    def __init__(self, loop: ClosedLoop, ticks: int) -> None:
        self._loop = loop
        self.watch = Stopwatch(ticks, 1)  #: Times of the whole ticks (ticks, 1)
        #: Wall-clock time of ``STAGES``, which add up to the tick (ticks, 8) [ns]
        self.stages = np.zeros((ticks, len(STAGES)), dtype=np.int64)
        self.count = 0  #: Number of recorded ticks
        self._now = [0] * len(STAGES)
        self._nested = 0  # time of the stages nested in the present one [ns]

    @contextmanager
    def recording(self) -> Iterator[None]:
        """Split the ticks of ``step`` within the context."""
        loop = self._loop
        parts: list[tuple[Any, str, int]] = [
            (loop.plant, "step", PHYSICS),
            (loop.plant, "read", SENSORS),
            (loop.estimator, "step", ESTIMATOR),
            (loop.gait, "step", PLANNER),
            (loop.controller, "step", WHOLE_BODY),
            (loop.drivers, "command", DRIVERS),
            (loop.drivers, "step", DRIVERS),
            (loop.plant, "write", DRIVERS),
            (PlantMonitor, "update", SUPERVISE),  # patched in the class: the loop's instances are private
            (Supervisor, "update", SUPERVISE),
        ]
        with ExitStack() as stack:
            for owner, name, stage in parts:
                stack.enter_context(patch.object(owner, name, self._timed(getattr(owner, name), stage)))
            yield

    def _timed(self, call: Callable[..., Any], stage: int) -> Callable[..., Any]:
        now = self._now

        def timed(*arguments: Any) -> Any:
            before, self._nested = self._nested, 0
            start = perf_counter_ns()
            result = call(*arguments)
            time = perf_counter_ns() - start
            now[stage] += time - self._nested
            self._nested = before + time
            return result

        return timed

    def step(self) -> None:
        """Run one tick of the loop."""
        row, now = self.count, self._now
        now[:] = [0] * len(STAGES)
        self.watch.measure(row, 0, self._loop.step)
        now[REST] = int(self.watch.wall[row, 0]) - sum(now)
        self.stages[row] = now
        self.count += 1


@dataclass(frozen=True, slots=True)
class Pieces:
    """Times of a scenario, in pieces of ``PIECE``."""

    plain: list[Span]  #: Plain loop
    split: list[Span]  #: Loop with ticks split by stage
    bare: list[Span]  #: Physics alone
    ticks: NDArray[np.floating[Any]]  #: Times of the split ticks (n,) [us]
    kept: NDArray[np.bool_]  #: Ticks that the scheduler did not interrupt (n,)
    stages: NDArray[np.floating[Any]]  #: Time of ``STAGES`` in the split ticks (n, 8) [us]


def time_pieces(plain: ClosedLoop, watched: ClosedLoop, pieces: int, piece: float = PIECE) -> Pieces:
    """Time two equal loops, ``watched`` split by stage, ``pieces`` of each kind; ``PoiseError`` if a robot falls."""
    ticks = round(piece / watched.plant.period)
    split, bare = SplitLoop(watched, pieces * ticks), BarePhysics(watched.model, ticks)
    spans: tuple[list[Span], list[Span], list[Span]] = ([], [], [])

    def split_piece() -> None:
        for _ in range(ticks):
            split.step()
            bare.note(watched.data)

    for _ in range(pieces):
        spans[0].append(spanned(partial(advance, plain, piece)))
        bare.begin(watched.data)
        with split.recording():
            spans[1].append(spanned(split_piece))
        keep_upright(watched)
        bare.rewind()
        spans[2].append(spanned(bare.replay))
    wall = split.watch.wall[:, 0] * MICRO
    return Pieces(*spans, ticks=wall, kept=~split.watch.preempted[:, 0], stages=split.stages * MICRO)


SCENARIOS = ("stand", "walk")  # tasks of the robot, in this order


def stage_figure(stage: str, scenario: str) -> str:
    """Return the name of the figure of a stage, its mean over the ticks [us]."""
    return f"{stage}_{scenario}_us_mean"


def draw_stages(axes: Axes, reports: Sequence[Report]) -> None:
    """Draw the stages of a tick as stacked bars by robot and scenario, with the physics alone as a line."""
    bars = [(report, scenario) for report in reports for scenario in SCENARIOS]
    places = range(len(bars))
    bottoms = [0.0] * len(bars)
    for stage, colour in zip(STAGES, colormaps["tab10"].colors, strict=False):  # type: ignore[attr-defined]
        heights = [report.figures[stage_figure(stage, scenario)] for report, scenario in bars]
        axes.bar(places, heights, bottom=bottoms, color=colour, label=stage.replace("_", " "))
        bottoms = [bottom + height for bottom, height in zip(bottoms, heights, strict=True)]
    for place, (report, scenario) in zip(places, bars, strict=True):
        bare = report.figures[f"bare_physics_{scenario}_us"]
        axes.plot([place - 0.4, place + 0.4], [bare, bare], "k--", linewidth=0.8)
    axes.set_xticks(places, [f"{report.robot}\n{scenario}" for report, scenario in bars], fontsize=8)
    axes.set_ylabel("mean of a tick [us]; dashed: MuJoCo alone")
    axes.legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.0), reverse=True)  # from top to bottom, as bars


NANO = 1e-9  # nanoseconds to seconds


@schema(frozen=True, slots=True, config=STRICT)
class LoopBenchConfig:
    """Settings of the runs; the units are in ``benchmarks/config/loop.yaml``."""

    forward: float
    warm_up_stand: Positive
    warm_up_walk: Positive
    pieces: Count


loop_config = partial(settings, LoopBenchConfig, "loop")


def measure(robot: str, seed: int) -> Case:
    """Time a robot that stands, then walks; returns ``figures``, and ``quantiles`` [us] of the ticks per scenario."""
    config = loop_config()
    plain, watched = (ClosedLoop(robot=robot, seed=seed, record=False) for _ in range(2))
    found: dict[str, Pieces] = {}
    with one_core(), collector_off():
        for scenario in SCENARIOS:
            for loop in (plain, watched):
                if scenario == "walk":
                    start_walk(loop, config.forward)
                advance(loop, config.warm_up_walk if scenario == "walk" else config.warm_up_stand)
            found[scenario] = time_pieces(plain, watched, config.pieces)
    quantiles = {f"tick_{name}": np.percentile(pieces.ticks, QUANTILES).tolist() for name, pieces in found.items()}
    return {"figures": summarise(found), "quantiles": quantiles}


def summarise(found: Mapping[str, Pieces], piece: float = PIECE) -> dict[str, float]:
    """Compute the figures from pieces of ``piece`` [s]; ``ValueError`` if all ticks of a scenario were interrupted."""
    figures: dict[str, float] = {}
    for name, pieces in found.items():
        wall, cpu = (np.array([getattr(span, of) for span in pieces.plain]) for of in ("wall", "process"))
        bare = np.array([span.process for span in pieces.bare])
        watched = np.array([span.process for span in pieces.split])
        figures[f"core_share_{name}"] = share = float(np.median(cpu)) * NANO / piece
        figures[f"real_time_{name}_cpu"] = 1.0 / share
        figures[f"real_time_{name}"] = piece / (float(np.median(wall)) * NANO)
        figures[f"cpu_per_wall_{name}"] = float(cpu.sum() / wall.sum())
        figures[f"ratio_to_physics_{name}"] = float(np.median(cpu / bare))
        figures[f"split_over_plain_{name}"] = float(np.median(watched / cpu))
        figures[f"bare_physics_{name}_us"] = float(np.median(bare)) * MICRO * len(bare) / len(pieces.ticks)
        figures |= percentiles(pieces.ticks[pieces.kept], f"tick_{name}_us")
        figures[f"tick_{name}_ungated_us_p99"] = float(np.percentile(pieces.ticks, 99.0))
        figures[f"tick_{name}_us_mean"] = float(pieces.ticks[pieces.kept].mean())
        means = pieces.stages[pieces.kept].mean(axis=0)
        figures |= {stage_figure(stage, name): float(mean) for stage, mean in zip(STAGES, means, strict=True)}
    plain = [span for pieces in found.values() for span in pieces.plain]
    process, own = sum(span.process for span in plain), sum(span.thread for span in plain)
    figures["other_threads_share"] = max(1.0 - own / process, 0.0)
    figures["preempted_fraction"] = 1.0 - float(np.concatenate([pieces.kept for pieces in found.values()]).mean())
    return figures


class Loop(TimedBenchmark):
    """See the docstring of the module."""

    measure = staticmethod(measure)

    def notes(self, report: Report) -> list[str]:
        speeds = (
            f"{name} {report.figures[f'real_time_{name}_cpu']:.2f} and {report.figures[f'real_time_{name}']:.2f}"
            for name in SCENARIOS
        )
        judged = (
            f"real-time factor without a log, by processor time (with the bound) and by the clock: {'; '.join(speeds)}"
        )
        return [*super().notes(report), judged]
