"""Schema of ``controllers/config/estimator.yaml`` with units and bounds; the file contains the values."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, NonNegative, Positive, default_config
from models.errors import ConfigError
from models.profile import ImuSensor


@dataclass(frozen=True, slots=True, config=STRICT)
class InertialNoise:
    """Noise of the IMU in addition to its data sheet, which is in the profile.

    Densities are two-sided: the error of one sample of length dt has the standard deviation density / sqrt(dt).
    """

    gyro_noise: Positive  #: angular rate noise density [rad/s/sqrt(Hz)]
    accel_noise: Positive  #: specific force noise density [m/s^2/sqrt(Hz)]
    gyro_bias_walk: Positive  #: gyro bias random walk [rad/s/sqrt(s)]
    accel_bias_walk: Positive  #: accelerometer bias random walk [m/s^2/sqrt(s)]
    gyro_bias: Positive  #: initial std of the gyro bias [rad/s]
    accel_bias: Positive  #: initial std of the accelerometer bias [m/s^2]
    coast_factor: Annotated[float, Field(ge=1.0)]  #: noise multiplier while samples are missing [-]

    def with_sensor(self, sensor: ImuSensor, gravity: float) -> InertialNoise:
        """Copy with the variances of the data sheet added.

        At rest, a scale error and a mounting error of the accelerometer look like a bias: each adds its share of
        gravity [m/s^2]. Those of the gyro have no effect at rest and are left out.
        """
        mounting = math.hypot(sensor.accel_scale, sensor.misalignment) * gravity
        return replace(
            self,
            gyro_noise=math.hypot(self.gyro_noise, sensor.gyro_noise_density),
            accel_noise=math.hypot(self.accel_noise, sensor.accel_noise_density),
            gyro_bias_walk=math.hypot(self.gyro_bias_walk, sensor.gyro_bias_walk),
            accel_bias_walk=math.hypot(self.accel_bias_walk, sensor.accel_bias_walk),
            gyro_bias=math.hypot(self.gyro_bias, sensor.gyro_bias),
            accel_bias=math.hypot(self.accel_bias, sensor.accel_bias, mounting),
        )


@dataclass(frozen=True, slots=True, config=STRICT)
class KinematicNoise:
    """Noise of the sole pose computed from the encoders.

    The error is independent in each sample while the joints move by at least one encoder step per sample. Otherwise it
    drifts: a random walk adds twice the error variance in ``persistence``.
    """

    encoder_steps: NonNegative  #: error of a joint position, in encoder steps [-]
    position: Positive  #: model error of a sole position [m]
    orientation: Positive  #: model error of a sole orientation [rad]
    persistence: Positive  #: time in which the random walk of the error adds twice its variance [s]


@dataclass(frozen=True, slots=True, config=STRICT)
class ContactConfig:
    """Contact detection: loads are fractions of the robot's weight."""

    load_on: Annotated[float, Field(gt=0.0, lt=1.0)]  #: load above which a foot makes contact [-]
    load_off: Annotated[float, Field(gt=0.0, lt=1.0)]  #: load below which a foot breaks contact [-]
    load_full: Annotated[float, Field(gt=0.0, lt=1.0)]  #: load at which a foot has full confidence [-]
    on_delay: NonNegative  #: time above load_on before contact is made [s]
    #: distance of the CoP from an edge below which a foot may tip, as a fraction of half the sole [-]
    edge_margin: Annotated[float, Field(gt=0.0, le=1.0)]

    def __post_init__(self) -> None:
        if not self.load_off < self.load_on < self.load_full:
            raise ValueError(f"load_off {self.load_off} < load_on {self.load_on} < load_full {self.load_full} required")


