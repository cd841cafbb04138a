"""Schema of ``bridge/config/camera.yaml``."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, parse_config
from models.profile import CameraSensor

Share = Annotated[float, Field(ge=0, le=1)]


@dataclass(frozen=True, slots=True, config=STRICT)
class TargetConfig:
    """A ball that is in the pictures only."""

    radius: Annotated[float, Field(gt=0, le=5, description="Radius of the ball of camera/target [m]")]
    colour: Annotated[tuple[Share, Share, Share], Field(description="Its red, green and blue [-]")]


@dataclass(frozen=True, slots=True, config=STRICT)
class CameraConfig:
    """Contents of a picture; a zero among the first four stands for the profile's value."""

    width: Annotated[int, Field(ge=0, le=4096, description="Of a picture; 0: the profile's [pixel]")]
    height: Annotated[int, Field(ge=0, le=4096, description="Of a picture; 0: the profile's [pixel]")]
    horizontal_fov: Annotated[float, Field(ge=0, le=2.8, description="Of a picture; 0: the profile's [rad]")]
    rate: Annotated[float, Field(ge=0, le=1000, description="Pictures a simulated second; 0: the profile's [Hz]")]
    near: Annotated[float, Field(gt=0, le=1, description="What is nearer is not drawn [m]")]
    far: Annotated[float, Field(gt=1, le=1000, description="What is farther is not drawn [m]")]
    shadows: Annotated[bool, Field(description="Draw shadows, which takes two to three times as long")]
    target: TargetConfig

    def sensor(self, camera: CameraSensor) -> CameraSensor:
        """The camera of a profile with the values given here; ``ConfigError`` names a value out of range."""
        given = {name: getattr(self, name) for name in ("width", "height", "horizontal_fov", "rate")}
        return parse_config(
            CameraSensor, asdict(camera) | {name: value for name, value in given.items() if value}, "camera"
        )
