"""Schema of ``controllers/config/obstacle_stop.yaml``."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT


@dataclass(frozen=True, slots=True, config=STRICT)
class ObstacleStopConfig:
    """Gaps, speeds and times of the obstacle stop; every field is documented with its unit."""

    stop_distance: Annotated[float, Field(gt=0, le=5, description="Gap at which the robot is to stand still [m]")]
    release_distance: Annotated[float, Field(gt=0, le=10, description="Gap from which on it may walk again [m]")]
    release_time: Annotated[float, Field(ge=0, le=60, description="For how long the gap must have been so long [s]")]
    margin: Annotated[float, Field(ge=0, le=2, description="Corridor beyond the body, each side [m]")]
    deceleration: Annotated[float, Field(gt=0, le=10, description="How fast a walk is counted on to slow down [m/s^2]")]
    reaction_time: Annotated[float, Field(ge=0, le=5, description="From a reading to the first effect [s]")]
    speed_min: Annotated[float, Field(gt=0, le=1, description="Slowest walk towards an obstacle [m/s]")]
    scan_timeout: Annotated[float, Field(gt=0, le=5, description="Oldest usable scan [s]")]
    points_min: Annotated[int, Field(ge=1, le=100, description="Readings that make an obstacle [1]")]

    def __post_init__(self) -> None:
        if self.release_distance <= self.latch_distance:
            raise ValueError(
                f"release_distance {self.release_distance} m is not beyond {self.latch_distance:.3f} m, "
                "where the robot stops"
            )

    @property
    def latch_distance(self) -> float:
        """Gap below which not even ``speed_min`` is allowed [m]."""
        return self.stop_distance + self.speed_min * (self.reaction_time + 0.5 * self.speed_min / self.deceleration)