@dataclass(frozen=True, slots=True, config=STRICT)
class FootSensorConfig:
    """Comparison of foot sensors with leg torques; loads are shares of the weight."""

    load_error: Annotated[float, Field(gt=0.0, lt=1.0)]  #: load difference of sensor and torques that contradicts [-]
    #: the same if the sensor or the torques show the foot in the air [-]
    contact_error: Annotated[float, Field(gt=0.0, lt=1.0)]
    sum_error: Annotated[float, Field(gt=0.0, lt=1.0)]  #: largest error of the torque-based sum against the motion [-]
    fault_time: Positive  #: time of contradiction or missing data before a sensor is faulty [s]
    scheduled_time: Positive  #: the same if the gait schedule agrees with the torques [s]
    recover_time: Positive  #: time of agreement before a sensor is sound again [s]
    settle_time: NonNegative  #: time after a sensor fault in which no push begins [s]
    swing_load: Annotated[float, Field(gt=0.0, lt=1.0)]  #: largest torque-based load of a swing foot [-]
    stance_load: Annotated[float, Field(gt=0.0, lt=1.0)]  #: least torque-based load of a stance foot [-]
    #: factor on stance_load for a scheduled swing foot [-]
    unscheduled: Annotated[float, Field(ge=1.0)]
    #: factor on the confidence in a CoP from torques or a saturated sensor [-]
    flat_trust: Annotated[float, Field(gt=0.0, le=1.0)]
    saturation: Annotated[float, Field(gt=0.0, le=1.0)]  #: share of full scale at which a sensor is saturated [-]

    def __post_init__(self) -> None:
        if not self.swing_load < self.stance_load:
            raise ValueError(f"swing_load {self.swing_load} < stance_load {self.stance_load} required")
        if not self.scheduled_time <= self.fault_time:
            raise ValueError(f"scheduled_time {self.scheduled_time} <= fault_time {self.fault_time} required")


@dataclass(frozen=True, slots=True, config=STRICT)
class SlipConfig:
    """Slip of a stance foot."""

    time: Positive  #: time of the innovation above the gate before a slip begins [s]
    recover_time: Positive  #: time of the innovation below the gate before a slip ends [s]
    density: Positive  #: random walk of the position of a slipping sole [m/sqrt(s)]


@dataclass(frozen=True, slots=True, config=STRICT)
class FrictionConfig:
    """Friction coefficient of the ground, from sliding and holding soles; the law is in ``friction.py``."""

    expected: Annotated[float, Field(ge=0.0, le=2.0)]  #: initial coefficient; 0: from the profile [-]
    load: Annotated[float, Field(gt=0.0, lt=1.0)]  #: least load of an evaluated sole, as a share of the weight [-]
    flat: Annotated[float, Field(gt=0.0, le=1.0)]  #: least confidence that the sole lies flat [-]
    speed: Positive  #: least speed of a sliding sole [m/s]
    #: least cosine of the angle between the sole velocity and the reverse of the ground force [-]
    opposed: Annotated[float, Field(ge=0.0, lt=1.0)]
    turn_time: Positive  #: time constant of the decay of a sole's turning rate [s]
    filter_time: Positive  #: time constant of demand, speed and rate [s]
    slide_time: Positive  #: time constant of the coefficient towards the demand of a sliding sole [s]
    #: share of the coefficient above which the demand of a holding sole raises it [-]
    held: Annotated[float, Field(gt=0.0, le=1.0)]
    raise_time: Positive  #: time constant of this rise [s]
    least: Positive  #: least coefficient [-]


@dataclass(frozen=True, slots=True, config=STRICT)
class FootNoise:
    """Random walk of a foot; the contact confidence interpolates geometrically between the states of the foot."""

    slip: Positive  #: horizontal position of a stance foot [m/sqrt(s)]
    sink: Positive  #: height of a settled stance foot [m/sqrt(s)]
    creep: Positive  #: horizontal position just after touchdown or tipping [m/sqrt(s)]
    settling: Positive  #: height just after touchdown or tipping [m/sqrt(s)]
    settle_time: NonNegative  #: settling time after touchdown or tipping [s]
    swing: Positive  #: position of a swing foot [m/sqrt(s)]
    flat: Positive  #: orientation of a sole flat on the ground [rad/sqrt(s)]
    tipping: Positive  #: orientation with the CoP at an edge [rad/sqrt(s)]
    swing_rotation: Positive  #: orientation of a swing foot [rad/sqrt(s)]
    turn: Positive  #: heading of a foot in stance for longer than ``turn_time`` [rad/sqrt(s)]
    turn_time: NonNegative  #: stance time from which ``turn`` applies; longer than in walking [s]
    pivot: NonNegative  #: error of the point about which a stance sole turns [m]


