"""Calibration file of a robot: written atomically, validated on reading, with previous versions kept."""

import os
from dataclasses import field, replace
from datetime import datetime
from pathlib import Path
from typing import Literal

import numpy as np
import yaml
from pydantic.dataclasses import dataclass

from models.calibration import Calibration, CalibrationLimits, implausible
from models.config import STRICT, default_config, load_config
from models.constants import FOOT_NAMES
from models.errors import ConfigError, JointNameError
from models.files import user_folder
from models.robot_model import RobotModel
from models.types import Vector3

DIRECTORY_VARIABLE = "POISE_CALIBRATION_DIR"  #: Environment variable that names the folder of the calibration files
SCHEMA = 1  #: Version of the file format; other versions are refused


@dataclass(frozen=True, slots=True, config=STRICT)
class _Foot:
    force_offset: Vector3  #: [N]
    torque_offset: Vector3  #: [N.m]
    force_gain: float  #: [-]


@dataclass(frozen=True, slots=True, config=STRICT)
class _File:
    schema_version: Literal[1]
    robot: str
    written: str  #: time of writing, ISO 8601 with time zone
    gyro_bias: Vector3  #: [rad/s]
    accel_bias: Vector3  #: [m/s^2]
    encoder_offsets: dict[str, float]  #: of every joint, by name [rad]
    feet: dict[Literal["left", "right"], _Foot]  #: both feet
    #: time of the calibration of each part, ISO 8601
    calibrated: dict[Literal["imu", "joints", "feet"], str] = field(default_factory=dict)
    complete: Literal[True] | None = None  #: last line of the file; marks it as complete

    def __post_init__(self) -> None:
        for name, stamp in (("written", self.written), *self.calibrated.items()):
            try:
                aware = datetime.fromisoformat(stamp).tzinfo is not None
            except ValueError as error:
                raise ValueError(f"{name}: '{stamp}' is not a time stamp") from error
            if not aware:
                raise ValueError(f"{name}: '{stamp}' has no time zone")
        if set(self.feet) != set(FOOT_NAMES):
            raise ValueError(f"feet: expected {' and '.join(FOOT_NAMES)}, found {', '.join(self.feet) or 'none'}")
        if not self.complete:
            raise ValueError("half-written: the last line 'complete: true' is missing")


def calibration_directory() -> Path:
    """``$POISE_CALIBRATION_DIR``, else ``poise/calibration`` in ``$XDG_CONFIG_HOME`` or in ``~/.config``."""
    given = os.environ.get(DIRECTORY_VARIABLE)
    if given:
        return Path(given)
    return user_folder("calibration", "XDG_CONFIG_HOME", ".config")


