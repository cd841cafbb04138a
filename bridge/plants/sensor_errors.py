"""Errors of the simulated sensors beyond those of the profile."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from models.config import parse_yaml, read_yaml
from models.errors import ConfigError
from models.robot_model import RobotModel
from models.types import FOOT_NAMES, Matrix, Vector


@dataclass(frozen=True, slots=True)
class FootFault:
    """A foot sensor, 'left' or 'right', with a constant output.

    Attributes:
        wrench: Output in the sole frame (6,) [N, N.m]: zero for stuck off, nan for absent.
        start: Stamp of its beginning [s].
        end: Stamp of its end [s].

    Raises:
        ConfigError: The foot is unknown, the wrench does not have six numbers, or the end is not after the start.
    """

    foot: str
    wrench: ArrayLike = 0.0
    start: float = 0.0
    end: float = math.inf

    def __post_init__(self) -> None:
        if self.foot not in FOOT_NAMES:
            raise ConfigError(f"foot fault: unknown foot '{self.foot}'; known: {', '.join(FOOT_NAMES)}")
        if np.shape(self.wrench) not in ((), (6,)):
            raise ConfigError(f"foot fault: wrench of shape {np.shape(self.wrench)}, expected one number or six")
        if not self.start < self.end:
            raise ConfigError(f"foot fault: it ends at {self.end} s, before it begins at {self.start} s")

    def apply(self, t: float, wrenches: Matrix) -> None:
        """Apply the fault to the wrenches (2, 6) [N, N.m] of a stamp [s]."""
        if self.start <= t < self.end:
            wrenches[FOOT_NAMES.index(self.foot)] = self.wrench


@dataclass(frozen=True, slots=True)
class SensorErrors:
    """Sensor errors for tests and calibrations.

    They add to those drawn from the profile and are not scaled by ``sensor_noise``. A single number stands for every
    axis or joint.
    """

    gyro_bias: ArrayLike = 0.0  #: Constant error of the angular rate (3,) [rad/s]
    accel_bias: ArrayLike = 0.0  #: Constant error of the specific force (3,) [m/s^2]
    misalignment: ArrayLike = 0.0  #: Rotation vector from the nominal to the true mounting of the IMU (3,) [rad]
    gyro_scale: ArrayLike = 0.0  #: Relative gain error of each axis (3,) [-]
    accel_scale: ArrayLike = 0.0  #: The same for the accelerometer (3,) [-]
    #: Measured minus true position, for all joints (nj,) or by joint name [rad]
    encoder_offsets: ArrayLike | Mapping[str, float] = field(default=0.0)
    force_offsets: ArrayLike = 0.0  #: Force that each foot reads without load, in its sole frame (2, 3) [N]
    torque_offsets: ArrayLike = 0.0  #: The same for the torque (2, 3) [N.m]
    wrench_gains: ArrayLike = 0.0  #: Relative gain error of each axis of each foot (2, 6) [-]
    foot_faults: tuple[FootFault, ...] = ()  #: Foot sensors that fail, and when

    def array(self, name: str, shape: tuple[int, ...]) -> Matrix:
        """One field as an array of a shape; ``ConfigError`` names a field of another shape or not finite."""
        try:
            value = np.array(np.broadcast_to(np.asarray(getattr(self, name), dtype=np.float64), shape))
        except (TypeError, ValueError) as error:
            raise ConfigError(f"sensor_errors.{name}: expected one number or the shape {shape}: {error}") from error
        if not np.isfinite(value).all():
            raise ConfigError(f"sensor_errors.{name}: not finite")
        return value

    def offsets(self, model: RobotModel) -> Vector:
        """Encoder offsets (nj,) [rad]; ``JointNameError`` for unknown joints, ``ConfigError`` for bad values."""
        if not isinstance(self.encoder_offsets, Mapping):
            return self.array("encoder_offsets", (model.nj,))
        result = np.zeros(model.nj)
        for joint, value in self.encoder_offsets.items():
            try:
                result[model.joint_index(joint)] = float(value)
            except (TypeError, ValueError) as error:
                raise ConfigError(f"sensor_errors.encoder_offsets.{joint}: {value!r} is not a number") from error
        if not np.isfinite(result).all():
            raise ConfigError("sensor_errors.encoder_offsets: not finite")
        return result


def read_sensor_errors(text: str) -> SensorErrors | None:
    """Sensor errors of a YAML file, or of YAML itself, such as ``{gyro_bias: [0.05, 0, 0], force_offsets: 15}``.

    An empty text means no errors. Raises ``ConfigError`` for no mapping or an unknown error; values are checked later.
    """
    if not text.strip():
        return None
    inline = text.lstrip().startswith("{")
    data = parse_yaml(text, "sensor_errors") if inline else read_yaml(Path(text))
    known = [entry.name for entry in fields(SensorErrors)]
    unknown = [str(key) for key in data if key not in known]
    if unknown:
        source = "sensor_errors" if inline else text
        raise ConfigError(f"{source}: unknown key '{unknown[0]}'; known: {', '.join(known)}")
    return SensorErrors(**data)