@dataclass(frozen=True, slots=True, config=STRICT)
class RestConfig:
    """Zero-velocity update while no foot bears load and the IMU is quiet (robot hung up, or held by the simulator)."""

    gyro: Positive  #: angular rate below which the IMU is quiet [rad/s]
    accel: Positive  #: deviation of |specific force| from gravity below which the IMU is quiet [m/s^2]
    velocity: Positive  #: std of the zero velocity in each sample, for ``time`` after the start [m/s]
    time: NonNegative  #: time after the start in which ``velocity`` applies [s]
    moved: Positive  #: root density of the velocity afterwards: a gantry may move the robot [m/s*sqrt(s)]
    #: deviation of |specific force| / gravity from 1 above which the start is refused [-]
    accel_at_reset: Annotated[float, Field(gt=0.0, lt=1.0)]


@dataclass(frozen=True, slots=True, config=STRICT)
class InitialConfig:
    """Initial standard deviations that do not follow from the sensors."""

    velocity: Positive  #: base velocity [m/s]
    force: Positive  #: first specific force, vibration included [m/s^2]
    floor: Positive  #: slope of the floor under the first stance [rad]
    sole: Positive  #: measured tilt of each sole on that floor [rad]
    heading: Positive  #: yaw; small, because it is a convention [rad]
    position: Positive  #: base position x and y; small, because it is a convention [m]
    height: Positive  #: height of the soles above the floor at z = 0 [m]


@dataclass(frozen=True, slots=True, config=STRICT)
class ObserverConfig:
    """Momentum observer; forces as shares of the weight."""

    push_cutoff: Positive  #: cut-off of the push [Hz]
    joint_cutoff: Positive  #: cut-off of joint torques and sole wrenches [Hz]
    damping: Positive  #: lever arm below which a leg torque gives no force [m]
    moment_arm: Positive  #: lever arm that scales moments to forces [m]
    friction_speed: Positive  #: speed at which dry friction is nearly full [rad/s]
    dead_band: Annotated[float, Field(ge=0.0, lt=1.0)]  #: force below which a push is reported as zero [-]
    detect_on: Positive  #: force above which a push begins [-]
    detect_off: Positive  #: force below which a push ends [-]
    on_time: NonNegative  #: time above detect_on before a push begins [s]
    off_time: NonNegative  #: time below detect_off before a push ends [s]
    offset_time: Positive  #: time constant of the offset learnt in the dead-band [s]

    def __post_init__(self) -> None:
        if not self.dead_band <= self.detect_off < self.detect_on:
            raise ValueError(
                f"dead_band {self.dead_band} <= detect_off {self.detect_off} < detect_on {self.detect_on} required"
            )


@dataclass(frozen=True, slots=True, config=STRICT)
class EstimatorConfig:
    """Parameters of the state estimator."""

    gravity: Positive  #: gravitational acceleration [m/s^2]
    gate: Positive  #: normalised innovation squared above which a sole gets less weight [-]
    stamp_gap: Positive  #: largest step of a stamp that is accepted at once [s]
    imu: InertialNoise
    kinematics: KinematicNoise
    contact: ContactConfig
    foot_sensors: FootSensorConfig
    slip: SlipConfig
    friction: FrictionConfig
    foot: FootNoise
    rest: RestConfig
    initial: InitialConfig
    observer: ObserverConfig


def expecting(friction: float | None) -> EstimatorConfig:
    """Packaged parameters, with an expected friction coefficient [-] unless None; ``ConfigError`` if not in (0, 2]."""
    config = default_config(EstimatorConfig, "controllers", "estimator")
    if friction is None:
        return config
    if not 0.0 < friction <= 2.0:
        raise ConfigError(f"expected_friction: {friction} is not in (0, 2]")
    return replace(config, friction=replace(config.friction, expected=friction))
