"""Robot profiles: everything about a robot that its URDF does not contain, in one YAML file.

A profile is given by name (``g1``) if it is packaged in ``models/robots``, else by the path of a user's file.
Lengths are in metres, angles in radians; every field below states its unit.
"""

from dataclasses import field
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, NonNegative, Positive, Share, merged, parse_config, read_yaml
from models.errors import ConfigError
from models.range_sensor import DEPTH_FRAME, LIDAR_FRAME, DepthSensor, LidarSensor
from models.types import Vector3
from models.urdf import resolve_uri

Law = Literal["gait", "balance", "whole_body"]  #: Configurations that a profile may change
#: Frames that every profile must place on a link (REP-120 names); the soles and base_link have separate keys
REQUIRED_FRAMES = ("torso", "gaze", "l_wrist", "r_wrist", "imu")
CAMERA_FRAME = "camera_optical_frame"  #: Optical frame of the camera: x right, y down, z forward (REP-103)
#: Frame names that the loader defines and ``frames`` must not redefine
RESERVED_FRAMES = ("base_link", "l_sole", "r_sole", "base_footprint", "odom")


@dataclass(frozen=True, slots=True, config=STRICT)
class Motor:
    """One type of drive (motor, gearbox and driver), shared by several joints."""

    armature: NonNegative  #: rotor inertia reflected to the joint [kg.m^2]
    damping: NonNegative  #: viscous friction at the joint [N.m.s/rad]
    frictionloss: NonNegative  #: dry friction at the joint [N.m]
    torque_rate: Positive  #: maximum rate of change of the drive's torque [N.m/s]
    kp: NonNegative  #: position gain of the driver [N.m/rad]
    kd: NonNegative  #: velocity gain of the driver [N.m.s/rad]


@dataclass(frozen=True, slots=True, config=STRICT)
class Joint:
    """Drive of one joint: motor type and overrides."""

    motor: str  #: key in `motors`
    kp: Annotated[float | None, Field(ge=0.0)] = None  #: overrides the motor's position gain [N.m/rad]
    kd: Annotated[float | None, Field(ge=0.0)] = None  #: overrides the motor's velocity gain [N.m.s/rad]
    torque_limit: Annotated[float | None, Field(gt=0.0)] = None  #: overrides the URDF's effort limit [N.m]
    velocity_limit: Annotated[float | None, Field(gt=0.0)] = None  #: overrides the URDF's velocity limit [rad/s]
    aliases: tuple[str, ...] = ()  #: alternative names, such as those of textbooks


def joint_key(name: str) -> tuple[str, ...]:
    """Normalised name: sorted words without ``joint``, with ``l`` and ``r`` expanded; equal for all spellings."""
    sides = {"l": "left", "r": "right"}
    return tuple(sorted(sides.get(word, word) for word in name.lower().split("_") if word != "joint"))


@dataclass(frozen=True, slots=True, config=STRICT)
class Frame:
    """A frame fixed to a link of the URDF."""

    link: str  #: link of the URDF
    xyz: Vector3 = (0.0, 0.0, 0.0)  #: origin in the link's frame [m]
    rpy: Vector3 = (0.0, 0.0, 0.0)  #: roll, pitch, yaw in the link's frame [rad]


@dataclass(frozen=True, slots=True, config=STRICT)
class Sole:
    """The flat contact surface of one foot: z = 0 plane of the sole frame, x forward, z up."""

    link: str  #: link of the URDF that carries the sole
    xyz: Vector3  #: origin of the sole frame in the link's frame [m]
    #: x_min, x_max, y_min, y_max of the contact rectangle in the sole frame [m]
    rectangle: tuple[float, float, float, float]
    rpy: Vector3 = (0.0, 0.0, 0.0)  #: roll, pitch, yaw in the link's frame [rad]

    def __post_init__(self) -> None:
        x_min, x_max, y_min, y_max = self.rectangle
        if not (x_min < x_max and y_min < y_max):
            raise ValueError(f"rectangle {self.rectangle} must have x_min < x_max and y_min < y_max")


@dataclass(frozen=True, slots=True, config=STRICT)
class Feet:
    """Both soles and their nominal friction."""

    left: Sole
    right: Sole
    friction: Annotated[float, Field(gt=0.0, le=2.0)]  #: Coulomb coefficient of sole on floor [-]


@dataclass(frozen=True, slots=True, config=STRICT)
class Hull:
    """Collision geometry of a link: capsule of ``radius`` around a segment (a sphere when both ends coincide)."""

    link: str  #: link of the URDF
    start: Vector3  #: first end of the segment in the link's frame [m]
    end: Vector3  #: second end of the segment in the link's frame [m]
    radius: Positive  #: [m]


