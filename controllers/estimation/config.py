"""Schema of ``controllers/config/estimator.yaml``; the file holds the values, this holds units and bounds."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT


@dataclass(frozen=True, slots=True, config=STRICT)
class InertialNoise:
    """What the filter assumes of the inertial unit, vibration and sampling error included.

    Densities are two-sided: the error of one sample of length dt has the standard deviation density / sqrt(dt).
    """

    gyro_noise: Annotated[float, Field(gt=0.0, description="angular rate noise density [rad/s/sqrt(Hz)]")]
    accel_noise: Annotated[float, Field(gt=0.0, description="specific force noise density [m/s^2/sqrt(Hz)]")]
    gyro_bias_walk: Annotated[float, Field(gt=0.0, description="gyro bias random walk [rad/s/sqrt(s)]")]
    accel_bias_walk: Annotated[float, Field(gt=0.0, description="accelerometer bias random walk [m/s^2/sqrt(s)]")]
    gyro_bias: Annotated[float, Field(gt=0.0, description="initial std of the gyro bias [rad/s]")]
    accel_bias: Annotated[float, Field(gt=0.0, description="initial std of the accelerometer bias [m/s^2]")]
    coast_factor: Annotated[float, Field(ge=1.0, description="noise multiplier while samples are missing [-]")]


@dataclass(frozen=True, slots=True, config=STRICT)
class KinematicNoise:
    """What the filter assumes of the sole pose computed from the encoders, per sample."""

    encoder_steps: Annotated[float, Field(ge=0.0, description="white noise of a joint position, in encoder steps [-]")]
    position: Annotated[float, Field(gt=0.0, description="model error of a sole position [m]")]
    orientation: Annotated[float, Field(gt=0.0, description="model error of a sole orientation [rad]")]


@dataclass(frozen=True, slots=True, config=STRICT)
class ContactConfig:
    """Contact detection: loads are fractions of the robot's weight."""

    load_on: Annotated[float, Field(gt=0.0, lt=1.0, description="load above which a foot makes contact [-]")]
    load_off: Annotated[float, Field(gt=0.0, lt=1.0, description="load below which a foot breaks contact [-]")]
    load_full: Annotated[float, Field(gt=0.0, lt=1.0, description="load from which a foot is fully trusted [-]")]
    on_delay: Annotated[float, Field(ge=0.0, description="time above load_on before contact is made [s]")]
    edge_margin: Annotated[
        float,
        Field(
            gt=0.0,
            le=1.0,
            description="distance of the CoP from an edge below which a foot may tip, "
            "as a fraction of half the sole [-]",
        ),
    ]

    def __post_init__(self) -> None:
        if not self.load_off < self.load_on < self.load_full:
            raise ValueError(f"load_off {self.load_off} < load_on {self.load_on} < load_full {self.load_full} required")


@dataclass(frozen=True, slots=True, config=STRICT)
class FootNoise:
    """Random walk of a foot, interpolated geometrically between its states by the contact's confidence."""

    slip: Annotated[float, Field(gt=0.0, description="position, foot bearing [m/sqrt(s)]")]
    swing: Annotated[float, Field(gt=0.0, description="position, foot in the air [m/sqrt(s)]")]
    flat: Annotated[float, Field(gt=0.0, description="orientation, sole flat on the ground [rad/sqrt(s)]")]
    tipping: Annotated[float, Field(gt=0.0, description="orientation, CoP at an edge [rad/sqrt(s)]")]
    swing_rotation: Annotated[float, Field(gt=0.0, description="orientation, foot in the air [rad/sqrt(s)]")]


@dataclass(frozen=True, slots=True, config=STRICT)
class RestConfig:
    """Zero-velocity update while no foot bears and the inertial unit is quiet (hung up, or held by the simulator)."""

    gyro: Annotated[float, Field(gt=0.0, description="angular rate below which it is quiet [rad/s]")]
    accel: Annotated[float, Field(gt=0.0, description="deviation of |specific force| from gravity [m/s^2]")]
    velocity: Annotated[float, Field(gt=0.0, description="std of the assumed zero velocity [m/s]")]
    accel_at_reset: Annotated[
        float, Field(gt=0.0, lt=1.0, description="deviation of |specific force| / gravity from 1 refused at start [-]")
    ]


@dataclass(frozen=True, slots=True, config=STRICT)
class InitialConfig:
    """Initial standard deviations besides those that follow from the sensors."""

    velocity: Annotated[float, Field(gt=0.0, description="base velocity [m/s]")]
    force: Annotated[float, Field(gt=0.0, description="first specific force, vibration included [m/s^2]")]
    floor: Annotated[float, Field(gt=0.0, description="slope of the floor under the first stance [rad]")]
    heading: Annotated[float, Field(gt=0.0, description="yaw; a convention, so small [rad]")]
    position: Annotated[float, Field(gt=0.0, description="base position; a convention, so small [m]")]


@dataclass(frozen=True, slots=True, config=STRICT)
class EstimatorConfig:
    """Everything the state estimator is tuned by."""

    gravity: Annotated[float, Field(gt=0.0, description="[m/s^2]")]
    gate: Annotated[
        float, Field(gt=0.0, description="normalised innovation squared above which a sole is weighed down [-]")
    ]
    imu: InertialNoise
    kinematics: KinematicNoise
    contact: ContactConfig
    foot: FootNoise
    rest: RestConfig
    initial: InitialConfig
