"""Schema of ``bridge/config/view.yaml``, which has the units."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from bridge.plants.loop_config import Positive
from models.config import STRICT


@dataclass(frozen=True, slots=True, config=STRICT)
class ViewConfig:
    """Rates and contents of the page; see ``bridge/config/view.yaml``."""

    rate: Positive
    plot_rate: Positive
    plot_window: Positive
    force_scale: Positive
    force_least: Positive
    drive_idle: Positive
    drive_rate: Positive
    push_force_max: Positive
    torques: Annotated[int, Field(ge=1)]
    answer_timeout: Positive
