"""Schema of ``controllers/config/calibration.yaml`` with units and bounds; the file contains the values."""

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, Count, Fraction, NonNegative, Positive


@dataclass(frozen=True, slots=True, config=STRICT)
class RestConfig:
    """Bounds of rest, on averages over ``window``."""

    joint_speed: Positive  #: largest joint speed [rad/s]
    joint_drift: Positive  #: largest change of a joint position over all windows [rad]
    gyro_spread: Positive  #: standard deviation of the angular rate [rad/s]
    accel_spread: Positive  #: standard deviation of the specific force [m/s^2]


@dataclass(frozen=True, slots=True, config=STRICT)
class ImuConfig:
    """Calibration of the IMU."""

    time: Positive  #: averaging time [s]
    min_time: Positive  #: minimum time of the samples [s]
    min_samples: Annotated[int, Field(ge=2)]  #: minimum number of samples [1]
    drift: Positive  #: largest change of the mean rate between the two halves [rad/s]
    norm_error: Annotated[float, Field(gt=0.0, lt=0.5)]  #: relative deviation of |specific force| from gravity [-]


@dataclass(frozen=True, slots=True, config=STRICT)
class ChainConfig:
    """Calibration of the encoders from the closed chain through both soles."""

    prior: Positive  #: standard deviation of an offset before any data [rad]
    slide: Positive  #: std of the horizontal distance between the soles [m]
    turn: Positive  #: std of the yaw between the soles [rad]
    slide_walk: NonNegative  #: random walk of the horizontal distance [m/sqrt(s)]
    turn_walk: NonNegative  #: random walk of the yaw [rad/sqrt(s)]
    height: Positive  #: std of the height difference of the soles [m]
    tilt: Positive  #: std of the angle between the soles and the floor [rad]
    accel: Positive  #: std of the specific force of a window, motion subtracted [m/s^2]
    correlation: Positive  #: correlation time of the errors [s]
    speed_max: Positive  #: joint speed above which a window is excluded [rad/s]
    min_windows: Annotated[int, Field(ge=2)]  #: minimum number of usable windows [1]
    sigma_max: Positive  #: largest accepted posterior std of an offset [rad]
    residual_max: Annotated[float, Field(gt=1.0)]  #: largest accepted RMS of the whitened residual [-]
    gate: Annotated[float, Field(gt=1.0)]  #: mean squared whitened innovation above which a window gets less weight [-]
    gated_max: Fraction  #: largest accepted share of windows with reduced weight [-]
    iterations: Annotated[int, Field(ge=2)]  #: largest number of Gauss-Newton steps [1]
    free_iterations: Count  #: number of first steps without the gate [1]
    placement: Positive  #: prior std of the placement of the soles [m, rad]
    misalignment: Positive  #: lower bound of the prior std of the IMU mounting [rad]
    accel_bias: Positive  #: lower bound of the prior std of the accelerometer bias [m/s^2]


@dataclass(frozen=True, slots=True, config=STRICT)
class PostureConfig:
    """Calibration of the encoders in a jig."""

    time: Positive  #: averaging time in each posture [s]
    min_time: Positive  #: minimum time in a posture [s]
    min_postures: Count  #: minimum number of postures [1]
    agreement: Positive  #: largest difference of an offset between postures [rad]


@dataclass(frozen=True, slots=True, config=STRICT)
class FeetConfig:
    """Calibration of the foot sensors."""

    time: Positive  #: averaging time in the air [s]
    min_time: Positive  #: minimum time of the samples in the air, and at rest on both feet [s]
    air_load: Fraction  #: force below which the feet are in the air, as a share of the weight
    stand_load: Fraction  #: force above which the robot stands, as a share of the weight
    air_spread: Fraction  #: largest std of a force in the air, as a share of the weight
    stand_spread: Fraction  #: largest std of the load on both feet, as a share of the weight
    gain_prior: Positive  #: standard deviation of a gain before any data [-]
    load_sigma: Positive  #: std of the vertical load at rest, as a share of the weight
    min_shift: Fraction  #: least change of the load share of the left foot for separate gains

    def __post_init__(self) -> None:
        if self.air_load >= self.stand_load:
            raise ValueError(f"air_load {self.air_load} must be below stand_load {self.stand_load}")


@dataclass(frozen=True, slots=True, config=STRICT)
class ProcedureConfig:
    """Timeouts of a calibration that involves other nodes, on the machine's clock."""

    silence: Positive  #: longest time without a complete sample [s]
    plan: Positive  #: longest wait for a requested motion to begin [s]
    motion: Positive  #: longest motion [s]
    completion: Positive  #: longest wait for the report that a motion is done [s]


@dataclass(frozen=True, slots=True, config=STRICT)
class CalibrationConfig:
    """Parameters of all calibrations."""

    gravity: Positive  #: [m/s^2]
    window: Positive  #: length of a window of averaged samples [s]
    settle: NonNegative  #: delay of the caller before the first sample [s]
    rest: RestConfig
    imu: ImuConfig
    chain: ChainConfig
    posture: PostureConfig
    feet: FeetConfig
    procedure: ProcedureConfig
