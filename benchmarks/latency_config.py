"""What ``poise bench latency`` measures under."""

from __future__ import annotations

from functools import cache
from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass as schema

from models.config import STRICT, default_config

Positive = Annotated[float, Field(gt=0.0)]
Count = Annotated[int, Field(ge=0)]


@schema(frozen=True, slots=True, config=STRICT)
class Scenario:
    """What goes on beside the robot that is measured.

    Attributes:
        rate: Of the sensors, and so of the laws [Hz]; physics and drivers stay at theirs.
        stress: Busy processes, kept on the last core.
        subscribers: Further processes that listen to every topic of the tick.
        record: Whether ``poise record`` runs.
        view: Whether ``poise view`` serves its page; no browser looks at it.
        walk: Whether the robot walks instead of standing.
        robots: Graphs at a time, each in a ROS domain of its own; the first one alone runs SCHED_FIFO.
        speed: Simulated over real time: more robots than the cores can carry otherwise [-].
        own_core: Whether bridge and control keep to a core each.
        stages: Whether the process of the laws notes when each stage ends.
    """

    rate: Positive = 1000.0
    stress: Count = 0
    subscribers: Count = 0
    record: bool = False
    view: bool = False
    walk: bool = False
    robots: Annotated[int, Field(ge=1)] = 1
    speed: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0
    own_core: bool = False
    stages: bool = True


@schema(frozen=True, slots=True, config=STRICT)
class LatencyConfig:
    """The test; the unit of every value stands in ``benchmarks/config/latency.yaml``."""

    duration: Positive
    floor_duration: Positive
    warm_up: Positive
    start_limit: Positive
    p50_bound: Positive
    p99_bound: Positive
    missed_bound: Positive
    walk_speed: Positive
    usual: tuple[str, ...]
    scenarios: dict[str, Scenario]


@cache
def latency_config() -> LatencyConfig:
    """The packaged test."""
    return default_config(LatencyConfig, "benchmarks", "latency")
