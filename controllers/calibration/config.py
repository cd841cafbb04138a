"""Schema of ``controllers/config/calibration.yaml``; the file holds the values, this holds units and bounds."""

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT

Share = Annotated[float, Field(gt=0.0, lt=1.0)]


@dataclass(frozen=True, slots=True, config=STRICT)
class RestConfig:
    """Criteria of rest, on means over ``window``."""

    joint_speed: Annotated[float, Field(gt=0.0, description="largest joint speed [rad/s]")]
    joint_drift: Annotated[float, Field(gt=0.0, description="largest change of a joint position in all [rad]")]
    gyro_spread: Annotated[float, Field(gt=0.0, description="standard deviation of the angular rate [rad/s]")]
    accel_spread: Annotated[float, Field(gt=0.0, description="standard deviation of the specific force [m/s^2]")]


@dataclass(frozen=True, slots=True, config=STRICT)
class ImuConfig:
    """Calibration of the IMU."""

    time: Annotated[float, Field(gt=0.0, description="time to average over [s]")]
    min_time: Annotated[float, Field(gt=0.0, description="less is refused [s]")]
    min_samples: Annotated[int, Field(ge=2, description="fewer are refused [1]")]
    drift: Annotated[float, Field(gt=0.0, description="largest change of the mean rate between both halves [rad/s]")]
    norm_error: Annotated[float, Field(gt=0.0, lt=0.5, description="deviation of |specific force| from gravity [-]")]


@dataclass(frozen=True, slots=True, config=STRICT)
class ChainConfig:
    """Calibration of the encoders from the closed chain through both soles."""

    prior: Annotated[float, Field(gt=0.0, description="standard deviation of an offset before any data [rad]")]
    slide: Annotated[float, Field(gt=0.0, description="std of the horizontal distance between the soles [m]")]
    turn: Annotated[float, Field(gt=0.0, description="std of the yaw between them [rad]")]
    slide_walk: Annotated[float, Field(ge=0.0, description="creeping of that distance [m/sqrt(s)]")]
    turn_walk: Annotated[float, Field(ge=0.0, description="creeping of that yaw [rad/sqrt(s)]")]
    height: Annotated[float, Field(gt=0.0, description="std of their difference in height [m]")]
    tilt: Annotated[float, Field(gt=0.0, description="std of the angle between them and the floor [rad]")]
    accel: Annotated[float, Field(gt=0.0, description="std of a window's specific force, motion removed [m/s^2]")]
    correlation: Annotated[float, Field(gt=0.0, description="time after which an error is a new one [s]")]
    max_speed: Annotated[float, Field(gt=0.0, description="joint speed above which a window is left out [rad/s]")]
    min_windows: Annotated[int, Field(ge=2, description="fewer usable windows are refused [1]")]
    max_sigma: Annotated[float, Field(gt=0.0, description="posterior std of an offset that is refused above [rad]")]
    max_residual: Annotated[float, Field(gt=1.0, description="RMS of the whitened residual refused above [-]")]
    gate: Annotated[float, Field(gt=1.0, description="mean squared whitened innovation, weighed down above [-]")]
    max_gated: Annotated[Share, Field(description="share of windows weighed down that is refused above [-]")]
    iterations: Annotated[int, Field(ge=2, description="largest number of Gauss-Newton steps [1]")]
    free_iterations: Annotated[int, Field(ge=1, description="first steps that weigh nothing down [1]")]
    placement: Annotated[float, Field(gt=0.0, description="std of the unknown placement of the soles [m, rad]")]
    misalignment: Annotated[float, Field(gt=0.0, description="least std of the IMU's mounting [rad]")]
    accel_bias: Annotated[float, Field(gt=0.0, description="least std of the accelerometer's bias [m/s^2]")]


@dataclass(frozen=True, slots=True, config=STRICT)
class PostureConfig:
    """Calibration of the encoders in a jig."""

    time: Annotated[float, Field(gt=0.0, description="time to average over in each posture [s]")]
    min_time: Annotated[float, Field(gt=0.0, description="a posture seen for less does not count [s]")]
    min_postures: Annotated[int, Field(ge=1, description="fewer postures are refused [1]")]
    agreement: Annotated[float, Field(gt=0.0, description="largest difference of an offset between postures [rad]")]


@dataclass(frozen=True, slots=True, config=STRICT)
class FeetConfig:
    """Calibration of the foot sensors."""

    time: Annotated[float, Field(gt=0.0, description="time to average over in the air [s]")]
    min_time: Annotated[float, Field(gt=0.0, description="less is refused [s]")]
    air_load: Annotated[Share, Field(description="force below which the feet are in the air, as a share of weight")]
    stand_load: Annotated[Share, Field(description="force above which the robot stands, as a share of weight")]
    air_spread: Annotated[Share, Field(description="std of a force in the air, as a share of weight")]
    stand_spread: Annotated[Share, Field(description="std of the load on both feet, as a share of weight")]
    gain_prior: Annotated[float, Field(gt=0.0, description="standard deviation of a gain before any data [-]")]
    load_sigma: Annotated[float, Field(gt=0.0, description="std of the vertical load at rest, as a share of weight")]
    min_shift: Annotated[Share, Field(description="change of the left foot's share needed to distinguish both gains")]

    def __post_init__(self) -> None:
        if self.air_load >= self.stand_load:
            raise ValueError(f"air_load {self.air_load} must be below stand_load {self.stand_load}")


@dataclass(frozen=True, slots=True, config=STRICT)
class ProcedureConfig:
    """How long a calibration over the graph waits for other nodes, on the machine's clock."""

    silence: Annotated[float, Field(gt=0.0, description="longest time without a complete sample [s]")]
    plan: Annotated[float, Field(gt=0.0, description="longest wait for a requested motion to begin [s]")]
    motion: Annotated[float, Field(gt=0.0, description="longest motion [s]")]
    completion: Annotated[float, Field(gt=0.0, description="longest wait for the report that a motion is done [s]")]


@dataclass(frozen=True, slots=True, config=STRICT)
class CalibrationConfig:
    """Parameters of all calibrations."""

    gravity: Annotated[float, Field(gt=0.0, description="[m/s^2]")]
    window: Annotated[float, Field(gt=0.0, description="time over which samples are averaged first [s]")]
    settle: Annotated[float, Field(ge=0.0, description="wait of the caller before the first sample [s]")]
    rest: RestConfig
    imu: ImuConfig
    chain: ChainConfig
    posture: PostureConfig
    feet: FeetConfig
    procedure: ProcedureConfig