@dataclass(frozen=True, slots=True, config=STRICT)
class ImuSensor:
    """Noise of the IMU at frame `imu`."""

    gyro_noise_density: NonNegative  #: [rad/s/sqrt(Hz)]
    gyro_bias: NonNegative  #: standard deviation of the turn-on bias [rad/s]
    accel_noise_density: NonNegative  #: [m/s^2/sqrt(Hz)]
    accel_bias: NonNegative  #: standard deviation of the turn-on bias [m/s^2]
    gyro_range: Positive  #: full scale [rad/s]
    accel_range: Positive  #: full scale [m/s^2]
    gyro_bias_walk: NonNegative = 0.0  #: drift of the bias [rad/s/sqrt(s)]
    accel_bias_walk: NonNegative = 0.0  #: drift of the bias [m/s^2/sqrt(s)]
    misalignment: NonNegative = 0.0  #: standard deviation of the mounting rotation, each axis [rad]
    gyro_scale: NonNegative = 0.0  #: standard deviation of the scale error [-]
    accel_scale: NonNegative = 0.0  #: standard deviation of the scale error [-]
    gyro_resolution: NonNegative = 0.0  #: step of the output; 0: not rounded [rad/s]
    accel_resolution: NonNegative = 0.0  #: step of the output; 0: not rounded [m/s^2]


@dataclass(frozen=True, slots=True, config=STRICT)
class EncoderSensor:
    """Quantisation and noise of the joint encoders and of the torque estimate."""

    resolution: NonNegative  #: position resolution at the joint [rad]
    velocity_noise: NonNegative  #: standard deviation [rad/s]
    torque_noise: NonNegative  #: standard deviation, relative to the torque limit [-]
    offset: NonNegative = 0.0  #: standard deviation of the zero offset of each joint [rad]


@dataclass(frozen=True, slots=True, config=STRICT)
class FootSensor:
    """Noise of the force-torque sensor of each sole."""

    force_noise: NonNegative  #: standard deviation, each axis [N]
    torque_noise: NonNegative  #: standard deviation, each axis [N.m]
    force_offset: NonNegative  #: standard deviation of the turn-on offset [N]
    torque_offset: NonNegative  #: standard deviation of the turn-on offset [N.m]
    gain: NonNegative = 0.0  #: standard deviation of the gain error of each axis [-]
    crosstalk: NonNegative = 0.0  #: std of the reading of an axis at full scale of another, over its scale [-]
    force_range: Annotated[float | None, Field(gt=0.0)] = None  #: full scale; none: unlimited [N]
    torque_range: Annotated[float | None, Field(gt=0.0)] = None  #: full scale; none: unlimited [N.m]
    force_resolution: NonNegative = 0.0  #: step of the output; 0: not rounded [N]
    torque_resolution: NonNegative = 0.0  #: step of the output; 0: not rounded [N.m]
    fitted: bool = True  #: whether the robot has these sensors; if not, they read nan

    def __post_init__(self) -> None:
        if self.crosstalk > 0.0 and (self.force_range is None or self.torque_range is None):
            raise ValueError("crosstalk is a share of full scale: it needs force_range and torque_range")


@dataclass(frozen=True, slots=True, config=STRICT)
class ScanSensor:
    """A planar laser scanner at frame `scan`, x forward and z up."""

    angle_min: Annotated[float, Field(ge=-6.2832, le=6.2832)]  #: direction of the first ray [rad]
    angle_max: Annotated[float, Field(ge=-6.2832, le=6.2832)]  #: direction of the last ray [rad]
    rays: Annotated[int, Field(ge=2, le=20000)]  #: number of readings per scan [1]
    range_min: NonNegative  #: minimum measured distance [m]
    range_max: Positive  #: maximum measured distance [m]
    rate: Annotated[float, Field(gt=0.0, le=1000.0)]  #: scan rate [Hz]
    noise: NonNegative = 0.0  #: standard deviation of a distance [m]

    def __post_init__(self) -> None:
        if not 0.0 < self.angle_max - self.angle_min <= 6.2832:
            raise ValueError(
                f"angle_min {self.angle_min} and angle_max {self.angle_max} rad must span more than 0, at most a turn"
            )
        if self.range_min >= self.range_max:
            raise ValueError(f"range_min {self.range_min} m is not below range_max {self.range_max} m")


