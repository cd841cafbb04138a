"""QPs of real ticks: recorded in the closed loop, kept in an archive, read again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from pydantic.dataclasses import dataclass as schema

from benchmarks.core.benchmark import Count, Positive, settings
from benchmarks.core.loops import advance, demand
from benchmarks.stability.exercise import exercise_config, push_forces
from bridge.closed_loop import ClosedLoop
from controllers.balance.controller import BalanceController
from controllers.qp.active_set import QP
from controllers.whole_body.controller import WholeBodyController
from models.config import STRICT
from models.errors import ConfigError, PoiseError
from models.types import Mode


@schema(frozen=True, slots=True, config=STRICT)
class QPConfig:
    """The test; the unit of every value stands in ``benchmarks/config/qp.yaml``."""

    rows: Count
    ticks: Count
    repeats: Count
    pause: Positive
    pushed_for: Positive
    walk_speed: Positive
    walk_for: Positive
    active_tolerances: tuple[Positive, ...]
    residual_max: Positive


qp_config = partial(settings, QPConfig, "qp")


@dataclass(frozen=True, slots=True)
class RecordedQP:
    """A problem of a tick in a scenario ('standing', 'single_support' or 'pushed'), and the tick's solution (nz,)."""

    scenario: str
    qp: QP
    solution: np.ndarray


def record(robot: str, seed: int, config: QPConfig) -> list[RecordedQP]:
    """Record problems of a robot that stands, that is pushed while it waves, and of single support while it walks.

    They come in runs of consecutive ticks, for solvers that start from their last answer.

    Raises:
        PoiseError: The robot falls, or does not walk.
    """
    loop = ClosedLoop(robot=robot, seed=seed, record=False)
    balance = loop.controller
    if not isinstance(balance, BalanceController):
        raise PoiseError(f"{robot}: the loop has another controller than the whole-body one")
    found: list[RecordedQP] = []
    for _ in range(config.rows):
        advance(loop, config.pause)
        found += _row("standing", loop, balance.whole_body, config)
    forces, push = push_forces(loop, exercise_config()), exercise_config()
    for k in range(config.rows):
        if loop.mode is Mode.STAND:
            demand(loop, push.motion)
        force = forces[k % len(forces)]
        loop.apply_push((force[0], force[1], force[2]), push.push_duration, push.push_body)
        advance(loop, config.pushed_for)
        found += _row("pushed", loop, balance.whole_body, config)
        advance(loop, push.push_period)
    loop.wait_motion()
    demand(loop, "walk")
    loop.set_velocity(config.walk_speed, 0.0, 0.0)
    advance(loop, config.walk_for)
    for _ in range(config.rows):
        end = loop.t + config.walk_for
        while sum(loop.stack.reference.contacts) != 1:
            advance(loop, config.pause)
            if loop.t > end:
                raise PoiseError(f"{robot} does not walk at {config.walk_speed} m/s")
        found += _row("single_support", loop, balance.whole_body, config)
        advance(loop, config.pause)
    return found


def _row(scenario: str, loop: ClosedLoop, whole_body: WholeBodyController, config: QPConfig) -> list[RecordedQP]:
    """Problems of the next ticks that have a solution."""
    found = []
    for _ in range(config.ticks):
        loop.step()
        qp, z = whole_body.problem, whole_body.solution.z
        if qp is not None and z is not None:
            found.append(RecordedQP(scenario, copied(qp), z.copy()))
    return found


def copied(qp: QP) -> QP:
    """A problem that the next tick does not overwrite."""
    return QP(qp.hessian.copy(), qp.gradient.copy(), qp.matrix.copy(), qp.lower.copy(), qp.upper.copy(), qp.soft.copy())


def write(path: Path, problems: Sequence[RecordedQP]) -> None:
    """Write problems as a NumPy archive."""
    arrays = {
        f"{index}/{name}": getattr(problem.qp, name) for index, problem in enumerate(problems) for name in QP._fields
    }
    arrays |= {f"{index}/solution": problem.solution for index, problem in enumerate(problems)}
    np.savez_compressed(path, allow_pickle=False, scenarios=np.array([p.scenario for p in problems]), **arrays)


def read(path: Path) -> list[RecordedQP]:
    """Read what ``write`` wrote; ``ConfigError`` when it is no such archive."""
    try:
        with np.load(path) as data:
            return [
                RecordedQP(
                    str(scenario), QP(*(data[f"{index}/{name}"] for name in QP._fields)), data[f"{index}/solution"]
                )
                for index, scenario in enumerate(data["scenarios"])
            ]
    except (OSError, KeyError, ValueError) as error:
        raise ConfigError(f"{path}: no archive of QPs: {error}") from error
