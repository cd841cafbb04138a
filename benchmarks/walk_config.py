"""What the walking test asks for: schema of ``config/walk.yaml``."""

from __future__ import annotations

from functools import cache
from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass as schema

from benchmarks.walk_measure import Velocity
from models.config import STRICT, default_config
from models.errors import ConfigError

Positive = Annotated[float, Field(gt=0.0)]


@schema(frozen=True, slots=True, config=STRICT)
class RobotWalk:
    """What one robot is asked for; see ``benchmarks/config/walk.yaml``."""

    scenarios: dict[str, Velocity]
    random: bool
    top_speeds: tuple[Positive, ...]
    required_top_speed: Positive

    @property
    def names(self) -> tuple[str, ...]:
        """Every scenario that can be chosen."""
        return (*self.scenarios, *(("random",) if self.random else ()), "stop", "top")


@schema(frozen=True, slots=True, config=STRICT)
class WalkConfig:
    """The walking test; the unit of every value stands in ``benchmarks/config/walk.yaml``."""

    duration: Positive
    start_time: Positive
    window: Positive
    chunk: Positive
    record_period: Positive
    shown: Positive
    random_period: Positive
    random_share: Annotated[float, Field(gt=0.0, le=1.0)]
    speed_error_limit: Positive
    top_duration: Positive
    top_tolerance: Positive
    stop_speed: Positive
    stop_after: Positive
    stop_limit: Positive
    stop_steps: Annotated[int, Field(ge=1)]
    stand_time: Positive
    stand_drift_limit: Positive
    robots: dict[str, RobotWalk]


@cache
def walk_config() -> WalkConfig:
    """The packaged test."""
    return default_config(WalkConfig, "benchmarks", "walk")


def robot_walk(name: str) -> RobotWalk:
    """What a robot is asked for.

    Raises:
        ConfigError: Nothing is written for it.
    """
    robots = walk_config().robots
    if name not in robots:
        raise ConfigError(f"bench walk: no scenarios for '{name}'; known: {', '.join(robots)}")
    return robots[name]
