"""Schema of ``bridge/config/actions.yaml``."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT


@dataclass(frozen=True, slots=True, config=STRICT)
class ActionsConfig:
    """How long the actions wait, and what they take for rest."""

    period: Annotated[float, Field(ge=0.01, le=1.0, description="Between two looks at what has happened [s]")]
    answer_timeout: Annotated[
        float, Field(gt=0.0, le=600.0, description="Longest wait for the answer of a service or the gait planner [s]")
    ]
    start_timeout: Annotated[
        float, Field(gt=0.0, le=600.0, description="Longest wait for a motion to start, planning included [s]")
    ]
    halt_timeout: Annotated[
        float, Field(gt=0.0, le=600.0, description="Longest wait for a motion that is stopped to slow down [s]")
    ]
    walk_timeout: Annotated[float, Field(gt=0.0, description="Longest walk to one goal [s]")]
    stand_timeout: Annotated[
        float, Field(gt=0.0, le=600.0, description="Longest wait for a standstill after the last footstep [s]")
    ]
    goal_period: Annotated[
        float, Field(gt=0.0, le=60.0, description="Between two publications of a goal until it is answered [s]")
    ]
    words: Annotated[int, Field(ge=10, le=10000, description="Words of a topic that are remembered [1]")]
    quiet: Annotated[int, Field(ge=1, le=100, description="Looks without motion after which it is at rest [1]")]
    moved: Annotated[float, Field(gt=0.0, le=0.1, description="Change of a joint between looks that is a motion [rad]")]
