"""Schema of ``models/config/mujoco.yaml``: floor, solver and pictures of the simulated world."""

from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, NonNegative, Positive

Count = Annotated[int, Field(ge=2)]


@dataclass(frozen=True, slots=True, config=STRICT)
class ContactConfig:
    """Contact of robot and floor; units in the YAML file."""

    corner_radius: Positive
    sole_points: tuple[Count, Count]
    torsional_friction: NonNegative
    rolling_friction: NonNegative
    time_constant: Positive
    damping_ratio: Positive
    impedance: tuple[float, float, float]


@dataclass(frozen=True, slots=True, config=STRICT)
class SpringConfig:
    """Stiffness of a constraint as MuJoCo's solref; units in the YAML file."""

    time_constant: Positive
    damping_ratio: Positive


@dataclass(frozen=True, slots=True, config=STRICT)
class SceneConfig:
    """Camera, light and floor of pictures; units in the YAML file."""

    camera_offset: tuple[float, float, float]
    camera_height_target: float
    light_height: Positive
    checker_size: Positive
    shadow_range: Positive


@dataclass(frozen=True, slots=True, config=STRICT)
class PlantConfig:
    """Settings of the simulated world; see ``models/config/mujoco.yaml``."""

    integrator: Literal["implicitfast", "Euler"]
    friction_hardness: Positive
    contact: ContactConfig
    joint_limits: SpringConfig
    hold: SpringConfig
    payload_radius: Positive
    scene: SceneConfig
