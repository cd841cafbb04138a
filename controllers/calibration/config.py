"""Schema of ``controllers/config/calibration.yaml``; the file holds the values, this holds units and bounds."""

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, Count, Fraction, NonNegative, Positive


@dataclass(frozen=True, slots=True, config=STRICT)
class RestConfig:
    """Criteria of rest, on means over ``window``."""

    joint_speed: Positive  #: largest joint speed [rad/s]
    joint_drift: Positive  #: largest change of a joint position in all [rad]
    gyro_spread: Positive  #: standard deviation of the angular rate [rad/s]
    accel_spread: Positive  #: standard deviation of the specific force [m/s^2]


@dataclass(frozen=True, slots=True, config=STRICT)
class ImuConfig:
    """Calibration of the IMU."""

    time: Positive  #: time to average over [s]
    min_time: Positive  #: less is refused [s]
    min_samples: Annotated[int, Field(ge=2)]  #: fewer are refused [1]
    drift: Positive  #: largest change of the mean rate between both halves [rad/s]
    norm_error: Annotated[float, Field(gt=0.0, lt=0.5)]  #: deviation of |specific force| from gravity [-]


@dataclass(frozen=True, slots=True, config=STRICT)
class ChainConfig:
    """Calibration of the encoders from the closed chain through both soles."""

    prior: Positive  #: standard deviation of an offset before any data [rad]
    slide: Positive  #: std of the horizontal distance between the soles [m]
    turn: Positive  #: std of the yaw between them [rad]
    slide_walk: NonNegative  #: creeping of that distance [m/sqrt(s)]
    turn_walk: NonNegative  #: creeping of that yaw [rad/sqrt(s)]
    height: Positive  #: std of their difference in height [m]
    tilt: Positive  #: std of the angle between them and the floor [rad]
    accel: Positive  #: std of a window's specific force, motion removed [m/s^2]
    correlation: Positive  #: time after which an error is a new one [s]
    speed_max: Positive  #: joint speed above which a window is left out [rad/s]
    min_windows: Annotated[int, Field(ge=2)]  #: fewer usable windows are refused [1]
    sigma_max: Positive  #: posterior std of an offset that is refused above [rad]
    residual_max: Annotated[float, Field(gt=1.0)]  #: RMS of the whitened residual refused above [-]
    gate: Annotated[float, Field(gt=1.0)]  #: mean squared whitened innovation, weighed down above [-]
    gated_max: Fraction  #: share of windows weighed down that is refused above [-]
    iterations: Annotated[int, Field(ge=2)]  #: largest number of Gauss-Newton steps [1]
    free_iterations: Count  #: first steps that weigh nothing down [1]
    placement: Positive  #: std of the unknown placement of the soles [m, rad]
    misalignment: Positive  #: least std of the IMU's mounting [rad]
    accel_bias: Positive  #: least std of the accelerometer's bias [m/s^2]


@dataclass(frozen=True, slots=True, config=STRICT)
class PostureConfig:
    """Calibration of the encoders in a jig."""

    time: Positive  #: time to average over in each posture [s]
    min_time: Positive  #: a posture seen for less does not count [s]
    min_postures: Count  #: fewer postures are refused [1]
    agreement: Positive  #: largest difference of an offset between postures [rad]


@dataclass(frozen=True, slots=True, config=STRICT)
class FeetConfig:
    """Calibration of the foot sensors."""

    time: Positive  #: time to average over in the air [s]
    min_time: Positive  #: less is refused [s]
    air_load: Fraction  #: force below which the feet are in the air, as a share of weight
    stand_load: Fraction  #: force above which the robot stands, as a share of weight
    air_spread: Fraction  #: std of a force in the air, as a share of weight
    stand_spread: Fraction  #: std of the load on both feet, as a share of weight
    gain_prior: Positive  #: standard deviation of a gain before any data [-]
    load_sigma: Positive  #: std of the vertical load at rest, as a share of weight
    min_shift: Fraction  #: change of the left foot's share needed to distinguish both gains

    def __post_init__(self) -> None:
        if self.air_load >= self.stand_load:
            raise ValueError(f"air_load {self.air_load} must be below stand_load {self.stand_load}")


@dataclass(frozen=True, slots=True, config=STRICT)
class ProcedureConfig:
    """How long a calibration over the graph waits for other nodes, on the machine's clock."""

    silence: Positive  #: longest time without a complete sample [s]
    plan: Positive  #: longest wait for a requested motion to begin [s]
    motion: Positive  #: longest motion [s]
    completion: Positive  #: longest wait for the report that a motion is done [s]


@dataclass(frozen=True, slots=True, config=STRICT)
class CalibrationConfig:
    """Parameters of all calibrations."""

    gravity: Positive  #: [m/s^2]
    window: Positive  #: time over which samples are averaged first [s]
    settle: NonNegative  #: wait of the caller before the first sample [s]
    rest: RestConfig
    imu: ImuConfig
    chain: ChainConfig
    posture: PostureConfig
    feet: FeetConfig
    procedure: ProcedureConfig