class CalibrationStore:
    """Reads and writes ``<folder>/<robot>.yaml``; suffixes ``.1``, ``.2``, ... mark previous versions, newest first.

    In a ROS namespace the file is ``<robot>.<namespace>.yaml``, so that two robots of one type do not share a file.
    A new file is written beside the old one, flushed to disk, and renamed over it. After any interruption the name
    refers to a complete file.

    ``directory`` defaults to ``calibration_directory()`` and is created by the first write; ``namespace`` is empty or
    ``/`` for none.
    """

    def __init__(self, model: RobotModel, directory: str | Path | None = None, namespace: str = "") -> None:
        folder = calibration_directory() if directory is None else Path(directory).expanduser()
        self.path = folder / f"{'.'.join([model.name, *filter(None, namespace.split('/'))])}.yaml"
        self._model = model
        self._limits = default_config(CalibrationLimits, "models", "calibration")

    def load(self) -> tuple[Calibration, tuple[str, ...]]:
        """Newest usable calibration, else one without corrections; and the reasons why newer files were refused."""
        refused: list[str] = []
        for path in self.files():
            try:
                return self.read(path), tuple(refused)
            except (ConfigError, JointNameError) as error:
                refused.append(str(error))
        return Calibration.none(self._model), tuple(refused)

    def files(self) -> list[Path]:
        """Existing files, newest first."""
        names = [self.path, *(self._kept(i) for i in range(1, self._limits.keep + 1))]
        return [path for path in names if path.is_file()]

    def read(self, path: Path) -> Calibration:
        """Read and validate one file; ``ConfigError`` or ``JointNameError`` names the file and the key."""
        data = load_config(_File, path)
        if data.robot != self._model.name:
            raise ConfigError(f"{path}: robot: is for '{data.robot}', not for '{self._model.name}'")
        try:
            offsets = self._model.reorder(list(data.encoder_offsets), list(data.encoder_offsets.values()))
        except JointNameError as error:
            raise JointNameError(f"{path}: encoder_offsets: {error}") from error
        feet = [data.feet["left"], data.feet["right"]]
        calibration = Calibration(
            robot=data.robot,
            gyro_bias=np.array(data.gyro_bias),
            accel_bias=np.array(data.accel_bias),
            encoder_offsets=offsets,
            wrench_offsets=np.array([[*foot.force_offset, *foot.torque_offset] for foot in feet]),
            force_gains=np.array([foot.force_gain for foot in feet]),
            stamps=tuple(data.calibrated.items()),
        )
        problem = implausible(calibration, self._model, self._limits)
        if problem:
            raise ConfigError(f"{path}: implausible: {problem}")
        return calibration

    def save(self, calibration: Calibration, *, now: datetime, what: str | None = None) -> Calibration:
        """Write a calibration and return it with the stamp ``now`` for ``what``; the current file becomes ``.1``.

        Raises ``ConfigError`` for another robot, an implausible value, a stamp without time zone, or a failed write.
        """
        if now.tzinfo is None:
            raise ConfigError("calibration: the time stamp has no time zone")
        if calibration.robot != self._model.name:
            raise ConfigError(f"calibration is for '{calibration.robot}', not for '{self._model.name}'")
        problem = implausible(calibration, self._model, self._limits)
        if problem:
            raise ConfigError(f"calibration is implausible: {problem}")
        stamp = now.isoformat(timespec="seconds")
        if what is not None:
            calibration = replace(calibration, stamps=tuple({**dict(calibration.stamps), what: stamp}.items()))
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            fresh = self._write(_text(calibration, self._model, stamp))
            self._shift()
            fresh.replace(self.path)
            _sync(self.path.parent)
        except OSError as error:
            raise ConfigError(f"{self.path}: cannot be written: {error.strerror}") from error
        return calibration

    def rollback(self) -> Calibration:
        """Restore the previous file and keep the current one as ``.rejected``; ``ConfigError`` when none is usable."""
        for path in self.files():
            if path == self.path:
                continue
            try:
                previous = self.read(path)
            except (ConfigError, JointNameError):
                continue
            try:
                if self.path.is_file():
                    self.path.replace(self.path.with_name(f"{self.path.name}.rejected"))
                path.replace(self.path)
                self._close_gaps()
                _sync(self.path.parent)
            except OSError as error:
                raise ConfigError(f"{self.path}: cannot be rolled back: {error.strerror}") from error
            return previous
        raise ConfigError(f"{self.path}: there is no previous calibration to return to")

    def _kept(self, age: int) -> Path:
        return self.path.with_name(f"{self.path.name}.{age}")

    def _write(self, text: str) -> Path:
        """Write a new file beside the current one and flush it to disk."""
        fresh = self.path.with_name(f".{self.path.name}.tmp")
        with fresh.open("w", encoding="utf-8") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        return fresh

    def _shift(self) -> None:
        """Shift the suffixes of the kept files by one; the current file is linked, so that its name always exists."""
        if not self.path.is_file():
            return
        for age in range(self._limits.keep - 1, 0, -1):
            if self._kept(age).is_file():
                self._kept(age).replace(self._kept(age + 1))
        self._kept(1).unlink(missing_ok=True)
        os.link(self.path, self._kept(1))

    def _close_gaps(self) -> None:
        kept = [path for path in self.files() if path != self.path]
        for age, path in enumerate(kept, start=1):
            if path != self._kept(age):
                path.replace(self._kept(age))


def _text(calibration: Calibration, model: RobotModel, stamp: str) -> str:
    """Text of the file; the last line marks it as complete."""
    wrenches, gains = calibration.wrench_offsets.tolist(), calibration.force_gains.tolist()
    data = {
        "schema_version": SCHEMA,
        "robot": calibration.robot,
        "written": stamp,
        "calibrated": dict(calibration.stamps),
        "gyro_bias": calibration.gyro_bias.tolist(),
        "accel_bias": calibration.accel_bias.tolist(),
        "encoder_offsets": dict(zip(model.joint_names, calibration.encoder_offsets.tolist(), strict=True)),
        "feet": {
            foot: {"force_offset": row[:3], "torque_offset": row[3:], "force_gain": gain}
            for foot, row, gain in zip(FOOT_NAMES, wrenches, gains, strict=True)
        },
    }
    head = "# Sensor calibration; units in docs/calibration.md. Written by a calibration, not by hand.\n"
    return head + yaml.safe_dump(data, sort_keys=False, default_flow_style=None) + "complete: true\n"


def _sync(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
