"""Schema of ``controllers/config/estimator.yaml``; the file holds the values, this holds units and bounds."""

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
    """Noise of the IMU on top of its data sheet, which is in the profile.

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
        """The same with the data sheet's figures added, as variances.

        At rest, a scale error and a tilted mounting of the accelerometer look like a bias: each adds its share of
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

    The error is new at each sample while the joints move by a step a sample or more. While they hardly move it stays,
    and wanders: as a random walk that makes up the whole variance in ``persistence``.
    """

    encoder_steps: NonNegative  #: error of a joint position, in encoder steps [-]
    position: Positive  #: model error of a sole position [m]
    orientation: Positive  #: model error of a sole orientation [rad]
    persistence: Positive  #: time in which it wanders over its variance, twice [s]


@dataclass(frozen=True, slots=True, config=STRICT)
class ContactConfig:
    """Contact detection: loads are fractions of the robot's weight."""

    load_on: Annotated[float, Field(gt=0.0, lt=1.0)]  #: load above which a foot makes contact [-]
    load_off: Annotated[float, Field(gt=0.0, lt=1.0)]  #: load below which a foot breaks contact [-]
    load_full: Annotated[float, Field(gt=0.0, lt=1.0)]  #: load from which a foot is fully trusted [-]
    on_delay: NonNegative  #: time above load_on before contact is made [s]
    #: distance of the CoP from an edge below which a foot may tip, as a fraction of half the sole [-]
    edge_margin: Annotated[float, Field(gt=0.0, le=1.0)]

    def __post_init__(self) -> None:
        if not self.load_off < self.load_on < self.load_full:
            raise ValueError(f"load_off {self.load_off} < load_on {self.load_on} < load_full {self.load_full} required")


@dataclass(frozen=True, slots=True, config=STRICT)
class FootSensorConfig:
    """Foot sensors against leg torques; loads are shares of the weight."""

    load_error: Annotated[float, Field(gt=0.0, lt=1.0)]  #: difference of the loads that contradicts [-]
    #: the same of a foot that sensor or torques have in the air [-]
    contact_error: Annotated[float, Field(gt=0.0, lt=1.0)]
    sum_error: Annotated[float, Field(gt=0.0, lt=1.0)]  #: of both legs' torques against the motion [-]
    fault_time: Positive  #: contradicted or missing before a sensor is out [s]
    scheduled_time: Positive  #: the same where the schedule sides with torques [s]
    recover_time: Positive  #: of agreement before it is back [s]
    settle_time: NonNegative  #: no push begins for so long after a sensor's fault [s]
    swing_load: Annotated[float, Field(gt=0.0, lt=1.0)]  #: load by torques of a foot in the air, at most [-]
    stance_load: Annotated[float, Field(gt=0.0, lt=1.0)]  #: load by torques of a bearing foot, at least [-]
    #: factor on stance_load of a foot that the schedule has in the air [-]
    unscheduled: Annotated[float, Field(ge=1.0)]
    #: factor on the confidence in a CoP from torques or saturated [-]
    flat_trust: Annotated[float, Field(gt=0.0, le=1.0)]
    saturation: Annotated[float, Field(gt=0.0, le=1.0)]  #: share of full scale taken for saturated [-]

    def __post_init__(self) -> None:
        if not self.swing_load < self.stance_load:
            raise ValueError(f"swing_load {self.swing_load} < stance_load {self.stance_load} required")
        if not self.scheduled_time <= self.fault_time:
            raise ValueError(f"scheduled_time {self.scheduled_time} <= fault_time {self.fault_time} required")


@dataclass(frozen=True, slots=True, config=STRICT)
class SlipConfig:
    """Slip of a bearing foot."""

    time: Positive  #: innovation over the gate before a foot slips [s]
    recover_time: Positive  #: innovation below the gate before it stands again [s]
    density: Positive  #: random walk of a slipping sole's position [m/sqrt(s)]


@dataclass(frozen=True, slots=True, config=STRICT)
class FrictionConfig:
    """Coefficient of the ground, from soles that slide or hold; the law is in ``friction.py``."""

    expected: Annotated[float, Field(ge=0.0, le=2.0)]  #: coefficient at the start; 0 for that of the profile [-]
    load: Annotated[float, Field(gt=0.0, lt=1.0)]  #: least load of a sole that counts, of the weight [-]
    flat: Annotated[float, Field(gt=0.0, le=1.0)]  #: least confidence that it lies flat [-]
    speed: Positive  #: least speed of a sole that slides [m/s]
    #: least cosine of the angle between its velocity and the direction against the ground's force [-]
    opposed: Annotated[float, Field(ge=0.0, lt=1.0)]
    turn_time: Positive  #: time constant with which the turning of a sole is forgotten [s]
    filter_time: Positive  #: time constant of demand, speed and rate [s]
    slide_time: Positive  #: time constant with which the coefficient follows the demand of a sole that slides [s]
    #: share of the coefficient above which a demand that holds raises it [-]
    held: Annotated[float, Field(gt=0.0, le=1.0)]
    raise_time: Positive  #: time constant of that [s]
    least: Positive  #: least coefficient [-]