@dataclass(frozen=True, slots=True, config=STRICT)
class CameraSensor:
    """A colour camera without distortion at frame `camera_optical_frame`: x right, y down, z forward (REP-103)."""

    width: Annotated[int, Field(ge=16, le=4096)]  #: image width [pixel]
    height: Annotated[int, Field(ge=16, le=4096)]  #: image height [pixel]
    horizontal_fov: Annotated[float, Field(ge=0.1, le=2.8)]  #: horizontal field of view [rad]
    rate: Annotated[float, Field(gt=0.0, le=1000.0)]  #: image rate [Hz]


@dataclass(frozen=True, slots=True, config=STRICT)
class Head:
    """Joints that move the head and its camera."""

    pan: str  #: joint that yaws the head
    tilt: str  #: joint that pitches the head

    def __post_init__(self) -> None:
        if self.pan == self.tilt:
            raise ValueError(f"pan and tilt are the same joint '{self.pan}'")


@dataclass(frozen=True, slots=True, config=STRICT)
class Latency:
    """Transport delays of the robot's electronics."""

    sensors: NonNegative  #: from measurement to arrival at the computer [s]
    commands: NonNegative  #: from sending a command to its effect in the driver [s]
    jitter: NonNegative = 0.0  #: maximum age of a sample at its stamp; limited to one tick [s]


@dataclass(frozen=True, slots=True, config=STRICT)
class Sensors:
    """Sensors and their errors."""

    imu: ImuSensor
    encoders: EncoderSensor
    feet: FootSensor
    latency: Latency
    scan: ScanSensor | None = None
    camera: CameraSensor | None = None
    depth: DepthSensor | None = None
    lidar: LidarSensor | None = None


@dataclass(frozen=True, slots=True, config=STRICT)
class Thresholds:
    """Thresholds of one measurement for a warning, a hold and damping."""

    warn: float  #: a warning appears in the diagnostics
    hold: float  #: no new motion, no walking velocity
    damp: float  #: the drives are damped

    def __post_init__(self) -> None:
        if not (self.warn <= self.hold <= self.damp or self.warn >= self.hold >= self.damp):
            raise ValueError(f"warn {self.warn}, hold {self.hold} and damp {self.damp} are not in order")

    @property
    def rising(self) -> bool:
        """Whether values above the thresholds are faults, rather than values below."""
        return self.warn <= self.damp


@dataclass(frozen=True, slots=True, config=STRICT)
class Hardware:
    """Limits of the monitors of a real robot."""

    motor_temperature: Thresholds  #: winding or housing of the hottest motor [degC]
    lost_packets: Thresholds  #: share of state messages lost within a second [-]
    torque_saturation: Thresholds  #: share of a second that a joint spends at its torque limit [-]
    saturation: Share  #: share of the torque limit above which a joint counts as at the limit [-]
    foreign_commands: Thresholds  #: rate of LowCmds of other programs; ``persistence`` does not apply [Hz]
    motor_error: Literal["warn", "hold", "damp"]  #: reaction to an error word of a drive
    stop_buttons: Annotated[tuple[str, ...], Field(min_length=1)]  #: buttons of the remote controller for damping
    persistence: Positive  #: minimum time of a value beyond a threshold [s]
    #: lowest supply voltage of the drives; 0: not measured; none for a robot that does not measure it [V]
    voltage: Thresholds | None = None
    mode_machine: Annotated[int, Field(ge=0, le=255)] | None = None  #: Unitree: robot type as reported by the robot [1]
    own_commands: NonNegative = 0.0  #: rate of LowCmds of the robot's built-in controller while it is active [Hz]
    switcher_version: str = ""  #: Unitree: version of the motion switcher, which releases its controller; if any


@dataclass(frozen=True, slots=True, config=STRICT)
class Payload:
    """Mass and CoM shift of the robot relative to its URDF, in the torso; ``poise identify`` measures them."""

    mass: float = 0.0  #: added mass of the torso; negative for a lighter robot [kg]
    com: tuple[float, float] = (0.0, 0.0)  #: shift of the CoM of the whole robot, forward and left [m]


