"""Schema of ``bridge/config/teleop.yaml``, where the unit of every value stands."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from bridge.loop_config import Positive
from models.config import STRICT

Axis = Literal["forward", "left", "turn"]

Deed = Literal["halt", "walk", "stand", "wave", "E-STOP", "quit"]
"""What a key or a button does at once."""

Move = Literal["forward", "backward", "left", "right", "turn left", "turn right"]
"""What a key does to the velocity."""


@dataclass(frozen=True, slots=True, config=STRICT)
class GamepadConfig:
    """Axes and buttons by the kernel's numbers.

    Attributes:
        axes: Number of the axis of each velocity.
        deadband: Smaller deflections are none, in parts of the full one [-].
        buttons: What each button does.
    """

    axes: Annotated[dict[Axis, Annotated[int, Field(ge=0)]], Field(min_length=3)]
    deadband: Annotated[float, Field(ge=0.0, lt=1.0)]
    buttons: dict[int, Deed]


@dataclass(frozen=True, slots=True, config=STRICT)
class TeleopConfig:
    """Keys, steps and rates; see ``bridge/config/teleop.yaml``.

    Attributes:
        rate: Of the velocities [Hz].
        idle: Without a key for so long the velocity goes to zero [s].
        keys: What each key does.
        steps: By how much a key changes a velocity [m/s], [m/s], [rad/s].
        gamepad: Axes and buttons.
    """

    rate: Positive
    idle: Positive
    keys: dict[Annotated[str, Field(min_length=1, max_length=1)], Move | Deed]
    steps: Annotated[dict[Axis, Positive], Field(min_length=3)]
    gamepad: GamepadConfig
