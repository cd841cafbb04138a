"""Schemas of ``closed_loop.yaml``, ``camera.yaml`` and ``robot_driver.yaml`` in ``bridge/config``."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, Fraction, Positive, Proportion, parse_config, parse_yaml, read_yaml
from models.errors import ConfigError
from models.profile import CameraSensor


@dataclass(frozen=True, slots=True, config=STRICT)
class LoopConfig:
    """Schema of ``bridge/config/closed_loop.yaml``, which has units and meanings."""

    hang_time: Positive
    average_time: Positive
    settle_time: Positive
    settle_limit: Positive
    load_window: Positive
    load_tolerance: Positive
    supervise_period: Positive
    fall_height: Fraction
    fall_tilt: Annotated[float, Field(gt=0.0, lt=3.15)]
    slip_load: Fraction
    record_period: Positive
    motion_limit: Positive
    hoist_height: Positive

    def __post_init__(self) -> None:
        if self.average_time > self.hang_time:
            raise ValueError(f"average_time {self.average_time} s is longer than hang_time {self.hang_time} s")
        if self.settle_limit <= self.settle_time:
            raise ValueError(f"settle_limit {self.settle_limit} s is not longer than settle_time {self.settle_time} s")


@dataclass(frozen=True, slots=True, config=STRICT)
class TargetConfig:
    """A ball that only appears in the images."""

    radius: Annotated[float, Field(gt=0, le=5)]  #: Radius of the ball of camera/target [m]
    colour: tuple[Proportion, Proportion, Proportion]  #: Its red, green and blue [-]


@dataclass(frozen=True, slots=True, config=STRICT)
class CameraConfig:
    """Contents of an image; 0 in one of the first four fields selects the profile's value."""

    width: Annotated[int, Field(ge=0, le=4096)]  #: Width of an image; 0: the profile's [pixel]
    height: Annotated[int, Field(ge=0, le=4096)]  #: Height of an image; 0: the profile's [pixel]
    horizontal_fov: Annotated[float, Field(ge=0, le=2.8)]  #: Horizontal field of view; 0: the profile's [rad]
    rate: Annotated[float, Field(ge=0, le=1000)]  #: Images per simulated second; 0: the profile's [Hz]
    near: Annotated[float, Field(gt=0, le=1)]  #: Nearest distance that is drawn [m]
    far: Annotated[float, Field(gt=1, le=1000)]  #: Farthest distance that is drawn [m]
    shadows: bool  #: Draw shadows; an image then takes two to three times as long
    target: TargetConfig

    def sensor(self, camera: CameraSensor) -> CameraSensor:
        """A profile's camera with the non-zero values of this record; ``ConfigError`` names a value out of range."""
        given = {name: getattr(self, name) for name in ("width", "height", "horizontal_fov", "rate")}
        return parse_config(
            CameraSensor, asdict(camera) | {name: value for name, value in given.items() if value}, "camera"
        )


@dataclass(frozen=True, slots=True, config=STRICT)
class FaultParameters:
    """Faults of a simulated plant."""

    plan: str  #: Faults from the release on: a file, a scenario, or YAML; empty for none


@dataclass(frozen=True, slots=True, config=STRICT)
class DriverConfig:
    """Schema of ``bridge/config/robot_driver.yaml``."""

    plant: str  #: The robot: mujoco, a name among the entry points of poise.plants, or module:Class
    plant_options: str  #: Arguments of a plant other than mujoco: YAML in braces, or a file; empty for none
    rate: Annotated[float, Field(ge=100.0, le=2000.0)]  #: Rate of the simulated drivers [Hz]
    sensor_rate: Annotated[float, Field(ge=0.0, le=2000.0)]  #: Rate of the sensors' topics; 0: in every tick [Hz]
    slow_rate: Annotated[float, Field(ge=1.0, le=1000.0)]  #: Rate of /clock and /ground_truth/odom [Hz]
    #: Age of the sensors above which a command computed from them is refused [s]
    command_age_max: Annotated[float, Field(ge=0.001, le=1.0)]
    latency_file: str  #: File for the measured latencies; empty for none
    lockstep: bool  #: The plant waits for the command of each tick; sensors are then reliable (for deterministic tests)
    speed: Annotated[float, Field(ge=0.01, le=1.0)]  #: Ratio of simulated to real time, without lockstep
    #: Whether simulated time waits for commands, supervisor and perception (yield) or follows the clock (strict)
    real_time: Literal["yield", "strict"]
    #: Age of the newest command above which simulated time waits [s]
    yield_lag: Annotated[float, Field(ge=0.001, le=1.0)]
    #: Age of the newest state received by the supervisor above which simulated time waits [s]
    yield_supervisor: Annotated[float, Field(ge=0.001, le=1.0)]
    #: Age of unfinished work of range sensors, mapper and ground planner above which simulated time waits [s]
    yield_perception: Annotated[float, Field(ge=0.01, le=1.0)]
    yield_max: Annotated[float, Field(ge=0.0, le=60.0)]  #: Longest wait; then time advances and drivers time out [s]
    seed: Annotated[int, Field(ge=0, le=2**63 - 1)]  #: Seed of the simulated sensors' noise
    sensor_noise: bool  #: Noise, bias and quantisation of the profile
    sensor_errors: str  #: Further errors of the simulated sensors: a file, or YAML; empty for none
    faults: FaultParameters
    terrain: str  #: Ground: a name of models/config/terrain.yaml, or flat
    payload: Annotated[float, Field(ge=0.0, le=100.0)]  #: Simulated mass that is not in the model [kg]
    place: tuple[float, float, float]  #: Start of the robot in a world of several robots: x [m], y [m], heading [rad]


def read_options(text: str) -> dict[str, Any]:
    """Options of a plant from YAML in braces or a file; ``ConfigError`` if unreadable, or if a key is not a string."""
    if not text.strip():
        return {}
    options = parse_yaml(text, "plant_options") if text.lstrip().startswith("{") else read_yaml(Path(text))
    for key in options:
        if not isinstance(key, str):
            raise ConfigError(f"plant_options: {key!r} is not the name of an argument")
    return options