@dataclass(frozen=True, slots=True, config=STRICT)
class Profile:
    """A complete robot; the packaged files are commented examples."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]  #: short name of the robot
    urdf: Annotated[str, Field(min_length=1)]  #: package://PACKAGE/PATH, absolute path, or path relative to this file
    base_link: str  #: root link of the URDF: the floating base
    motors: dict[str, Motor]
    joints: dict[str, Joint]  #: every moving joint of the URDF, by name
    feet: Feet
    frames: dict[str, Frame]  #: REP-120 frames by name
    postures: dict[str, dict[str, float]]  #: joint positions by name [rad]; omitted joints are at 0
    sensors: Sensors
    head: Head | None = None  #: joints of pan and tilt; none for a fixed head
    #: postures for calibration, in which a jig or marks hold the robot
    jig_postures: tuple[str, ...] = ("zero", "stand")
    #: collision geometry with the simulated floor after a fall, by name
    hulls: dict[str, Hull] = field(default_factory=dict)
    #: overrides of the packaged configuration of the laws, as nested keys by file name
    laws: dict[Law, dict[str, Any]] = field(default_factory=dict)
    payload: Payload = Payload()  #: added to the URDF's masses in the laws, not in the simulated robot
    hardware: Hardware | None = None  #: limits of the monitors of the real robot; none if unknown
    source: str = ""  #: file of the profile; set by the loader

    def __post_init__(self) -> None:
        known = ", ".join(sorted(self.motors))
        for name, joint in self.joints.items():
            if joint.motor not in self.motors:
                raise ValueError(f"joint '{name}': unknown motor '{joint.motor}'; known: {known}")
        of: dict[tuple[str, ...], str] = {}
        for name, joint in self.joints.items():
            for each in (name, *joint.aliases):
                if of.setdefault(joint_key(each), name) != name:
                    raise ValueError(f"joint '{name}': '{each}' is a name of '{of[joint_key(each)]}' too")
        for frame in REQUIRED_FRAMES:
            if frame not in self.frames:
                raise ValueError(f"frames: '{frame}' is missing")
        for frame in RESERVED_FRAMES:
            if frame in self.frames:
                raise ValueError(f"frames: '{frame}' is defined by the loader; remove it here")
        mounts = {"scan": "scan", "camera": CAMERA_FRAME, "depth": DEPTH_FRAME, "lidar": LIDAR_FRAME}
        for sensor, frame in mounts.items():
            if getattr(self.sensors, sensor) is not None and frame not in self.frames:
                raise ValueError(f"frames: '{frame}' is missing, where sensors.{sensor} is mounted")
        for name in () if self.head is None else (self.head.pan, self.head.tilt):
            if name not in self.joints:
                raise ValueError(f"head: unknown joint '{name}'")
        if "stand" not in self.postures:
            raise ValueError("postures: 'stand' is missing")
        if "zero" in self.postures:
            raise ValueError("postures: 'zero' is built in; remove it here")
        for posture, values in self.postures.items():
            for joint_name in values:
                if joint_name not in self.joints:
                    raise ValueError(f"posture '{posture}': unknown joint '{joint_name}'")
        for posture in self.jig_postures:
            if posture != "zero" and posture not in self.postures:
                raise ValueError(f"jig_postures: unknown posture '{posture}'")


def robot_names() -> list[str]:
    """Names of the packaged profiles, sorted."""
    return sorted(entry.stem for entry in _robots_folder().glob("*.yaml"))


def _robots_folder() -> Path:
    return Path(str(files("models"))) / "robots"


def load_profile(name_or_path: str | Path) -> Profile:
    """Load a robot profile by packaged name or path, and set its ``source``; ``ConfigError`` names file and key.

    The key ``extends`` names a base profile by name or path; the values of the profile override those of the base.
    """
    path = _profile_path(name_or_path, Path())
    profile = parse_config(Profile, _profile_data(path), str(path))
    if profile.source:
        raise ConfigError(f"{path}: source: is filled in by the loader; remove it")
    object.__setattr__(profile, "source", str(path))
    return profile


def _profile_data(path: Path, above: tuple[Path, ...] = ()) -> dict[str, Any]:
    """Values of a profile merged over its base profile; the URDF of the base becomes an absolute path."""
    data = read_yaml(path)
    extended = data.pop("extends", None)
    if extended is None:
        return data
    below = _profile_path(str(extended), path.parent)
    if below in (path, *above):
        raise ConfigError(f"{path}: extends: '{extended}' extends this profile")
    base = _profile_data(below, (path, *above))
    base["urdf"] = str(resolve_uri(str(base.get("urdf", "")), below.parent))
    return merged(base, data)


def _profile_path(name_or_path: str | Path, folder: Path) -> Path:
    """File of a profile by packaged name or by path, relative to ``folder``."""
    text = str(name_or_path)
    is_path = isinstance(name_or_path, Path) or text.endswith((".yaml", ".yml")) or "/" in text
    path = (folder / Path(text).expanduser()).resolve() if is_path else _robots_folder() / f"{text}.yaml"
    if not is_path and not path.is_file():
        raise ConfigError(f"unknown robot '{text}'; known: {', '.join(robot_names())} (or the path of a profile)")
    return path
