"""Schema of ``controllers/config/estimator.yaml``; the file holds the values, this holds units and bounds."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT
from models.profile import ImuSensor


@dataclass(frozen=True, slots=True, config=STRICT)
class InertialNoise:
    """Noise of the IMU on top of its data sheet, which is in the profile.

    Densities are two-sided: the error of one sample of length dt has the standard deviation density / sqrt(dt).
    """

    gyro_noise: Annotated[float, Field(gt=0.0, description="angular rate noise density [rad/s/sqrt(Hz)]")]
    accel_noise: Annotated[float, Field(gt=0.0, description="specific force noise density [m/s^2/sqrt(Hz)]")]
    gyro_bias_walk: Annotated[float, Field(gt=0.0, description="gyro bias random walk [rad/s/sqrt(s)]")]
    accel_bias_walk: Annotated[float, Field(gt=0.0, description="accelerometer bias random walk [m/s^2/sqrt(s)]")]
    gyro_bias: Annotated[float, Field(gt=0.0, description="initial std of the gyro bias [rad/s]")]
    accel_bias: Annotated[float, Field(gt=0.0, description="initial std of the accelerometer bias [m/s^2]")]
    coast_factor: Annotated[float, Field(ge=1.0, description="noise multiplier while samples are missing [-]")]

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

    encoder_steps: Annotated[float, Field(ge=0.0, description="error of a joint position, in encoder steps [-]")]
    position: Annotated[float, Field(gt=0.0, description="model error of a sole position [m]")]
    orientation: Annotated[float, Field(gt=0.0, description="model error of a sole orientation [rad]")]
    persistence: Annotated[float, Field(gt=0.0, description="time in which it wanders over its variance, twice [s]")]


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
class FootSensorConfig:
    """Foot sensors against leg torques; loads are shares of the weight."""

    load_error: Annotated[float, Field(gt=0.0, lt=1.0, description="difference of the loads that contradicts [-]")]
    contact_error: Annotated[
        float, Field(gt=0.0, lt=1.0, description="the same of a foot that sensor or torques have in the air [-]")
    ]
    sum_error: Annotated[float, Field(gt=0.0, lt=1.0, description="of both legs' torques against the motion [-]")]
    fault_time: Annotated[float, Field(gt=0.0, description="contradicted or missing before a sensor is out [s]")]
    scheduled_time: Annotated[float, Field(gt=0.0, description="the same where the schedule sides with torques [s]")]
    recover_time: Annotated[float, Field(gt=0.0, description="of agreement before it is back [s]")]
    settle_time: Annotated[float, Field(ge=0.0, description="no push begins for so long after a sensor's fault [s]")]
    swing_load: Annotated[float, Field(gt=0.0, lt=1.0, description="load by torques of a foot in the air, at most [-]")]
    stance_load: Annotated[float, Field(gt=0.0, lt=1.0, description="load by torques of a bearing foot, at least [-]")]
    unscheduled: Annotated[
        float, Field(ge=1.0, description="factor on stance_load of a foot that the schedule has in the air [-]")
    ]
    flat_trust: Annotated[
        float, Field(gt=0.0, le=1.0, description="factor on the confidence in a CoP from torques or saturated [-]")
    ]
    saturation: Annotated[float, Field(gt=0.0, le=1.0, description="share of full scale taken for saturated [-]")]

    def __post_init__(self) -> None:
        if not self.swing_load < self.stance_load:
            raise ValueError(f"swing_load {self.swing_load} < stance_load {self.stance_load} required")
        if not self.scheduled_time <= self.fault_time:
            raise ValueError(f"scheduled_time {self.scheduled_time} <= fault_time {self.fault_time} required")


@dataclass(frozen=True, slots=True, config=STRICT)
class SlipConfig:
    """Slip of a bearing foot."""

    time: Annotated[float, Field(gt=0.0, description="innovation over the gate before a foot slips [s]")]
    recover_time: Annotated[float, Field(gt=0.0, description="innovation below the gate before it stands again [s]")]
    density: Annotated[float, Field(gt=0.0, description="random walk of a slipping sole's position [m/sqrt(s)]")]


@dataclass(frozen=True, slots=True, config=STRICT)
class FootNoise:
    """Random walk of a foot, interpolated geometrically between its states by the contact's confidence."""

    slip: Annotated[float, Field(gt=0.0, description="horizontal position, foot bearing [m/sqrt(s)]")]
    sink: Annotated[float, Field(gt=0.0, description="height, foot bearing for long [m/sqrt(s)]")]
    creep: Annotated[float, Field(gt=0.0, description="horizontal, foot just landed or tipped [m/sqrt(s)]")]
    settling: Annotated[float, Field(gt=0.0, description="height, foot just landed or tipped [m/sqrt(s)]")]
    settle_time: Annotated[float, Field(ge=0.0, description="how long a foot settles after that [s]")]
    swing: Annotated[float, Field(gt=0.0, description="position, foot in the air [m/sqrt(s)]")]
    flat: Annotated[float, Field(gt=0.0, description="orientation, sole flat on the ground [rad/sqrt(s)]")]
    tipping: Annotated[float, Field(gt=0.0, description="orientation, CoP at an edge [rad/sqrt(s)]")]
    swing_rotation: Annotated[float, Field(gt=0.0, description="orientation, foot in the air [rad/sqrt(s)]")]
    pivot: Annotated[float, Field(ge=0.0, description="error of the point about which a bearing sole turns [m]")]


