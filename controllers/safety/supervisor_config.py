"""Schema of ``controllers/config/supervisor.yaml``."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT


@dataclass(frozen=True, slots=True, config=STRICT)
class SupervisorConfig:
    """Limits and vocabulary of the mode machine; every field is documented with its unit."""

    motions: Annotated[tuple[str, ...], Field(description="Text commands that are planned as motions")]
    walking_motions: Annotated[tuple[str, ...], Field(description="Motions of arms and head alone, while walking")]
    fall_tilt: Annotated[float, Field(gt=0, le=3.1, description="Base tilt that counts as a fall [rad]")]
    state_timeout: Annotated[float, Field(gt=0, le=2.0, description="Oldest usable state estimate [s]")]
    coasting_max: Annotated[float, Field(gt=0, le=1.0, description="Longest drop-out of the IMU or the joints [s]")]
    controller_timeout: Annotated[float, Field(gt=0, le=2.0, description="Oldest usable command [s]")]
    heartbeat_timeout: Annotated[float, Field(gt=0.3, le=60, description="Longest silence of a node's diagnostics [s]")]
    overruns_max: Annotated[int, Field(gt=0, le=10000, description="Ticks in a row over their budget that damp [1]")]
    plan_timeout: Annotated[float, Field(gt=0, le=120, description="Longest wait for a motion to start [s]")]
    text_length_max: Annotated[int, Field(ge=16, le=4096, description="Longest text command read [characters]")]
    rate_tolerance: Annotated[float, Field(gt=0, lt=1, description="Accepted relative deviation of a rate [-]")]
    mass_tolerance: Annotated[float, Field(gt=0, lt=1, description="Accepted relative deviation of the mass [-]")]
    limit_margin: Annotated[float, Field(ge=0, le=1, description="Accepted excess over a joint limit [rad]")]
    text_speed: Annotated[float, Field(ge=0, le=3, description="Speed of 'forward' and 'backward' [m/s]")]
    text_side_speed: Annotated[float, Field(ge=0, le=3, description="Speed of 'left' and 'right' [m/s]")]
    text_turn: Annotated[float, Field(ge=0, le=6, description="Turning speed of 'turn' [rad/s]")]
    text_spin: Annotated[float, Field(ge=0, le=6, description="Turning speed of 'spin' [rad/s]")]
    preflight_tilt: Annotated[float, Field(gt=0, le=1.6, description="Largest base tilt at arming [rad]")]
