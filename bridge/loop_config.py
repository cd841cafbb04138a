"""Settings of the closed loop that are not the robot's."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT

Positive = Annotated[float, Field(gt=0.0)]
Fraction = Annotated[float, Field(gt=0.0, lt=1.0)]


@dataclass(frozen=True, slots=True, config=STRICT)
class LoopConfig:
    """Schema of ``bridge/config/closed_loop.yaml``.

    Attributes:
        hang_time: Time held by the weld under gravity compensation, before the controller starts [s].
        average_time: End of it over which the sensors are averaged for the estimator's start [s].
        settle_time: Least time held by the weld with the controller active [s].
        settle_limit: Time after which a robot whose feet have not taken its weight is given up [s].
        load_window: Time over which the load on the feet is averaged [s].
        load_tolerance: Deviation of the load from the weight at which the weld lets go [1].
        supervise_period: Between two looks of the supervisor and of the fall and slip monitor [s].
        fall_height: Share of the standing height of the base below which the robot has fallen [1].
        fall_tilt: Tilt of the base beyond which the robot has fallen [rad].
        slip_load: Share of the weight above which a foot counts as standing [1].
        record_period: Between two rows of the log [s].
        motion_limit: Longest wait for a motion to end [s].
        max_command_age: Age of the sensors a command answers above which the bridge refuses it [s].
        hoist_height: How far the crane lifts the robot off the floor when it hangs [m].
    """

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
    max_command_age: Positive
    hoist_height: Positive

    def __post_init__(self) -> None:
        if self.average_time > self.hang_time:
            raise ValueError(f"average_time {self.average_time} s is longer than hang_time {self.hang_time} s")
        if self.settle_limit <= self.settle_time:
            raise ValueError(f"settle_limit {self.settle_limit} s is not longer than settle_time {self.settle_time} s")
