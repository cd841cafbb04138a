"""Settings of the closed loop that are independent of the robot."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT

Positive = Annotated[float, Field(gt=0.0)]
Fraction = Annotated[float, Field(gt=0.0, lt=1.0)]


@dataclass(frozen=True, slots=True, config=STRICT)
class LoopConfig:
    """Schema of ``bridge/config/closed_loop.yaml``, which has units and meanings."""

    hang_time: Positive
    average_time: Positive
    settle_time: Positive
    settle_limit: Positive
    load_window: Positive
    load_tolerance: Fraction
    supervise_period: Positive
    fall_height: Fraction
    fall_tilt: Annotated[float, Field(gt=0.0, lt=3.15)]
    slip_load: Fraction
    record_period: Positive
    motion_limit: Positive
    hoist_height: Positive

    def __post_init__(self) -> None:
        if self.average_time > self.hang_time:
            raise ValueError(f"average_time {self.average_time} s is longer than hang_time {self.hang_time} s")
        if self.settle_limit <= self.settle_time:
            raise ValueError(f"settle_limit {self.settle_limit} s is not longer than settle_time {self.settle_time} s")
