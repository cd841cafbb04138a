"""Errors put into the simulated sensors on purpose, on top of those that the profile and the seed give."""

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
    """A foot sensor that says the same whatever it feels.

    Attributes:
        foot: 'left' or 'right'.
        wrench: What it says, in its sole frame (6,) [N, N.m]: zero for stuck off, nan for absent.
        start: Stamp from which it does [s].
        end: Stamp from which it does no longer [s].

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

    def spoil(self, t: float, wrenches: Matrix) -> None:
        """Put the fault into a sample (2, 6) [N, N.m] of a stamp [s]."""
        if self.start <= t < self.end:
            wrenches[FOOT_NAMES.index(self.foot)] = self.wrench


@dataclass(frozen=True, slots=True)
class SensorErrors:
    """What a sensor is to get wrong, for tests and for trying a calibration out.

    The errors add to those drawn from the profile, and ``sensor_noise`` does not scale them: with exact sensors they
    are all there is. A single number stands for every axis or joint.

    Attributes:
        gyro_bias: Constant error of the angular rate (3,) [rad/s].
        accel_bias: Constant error of the specific force (3,) [m/s^2].
        misalignment: Rotation vector from the nominal to the true mounting of the inertial unit (3,) [rad].
        gyro_scale: Share by which each axis reads too much (3,) [-].
        accel_scale: The same for the accelerometer (3,) [-].
        encoder_offsets: Measured minus true position, for all joints (nj,) or by joint name [rad].
        force_offsets: What each foot's force reads at no load, in its sole frame, per foot (2, 3) [N].
        torque_offsets: The same for the torque (2, 3) [N.m].
        wrench_gains: Share by which each axis of each foot reads too much (2, 6) [-].
        foot_faults: Foot sensors that fail, and when.
    """

    gyro_bias: ArrayLike = 0.0
    accel_bias: ArrayLike = 0.0
    misalignment: ArrayLike = 0.0
    gyro_scale: ArrayLike = 0.0
    accel_scale: ArrayLike = 0.0
    encoder_offsets: ArrayLike | Mapping[str, float] = field(default=0.0)
    force_offsets: ArrayLike = 0.0
    torque_offsets: ArrayLike = 0.0
    wrench_gains: ArrayLike = 0.0
    foot_faults: tuple[FootFault, ...] = ()

    def array(self, name: str, shape: tuple[int, ...]) -> Matrix:
        """One field as an array of a shape.

        Raises:
            ConfigError: It does not have that shape, or is not finite; names the field.
        """
        try:
            value = np.array(np.broadcast_to(np.asarray(getattr(self, name), dtype=np.float64), shape))
        except (TypeError, ValueError) as error:
            raise ConfigError(f"sensor_errors.{name}: expected one number or the shape {shape}: {error}") from error
        if not np.isfinite(value).all():
            raise ConfigError(f"sensor_errors.{name}: not finite")
        return value

    def offsets(self, model: RobotModel) -> Vector:
        """Encoder offsets in the order of the joints (nj,) [rad].

        Raises:
            JointNameError: A joint does not exist.
            ConfigError: The values are unusable.
        """
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

    Args:
        text: The mapping, or path of a file that holds it; empty for no errors.

    Raises:
        ConfigError: It is no such mapping, or names an error that does not exist. Values are checked by their user.
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
