"""Schema of ``bridge/config/teleop.yaml``, which has units and meanings."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from bridge.plants.loop_config import Positive
from models.config import STRICT

Axis = Literal["forward", "left", "turn"]

Deed = Literal["halt", "walk", "stand", "wave", "E-STOP", "quit"]  #: Immediate action of a key or a button
Move = Literal["forward", "backward", "left", "right", "turn left", "turn right"]  #: Velocity change of a key


@dataclass(frozen=True, slots=True, config=STRICT)
class GamepadConfig:
    """Axes and buttons by the kernel's numbers; see ``bridge/config/teleop.yaml``."""

    axes: Annotated[dict[Axis, Annotated[int, Field(ge=0)]], Field(min_length=3)]
    deadband: Annotated[float, Field(ge=0.0, lt=1.0)]
    buttons: dict[int, Deed]


@dataclass(frozen=True, slots=True, config=STRICT)
class TeleopConfig:
    """Keys, steps and rates; see ``bridge/config/teleop.yaml``."""

    rate: Positive
    idle: Positive
    keys: dict[Annotated[str, Field(min_length=1, max_length=1)], Move | Deed]
    steps: Annotated[dict[Axis, Positive], Field(min_length=3)]
    gamepad: GamepadConfig
