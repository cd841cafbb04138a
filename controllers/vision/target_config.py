"""Schema of ``controllers/config/vision.yaml``."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT

Degrees = Annotated[float, Field(ge=0.0, le=360.0)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]


@dataclass(frozen=True, slots=True, config=STRICT)
class TargetConfig:
    """Colour and size of the target.

    Attributes:
        hue_from: First hue of the target on the circle of colours: red is 0, green 120, blue 240 [deg].
        hue_to: Last hue; less than the first for a range that goes through 0 [deg].
        saturation_min: Least saturation: 0 is grey, 1 is pure colour [-].
        value_min: Least value: 0 is black, 1 is bright [-].
        pixels_min: Least size of the target [pixel].
    """

    hue_from: Degrees
    hue_to: Degrees
    saturation_min: Share
    value_min: Share
    pixels_min: Annotated[int, Field(ge=1)]