@dataclass(frozen=True, slots=True, config=STRICT)
class RestConfig:
    """Zero-velocity update while no foot bears and the IMU is quiet (hung up, or held by the simulator)."""

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
    sole: Annotated[float, Field(gt=0.0, description="of each sole's measured tilt on that floor [rad]")]
    heading: Annotated[float, Field(gt=0.0, description="yaw; a convention, so small [rad]")]
    position: Annotated[float, Field(gt=0.0, description="base position x and y; a convention, so small [m]")]
    height: Annotated[float, Field(gt=0.0, description="of the soles above the floor, z = 0 [m]")]


@dataclass(frozen=True, slots=True, config=STRICT)
class ObserverConfig:
    """Momentum observer; forces as shares of the weight."""

    push_cutoff: Annotated[float, Field(gt=0.0, description="cut-off of the push [Hz]")]
    joint_cutoff: Annotated[float, Field(gt=0.0, description="cut-off of joint torques and sole wrenches [Hz]")]
    damping: Annotated[float, Field(gt=0.0, description="lever below which a leg torque shows no force [m]")]
    moment_arm: Annotated[float, Field(gt=0.0, description="lever that makes moments comparable with forces [m]")]
    friction_speed: Annotated[float, Field(gt=0.0, description="speed at which dry friction is nearly full [rad/s]")]
    dead_band: Annotated[float, Field(ge=0.0, lt=1.0, description="force that is reported as none [-]")]
    detect_on: Annotated[float, Field(gt=0.0, description="force above which a push begins [-]")]
    detect_off: Annotated[float, Field(gt=0.0, description="force below which it ends [-]")]
    on_time: Annotated[float, Field(ge=0.0, description="time above detect_on before it counts [s]")]
    off_time: Annotated[float, Field(ge=0.0, description="time below detect_off before it is over [s]")]
    offset_time: Annotated[float, Field(gt=0.0, description="time constant of the offset learnt in the dead-band [s]")]

    def __post_init__(self) -> None:
        if not self.dead_band <= self.detect_off < self.detect_on:
            raise ValueError(
                f"dead_band {self.dead_band} <= detect_off {self.detect_off} < detect_on {self.detect_on} required"
            )


@dataclass(frozen=True, slots=True, config=STRICT)
class EstimatorConfig:
    """Parameters of the state estimator."""

    gravity: Annotated[float, Field(gt=0.0, description="magnitude of free fall [m/s^2]")]
    gate: Annotated[
        float, Field(gt=0.0, description="normalised innovation squared above which a sole is weighed down [-]")
    ]
    stamp_gap: Annotated[float, Field(gt=0.0, description="largest step of a stamp that is accepted at once [s]")]
    imu: InertialNoise
    kinematics: KinematicNoise
    contact: ContactConfig
    foot_sensors: FootSensorConfig
    slip: SlipConfig
    foot: FootNoise
    rest: RestConfig
    initial: InitialConfig
    observer: ObserverConfig
