"""Motion files: the schema of ``planners/motions/*.yaml``, loading and validation."""

from collections.abc import Container, Iterable
from dataclasses import field, replace
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, load_config
from models.errors import ConfigError
from models.robot_model import RobotModel
from models.types import Vector3
from planners.goals import TARGET_FRAMES

START = "start"  #: Posture name of the start of a motion, in addition to the postures of the robot's profile
JointValues = dict[str, dict[str, float]]


@dataclass(frozen=True, slots=True, config=STRICT)
class FrameTarget:
    """Target of one frame in a key pose."""

    offset: Vector3 | None = None  #: position relative to `anchor`, along base_footprint's axes [unit]
    anchor: str | None = None  #: frame whose position in 'stand' is the origin of the offset; default: this frame
    #: unit of the offset: metre, height of base_link in 'stand' or height of gaze in 'stand'
    unit: Literal["m", "leg", "stature"] = "m"
    axes: Annotated[str, Field(pattern="^(x?y?z?)$", min_length=1)] = "xyz"  #: axes along which the offset is a target
    rpy: Vector3 | None = None  #: roll, pitch, yaw about base_footprint's axes, relative to 'stand' [rad]
    settable: bool = False  #: whether a caller may override the position

    def __post_init__(self) -> None:
        if self.offset is None and self.rpy is None:
            raise ValueError("give offset, rpy or both")
        if self.offset is None and (self.settable or self.anchor is not None):
            raise ValueError("anchor and settable need an offset")


@dataclass(frozen=True, slots=True, config=STRICT)
class KeyPose:
    """One key pose of a motion."""

    name: Annotated[str, Field(min_length=1)]  #: name in messages
    duration: Annotated[float, Field(gt=0.0, le=60.0)]  #: duration of the motion to it; longer if joints need it [s]
    hold: Annotated[float, Field(ge=0.0, le=60.0)] = 0.0  #: time at rest in it [s]
    posture: str = "stand"  #: preferred posture of free joints: a named one, or 'start'
    frames: dict[str, FrameTarget] = field(default_factory=dict)  #: targets by frame
    joints: Annotated[JointValues, Field(description="joint targets by robot and joint [rad]")] = field(
        default_factory=dict
    )
    prefer: JointValues = field(default_factory=dict)  #: joint values that override `posture`, by robot and joint [rad]


@dataclass(frozen=True, slots=True, config=STRICT)
class Motion:
    """Sequence of key poses; the motion ends at rest in the last one."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]  #: name in commands
    description: Annotated[str, Field(min_length=1)]  #: one-line description
    key_poses: Annotated[tuple[KeyPose, ...], Field(min_length=1)]  #: in order

    @property
    def settable_frames(self) -> tuple[str, ...]:
        """Frames whose position a caller may override, sorted."""
        return tuple(sorted({name for pose in self.key_poses for name, t in pose.frames.items() if t.settable}))


SIDES = {"l_wrist": "r_wrist", "r_wrist": "l_wrist"}  #: Mirror image of each frame that has one


def mirrored(motion: Motion) -> Motion:
    """Motion mirrored at the robot's sagittal plane; joint values are specific to one robot and stay unchanged."""
    poses = [
        replace(pose, frames={SIDES.get(frame, frame): _mirrored(target) for frame, target in pose.frames.items()})
        for pose in motion.key_poses
    ]
    return replace(motion, key_poses=tuple(poses))


def _mirrored(target: FrameTarget) -> FrameTarget:
    offset, rpy, anchor = target.offset, target.rpy, target.anchor
    return replace(
        target,
        offset=None if offset is None else (offset[0], -offset[1], offset[2]),
        rpy=None if rpy is None else (-rpy[0], rpy[1], -rpy[2]),
        anchor=None if anchor is None else SIDES.get(anchor, anchor),
    )


def load_library(model: RobotModel, extra: Iterable[str | Path] = ()) -> dict[str, Motion]:
    """Packaged motions and those of the files ``extra``, by name. ``ConfigError`` names file and key."""
    packaged = Path(str(files("planners"))) / "motions"
    library: dict[str, Motion] = {}
    for path in [*sorted(packaged.glob("*.yaml")), *(Path(entry) for entry in extra)]:
        motion = load_motion(path, model)
        if motion.name in library:
            raise ConfigError(f"{path}: name: a motion '{motion.name}' exists already; give another name")
        library[motion.name] = motion
    return dict(sorted(library.items()))


def motion_files(folder: Path) -> tuple[Path, ...]:
    """Motion files (*.yaml) in a folder, sorted; ``ConfigError`` if there are none."""
    found = tuple(sorted(folder.glob("*.yaml")))
    if not found:
        raise ConfigError(f"{folder}: no motion files (*.yaml) there")
    return found


def load_motion(path: Path, model: RobotModel) -> Motion:
    """Read a motion file and validate it against a robot; ``ConfigError`` names the file and the key."""
    motion = load_config(Motion, path)
    for i, pose in enumerate(motion.key_poses):
        where = f"{path}: key_poses.{i}"
        if pose.posture != START and pose.posture not in model.posture_names:
            known = ", ".join((START, *model.posture_names))
            raise ConfigError(f"{where}.posture: unknown posture '{pose.posture}'; known: {known}")
        for frame, target in pose.frames.items():
            _check_frame(frame, f"{where}.frames.{frame}")
            if target.anchor is not None:
                _check_frame(target.anchor, f"{where}.frames.{frame}.anchor")
        for key, sections in (("joints", pose.joints), ("prefer", pose.prefer)):
            for joint, value in sections.get(model.name, {}).items():
                _check_joint(model, joint, value, f"{where}.{key}.{model.name}.{joint}")
    return motion


def _check_frame(frame: str, where: str) -> None:
    if frame not in TARGET_FRAMES:
        raise ConfigError(f"{where}: a motion cannot move frame '{frame}'; it can move: {', '.join(TARGET_FRAMES)}")


def _check_joint(model: RobotModel, joint: str, value: float, where: str) -> None:
    if joint not in model.joint_names:
        raise ConfigError(f"{where}: {model.name} has no joint '{joint}'")
    i = model.joint_index(joint)
    if not model.q_lower[i] <= value <= model.q_upper[i]:
        raise ConfigError(f"{where}: {value:g} rad is outside [{model.q_lower[i]:g}, {model.q_upper[i]:g}]")


def calibration_motions() -> tuple[Path, ...]:
    """Files for the ``extra`` of ``MotionPlanner``: 'calibrate_joints' and 'calibrate_feet'."""
    return tuple(sorted((Path(str(files("planners"))) / "motions" / "calibration").glob("*.yaml")))


def variant(motion: str, robot: str, names: Container[str]) -> str:
    """Robot-specific version of a motion, ``<motion>_<robot>``, if ``names`` contains it; otherwise the motion."""
    own = f"{motion}_{robot}"
    return own if own in names else motion
