"""An hour of random texts, velocities, pushes and invalid commands: no falls, latched faults or memory growth."""

import math
import sys
import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from typing import Literal

import numpy as np
from pydantic.dataclasses import dataclass as schema

from benchmarks.core.benchmark import Benchmark, Bound, at_most, settings
from benchmarks.core.harness import Case, Report
from benchmarks.core.loops import TorqueSteps
from benchmarks.core.machine import resident
from bridge.closed_loop import ClosedLoop
from models.config import STRICT, Positive, Proportion
from models.errors import CommandError
from models.types import Mode, Vector

Kind = Literal["velocity", "word", "push", "nonsense"]  # kinds of inputs to the robot

LONG_TEXT = "x" * 1_000_000


@schema(frozen=True, slots=True, config=STRICT)
class EnduranceConfig:
    """Settings of the hour; the units are in ``benchmarks/config/endurance.yaml``."""

    duration: Positive
    pause: tuple[Positive, Positive]
    velocity_share: Proportion
    push_time: Positive
    push_stand: Positive
    push_walk: Positive
    warm_up: Positive
    sample: Positive
    memory_limit: Positive
    torque_step_limit: Positive
    shares: dict[Kind, Proportion]
    words: list[str]


_config = partial(settings, EnduranceConfig, "endurance")


class _Crowd:
    def __init__(self, loop: ClosedLoop, seed: int) -> None:
        self._loop, self._rng = loop, np.random.default_rng([seed, 3600])
        limits = loop.gait.config.velocity
        self._fastest = _config().velocity_share * np.array([limits.forward, limits.lateral, limits.turn])
        self._slowest = -_config().velocity_share * np.array([limits.backward, limits.lateral, limits.turn])
        self._acts: dict[Kind, Callable[[], bool]] = {
            "velocity": lambda: self._walk(self._rng.uniform(self._slowest, self._fastest)),
            "word": lambda: self._say(str(self._rng.choice(_config().words))),
            "push": self._push,
            "nonsense": self._nonsense,
        }
        self.done: Counter[str] = Counter()
        self.last = ""

    def pause(self) -> float:
        """Return the time until the next act [s]."""
        return float(self._rng.uniform(*_config().pause))

    def act(self) -> None:
        shares = _config().shares
        kinds = list(shares)
        kind = kinds[int(self._rng.choice(len(kinds), p=list(shares.values())))]
        self.done[kind] += 1
        if not self._acts[kind]():
            self.done["refused"] += 1

    def _push(self) -> bool:
        loop, given = self._loop, _config()
        most = given.push_walk if loop.mode is Mode.WALK else given.push_stand
        angle, size = self._rng.uniform(0.0, 2.0 * math.pi), self._rng.uniform(0.0, most)
        force = loop.robot.mass * size / given.push_time
        self.last = f"push of {size:.2f} m/s towards {math.degrees(angle):.0f} degrees"
        loop.apply_push((force * math.cos(angle), force * math.sin(angle), 0.0), given.push_time)
        return True

    def _nonsense(self) -> bool:
        kind = self._rng.integers(3)
        return self._walk(np.full(3, np.nan)) if kind == 0 else self._say("fly" if kind == 1 else LONG_TEXT)

    def _say(self, word: str) -> bool:
        self.last = word[:16]
        return self._loop.command(word).accepted

    def _walk(self, velocity: Vector) -> bool:
        self.last = f"velocity {np.round(velocity, 2)}"
        try:
            self._loop.set_velocity(*velocity)
        except CommandError:
            return False
        return True


class _Hour:
    def __init__(self, robot: str, seed: int) -> None:
        self._loop, self._seed = ClosedLoop(robot, seed=seed, record=False), seed
        self._crowd, self._steps = _Crowd(self._loop, seed), TorqueSteps(self._loop)
        self._memory: list[tuple[float, float, int]] = []  # time [s], resident memory [MiB], allocated Python blocks
        self._modes: Counter[str] = Counter()
        self._ends: list[str] = []
        self._distance = 0.0

    def run(self) -> Case:
        """Run the whole hour."""
        given, loop = _config(), self._loop
        ticks, period = round(given.duration / loop.plant.period), loop.plant.period
        act_at = look_at = 0
        place = loop.truth.q[:2].copy()
        began = time.perf_counter()
        with self._steps.watch():
            for tick in range(ticks):
                if tick >= act_at:
                    self._crowd.act()
                    act_at = tick + round(self._crowd.pause() / period)
                loop.step()
                self._modes[loop.mode.value] += 1
                if loop.fallen or loop.faults:
                    self._start_over(tick * period)
                    place = loop.truth.q[:2].copy()
                if tick >= look_at:
                    look_at += round(given.sample / period)
                    self._distance += float(np.linalg.norm(loop.truth.q[:2] - place))
                    place = loop.truth.q[:2].copy()
                    self._look(tick * period)
        return self._outcome(ticks, ticks * period / (time.perf_counter() - began))

    def _start_over(self, t: float) -> None:
        reason = self._loop.fall_reason or self._loop.faults[0]
        self._ends.append(f"at {t:.1f} s, after {self._crowd.last}: {reason}")
        self._loop.reset(self._seed + len(self._ends))
        self._steps.forget()

    def _look(self, t: float) -> None:
        self._loop.events.clear()  # not used here
        self._memory.append((t, resident("self"), sys.getallocatedblocks()))

    def _outcome(self, ticks: int, speed: float) -> Case:
        given, done = _config(), self._crowd.done
        late = [row for row in self._memory if row[0] >= given.warm_up] or self._memory[-1:]
        growth = max(row[1] for row in late) - late[0][1]
        return {
            **{kind: done[kind] for kind in (*given.shares, "refused")},
            "ends": self._ends,
            "modes": {mode: count / ticks for mode, count in self._modes.items()},
            "distance": self._distance,
            "memory": self._memory,
            "memory_growth": growth,
            "torque_step": self._steps.largest,
            "real_time_factor": speed,
            "ok": not self._ends and growth <= given.memory_limit and self._steps.within(given.torque_step_limit),
        }


def hour(robot: str, seed: int) -> Case:
    """Run one robot for the hour; ``ends`` has one sentence per fall or latched fault."""
    return _Hour(robot, seed).run()


class Endurance(Benchmark):
    """One hour for every seed."""

    measure = staticmethod(hour)

    def figures(self, cases: list[Case]) -> dict[str, float]:
        return {
            "hours": len(cases) * _config().duration / 3600.0,
            "falls_and_faults": float(sum(len(case["ends"]) for case in cases)),
            **{kind: float(sum(case[kind] for case in cases)) for kind in (*_config().shares, "refused")},
            "distance_m": sum(case["distance"] for case in cases),
            "memory_growth_mib": max(case["memory_growth"] for case in cases),
            "torque_step_max": max(case["torque_step"] for case in cases),
            "real_time_factor": min(case["real_time_factor"] for case in cases),
        }

    def bounds(self, report: Report) -> dict[str, Bound]:
        given = _config()
        limits = {"memory_growth_mib": given.memory_limit, "torque_step_max": given.torque_step_limit}
        return at_most({"falls_and_faults": 0.0, **limits})

    def notes(self, report: Report) -> list[str]:
        return [f"seed {case['seed']} {end}" for case in report.cases for end in case["ends"]]
