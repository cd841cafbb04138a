"""The rows of ``poise bench faults``: what is done to the robot, and what it must do."""

from __future__ import annotations

from functools import cache
from typing import Annotated, Any, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass as schema

from benchmarks.push_search import Search
from models.config import STRICT, default_config

Positive = Annotated[float, Field(gt=0.0)]

KNEE = "{knee}"
"""Stands for the name of the left knee's joint."""


@schema(frozen=True, slots=True, config=STRICT)
class LoopChanges:
    """What differs from a plain closed loop; see ``ClosedLoop``.

    Attributes:
        friction: Coulomb coefficient [-].
        payload_kg: At the torso [kg].
        terrain: Name of the ground.
        misalignment: Of the inertial unit (3,) [rad].
        obstacle_stop: Whether the scanner stops a walk.
        profile: What differs in the profile of the robot, as the profile nests it.
        described_mass: Of the robot's first body, in parts of what it is, in a URDF that has changed since the laws
            were built from it [-].
    """

    friction: float | None = None
    payload_kg: float = 0.0
    terrain: str = "flat"
    misalignment: list[float] | None = None
    obstacle_stop: bool = False
    profile: dict[str, Any] = Field(default_factory=dict)
    described_mass: Positive = 1.0


@schema(frozen=True, slots=True, kw_only=True, config=STRICT)
class AnyRow:
    """One fault, in lockstep or of the graph.

    Attributes:
        group: Heading in the table.
        act: Name of what is done, besides ``faults``.
        within: Time for what is expected, for 'damps' and 'stands' [s].
        reason: Word in the reason that is told.
        walk: Whether the robot walks.
        duration: Watched from the fault on [s]; None for the usual time.
        mode: In which it must be afterwards; empty for that of before, or what is expected.
    """

    group: str
    act: str = ""
    within: Positive | None = None
    reason: str = ""
    walk: bool = False
    duration: Positive | None = None
    mode: str = ""


@schema(frozen=True, slots=True, kw_only=True, config=STRICT)
class Row(AnyRow):
    """One fault in lockstep; acts are of ``benchmarks/fault_acts.py``, '{knee}' in a reason is the knee's name.

    Attributes:
        expect: What the robot must do.
        faults: As ``bridge.fault_plan`` reads them.
        loop: What differs from a plain closed loop.
        box: Whether a black box must be left.
    """

    expect: Literal["rides", "damps", "stands", "refuses"]
    faults: list[dict[str, Any]] = Field(default_factory=list)
    loop: LoopChanges = Field(default_factory=LoopChanges)
    box: bool = False


@schema(frozen=True, slots=True, config=STRICT)
class Margin:
    """A delay of all joint states that is looked for; see ``benchmarks/fault_margins.py``.

    Attributes:
        group: Heading in the table.
        required: It must ride through at least this delay [s].
        walk: Whether the robot walks.
    """

    group: str
    required: Positive
    walk: bool = False


@schema(frozen=True, slots=True, config=STRICT)
class FaultsConfig:
    """All rows; the unit of every value stands in ``benchmarks/config/faults.yaml``."""

    settle: Positive
    duration: Positive
    torque_step_limit: Positive
    forward: Positive
    delays: Search
    margins: dict[str, Margin]
    rows: dict[str, Row]


@cache
def config() -> FaultsConfig:
    """The packaged rows."""
    return default_config(FaultsConfig, "benchmarks", "faults")


def with_knee(value: Any, knee: str) -> Any:
    """A value of a row with the knee's name put in."""
    if isinstance(value, str):
        return value.replace(KNEE, knee)
    if isinstance(value, dict):
        return {key: with_knee(item, knee) for key, item in value.items()}
    return [with_knee(item, knee) for item in value] if isinstance(value, list) else value
