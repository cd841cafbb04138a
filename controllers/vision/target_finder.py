"""Finds a target by its colour in an image."""

import dataclasses
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, Count, Proportion, default_config
from models.errors import ConfigError
from models.types import Vector

_DEGREES_PER_HUE = 2.0  #: OpenCV counts hues of 8 bits in steps of two degrees
_NOISE_KERNEL = np.ones((3, 3), dtype=np.uint8)  #: Patches that do not contain this square are noise [pixel]

Degrees = Annotated[float, Field(ge=0.0, le=360.0)]


@dataclass(frozen=True, slots=True, config=STRICT)
class TargetConfig:
    """Schema of ``controllers/config/vision.yaml``: colour and size of the target."""

    hue_from: Degrees  #: First hue of the target on the circle of colours: red is 0, green 120, blue 240 [deg]
    hue_to: Degrees  #: Last hue; less than the first for a range through 0 [deg]
    saturation_min: Proportion  #: Least saturation: 0 is grey, 1 is pure colour [-]
    value_min: Proportion  #: Least value: 0 is black, 1 is bright [-]
    pixels_min: Count  #: Least size of the target [pixel]


@dataclasses.dataclass(frozen=True, slots=True)
class Sighting:
    """A target in an image."""

    pixel: Vector  # centroid, u to the right and v down (2,) [pixel]
    pixels: int  # area [pixel]
    whole: bool  # the patch does not touch the edge of the image; otherwise the centroid is not the target's


class TargetFinder:
    """Finds the largest connected patch of a colour, after removal of noise; ``ConfigError`` without OpenCV."""

    def __init__(self, config: TargetConfig | None = None) -> None:
        try:
            import cv2
        except ImportError as error:
            raise ConfigError("OpenCV is not installed: pip install 'poise[vision]'") from error
        self._cv2 = cv2
        self.config = config or default_config(TargetConfig, "controllers", "vision")
        low, high = self.config.hue_from / _DEGREES_PER_HUE, self.config.hue_to / _DEGREES_PER_HUE
        high += 180.0 * (high < low)
        hues = [(low, high), (low - 180.0, high - 180.0)]  # the second range covers hues beyond a full turn
        rest = 255.0 * self.config.saturation_min, 255.0 * self.config.value_min
        self._ranges = [(np.array([first, *rest]), np.array([last, 255.0, 255.0])) for first, last in hues]

    def find(self, picture: NDArray[np.uint8]) -> Sighting | None:
        """Find the target in an RGB image (height, width, 3); None when it is not in the image."""
        cv2 = self._cv2
        hsv = cv2.cvtColor(np.ascontiguousarray(picture), cv2.COLOR_RGB2HSV)
        mask = np.zeros(hsv.shape[:2], dtype=np.uint8)
        for low, high in self._ranges:
            mask |= cv2.inRange(hsv, low, high)
        mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, _NOISE_KERNEL)
        count, _, boxes, middles = cv2.connectedComponentsWithStats(mask)
        if count < 2:  # the first is the background
            return None
        best = 1 + int(np.argmax(boxes[1:, cv2.CC_STAT_AREA]))
        left, top, width, height, pixels = (int(value) for value in boxes[best])
        if pixels < self.config.pixels_min:
            return None
        whole = left > 0 and top > 0 and left + width < mask.shape[1] and top + height < mask.shape[0]
        return Sighting(np.array(middles[best], dtype=np.float64), pixels, whole)
