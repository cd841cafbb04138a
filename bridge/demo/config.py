"""Schema of ``bridge/config/demo.yaml``, which has the units."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT

Positive = Annotated[float, Field(gt=0.0)]


@dataclass(frozen=True, slots=True, config=STRICT)
class DemoConfig:
    """Steps and pass criteria of the demonstration; see ``bridge/config/demo.yaml``."""

    realtime_priority: Annotated[int, Field(ge=0, le=99)]
    start_limit: Positive
    quiet_time: Positive
    motions: tuple[str, ...]
    motion_limit: Positive
    pause: Positive
    push_force: tuple[float, float, float]
    push_duration: Positive
    recover_time: Positive
    poll_period: Positive
    real_time_min: Positive
    com_drift_limit: Positive
    foot_limit: Positive
    height_tolerance: Positive
    hand_travel: Positive
    squat_depth: Positive
    push_excursion: Positive
    square_side: Positive
    walk_limit: Positive
    walk_push: float
    walk_push_after: Positive
    closure_limit: Positive
    turn_tolerance: Positive
    drift_limit: Positive
    walk_wave_steps: Annotated[int, Field(ge=1)]
    walk_hand_travel: Positive