@dataclass(frozen=True, slots=True, config=STRICT)
class FootNoise:
    """Random walk of a foot, interpolated geometrically between its states by the contact's confidence."""

    slip: Positive  #: horizontal position, foot bearing [m/sqrt(s)]
    sink: Positive  #: height, foot bearing for long [m/sqrt(s)]
    creep: Positive  #: horizontal, foot just landed or tipped [m/sqrt(s)]
    settling: Positive  #: height, foot just landed or tipped [m/sqrt(s)]
    settle_time: NonNegative  #: how long a foot settles after that [s]
    swing: Positive  #: position, foot in the air [m/sqrt(s)]
    flat: Positive  #: orientation, sole flat on the ground [rad/sqrt(s)]
    tipping: Positive  #: orientation, CoP at an edge [rad/sqrt(s)]
    swing_rotation: Positive  #: orientation, foot in the air [rad/sqrt(s)]
    turn: Positive  #: heading, foot bearing for longer than ``turn_time`` [rad/sqrt(s)]
    turn_time: NonNegative  #: longer than a foot bears while walking [s]
    pivot: NonNegative  #: error of the point about which a bearing sole turns [m]


@dataclass(frozen=True, slots=True, config=STRICT)
class RestConfig:
    """Zero-velocity update while no foot bears and the IMU is quiet (hung up, or held by the simulator)."""

    gyro: Positive  #: angular rate below which it is quiet [rad/s]
    accel: Positive  #: deviation of |specific force| from gravity [m/s^2]
    velocity: Positive  #: std of the assumed zero velocity, of every sample apart, for ``time`` after the start [m/s]
    time: NonNegative  #: of that [s]
    moved: Positive  #: afterwards, when a gantry may move the robot: root of the density of its velocity [m/s*sqrt(s)]
    #: deviation of |specific force| / gravity from 1 refused at start [-]
    accel_at_reset: Annotated[float, Field(gt=0.0, lt=1.0)]


@dataclass(frozen=True, slots=True, config=STRICT)
class InitialConfig:
    """Initial standard deviations besides those that follow from the sensors."""

    velocity: Positive  #: base velocity [m/s]
    force: Positive  #: first specific force, vibration included [m/s^2]
    floor: Positive  #: slope of the floor under the first stance [rad]
    sole: Positive  #: of each sole's measured tilt on that floor [rad]
    heading: Positive  #: yaw; a convention, so small [rad]
    position: Positive  #: base position x and y; a convention, so small [m]
    height: Positive  #: of the soles above the floor, z = 0 [m]


@dataclass(frozen=True, slots=True, config=STRICT)
class ObserverConfig:
    """Momentum observer; forces as shares of the weight."""

    push_cutoff: Positive  #: cut-off of the push [Hz]
    joint_cutoff: Positive  #: cut-off of joint torques and sole wrenches [Hz]
    damping: Positive  #: lever below which a leg torque shows no force [m]
    moment_arm: Positive  #: lever that makes moments comparable with forces [m]
    friction_speed: Positive  #: speed at which dry friction is nearly full [rad/s]
    dead_band: Annotated[float, Field(ge=0.0, lt=1.0)]  #: force that is reported as none [-]
    detect_on: Positive  #: force above which a push begins [-]
    detect_off: Positive  #: force below which it ends [-]
    on_time: NonNegative  #: time above detect_on before it counts [s]
    off_time: NonNegative  #: time below detect_off before it is over [s]
    offset_time: Positive  #: time constant of the offset learnt in the dead-band [s]

    def __post_init__(self) -> None:
        if not self.dead_band <= self.detect_off < self.detect_on:
            raise ValueError(
                f"dead_band {self.dead_band} <= detect_off {self.detect_off} < detect_on {self.detect_on} required"
            )


@dataclass(frozen=True, slots=True, config=STRICT)
class EstimatorConfig:
    """Parameters of the state estimator."""

    gravity: Positive  #: magnitude of free fall [m/s^2]
    gate: Positive  #: normalised innovation squared above which a sole is weighed down [-]
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
    """The packaged parameters, with an expected coefficient of friction [-] unless None."""
    config = default_config(EstimatorConfig, "controllers", "estimator")
    if friction is None:
        return config
    if not 0.0 < friction <= 2.0:
        raise ConfigError(f"expected_friction: {friction} is not in (0, 2]")
    return replace(config, friction=replace(config.friction, expected=friction))
