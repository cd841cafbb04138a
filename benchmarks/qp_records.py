"""QPs of real ticks: recorded in the closed loop, kept in an archive, read again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass as schema

from benchmarks.commands import advance, demand
from benchmarks.tick import push_forces, tick_config
from bridge.closed_loop import ClosedLoop
from controllers.balance import BalanceController
from controllers.qp.build import QP
from controllers.whole_body import WholeBodyController
from models.config import STRICT, default_config
from models.errors import ConfigError, PoiseError
from models.types import Mode

FIELDS = ("hessian", "gradient", "matrix", "lower", "upper", "soft")
"""Arrays of a QP that the archive keeps."""


Positive = Annotated[float, Field(gt=0.0)]
Count = Annotated[int, Field(ge=1)]


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
    options: dict[str, dict[str, Any]]


@cache
def qp_config() -> QPConfig:
    """The packaged test."""
    return default_config(QPConfig, "benchmarks", "qp")


@dataclass(frozen=True, slots=True)
class RecordedQP:
    """A problem of a tick.

    Attributes:
        scenario: What the robot did: 'standing', 'single_support' or 'pushed'.
        qp: The problem.
        solution: What the tick's own solver answered (nz,).
    """

    scenario: str
    qp: QP
    solution: np.ndarray


def record(robot: str, seed: int, config: QPConfig) -> list[RecordedQP]:
    """Record problems of a robot that stands, that is pushed while it waves, and of single support while it walks.

    They come in rows of consecutive ticks, as a solver that starts from its last answer meets them.

    Args:
        robot: Name of the profile.
        seed: Seed of the sensor noise.
        config: How many, and when.

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
    forces, push = push_forces(loop, tick_config()), tick_config()
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
        while sum(loop.walker.reference.contacts) != 1:
            advance(loop, config.pause)
            if loop.t > end:
                raise PoiseError(f"{robot} does not walk at {config.walk_speed} m/s")
        found += _row("single_support", loop, loop.walker.controller.whole_body, config)
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
    arrays = {f"{index}/{name}": getattr(problem.qp, name) for index, problem in enumerate(problems) for name in FIELDS}
    arrays |= {f"{index}/solution": problem.solution for index, problem in enumerate(problems)}
    np.savez_compressed(path, allow_pickle=False, scenarios=np.array([p.scenario for p in problems]), **arrays)


def read(path: Path) -> list[RecordedQP]:
    """Read what ``write`` wrote.

    Raises:
        ConfigError: The file is no such archive.
    """
    try:
        with np.load(path) as data:
            return [
                RecordedQP(str(scenario), QP(*(data[f"{index}/{name}"] for name in FIELDS)), data[f"{index}/solution"])
                for index, scenario in enumerate(data["scenarios"])
            ]
    except (OSError, KeyError, ValueError) as error:
        raise ConfigError(f"{path}: no archive of QPs: {error}") from error
