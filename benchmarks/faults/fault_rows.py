"""The rows of ``poise bench faults``: what is done to the robot, and what it must do."""

from __future__ import annotations

from functools import partial
from typing import Annotated, Any, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass as schema

from benchmarks.core.benchmark import Positive, settings
from benchmarks.core.fault_rows import AnyRow
from benchmarks.core.loops import Search
from models.config import STRICT

KNEE = "{knee}"  # stands for the name of the left knee's joint


@schema(frozen=True, slots=True, config=STRICT)
class LoopChanges:
    """Differences from a plain closed loop; see ``ClosedLoop``.

    Attributes:
        friction: Coulomb coefficient [-].
        payload_kg: At the torso [kg].
        terrain: Name of the ground.
        misalignment: Of the IMU (3,) [rad].
        obstacle_stop: Whether the scanner stops a walk.
        profile: Changed entries of the robot's profile, nested as there.
        described_mass: Mass of the robot's first body in the URDF, relative to the one the laws were built from [-].
    """

    friction: float | None = None
    payload_kg: float = 0.0
    terrain: str = "flat"
    misalignment: list[float] | None = None
    obstacle_stop: bool = False
    profile: dict[str, Any] = Field(default_factory=dict)
    described_mass: Positive = 1.0


@schema(frozen=True, slots=True, kw_only=True, config=STRICT)
class Row(AnyRow):
    """One fault in lockstep; acts are of ``benchmarks/faults/fault_acts.py``, '{knee}' in a reason is the knee's name.

    ``expect`` is the required reaction, ``faults`` are those of ``bridge.plants.fault_plan``, ``box`` requires a black
    box. A pushed robot steps first: where nothing can take the push, times count from its end, ``push`` [s] after the
    injection.
    """

    expect: Literal["rides", "damps", "stands", "refuses"]
    faults: list[dict[str, Any]] = Field(default_factory=list)
    loop: LoopChanges = Field(default_factory=LoopChanges)
    box: bool = False
    push: Annotated[float, Field(ge=0.0)] = 0.0


@schema(frozen=True, slots=True, config=STRICT)
class Margin:
    """A delay of all joint states to be found: the robot must ride through at least ``required`` [s]."""

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


config = partial(settings, FaultsConfig, "faults")


def with_knee(value: Any, knee: str) -> Any:
    """A value of a row with the knee's name put in."""
    if isinstance(value, str):
        return value.replace(KNEE, knee)
    if isinstance(value, dict):
        return {key: with_knee(item, knee) for key, item in value.items()}
    return [with_knee(item, knee) for item in value] if isinstance(value, list) else value
