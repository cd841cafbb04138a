"""Which corrections of a sensor are plausible; the schema of ``models/config/calibration.yaml``."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from models.calibration import Calibration
from models.config import STRICT
from models.robot_model import RobotModel
from models.types import FOOT_NAMES, Vector


@dataclass(frozen=True, slots=True, config=STRICT)
class CalibrationLimits:
    """Largest plausible corrections, and how many calibration files are kept."""

    gyro_bias: Annotated[float, Field(gt=0.0, description="each axis [rad/s]")]
    accel_bias: Annotated[float, Field(gt=0.0, description="each axis [m/s^2]")]
    encoder_offset: Annotated[float, Field(gt=0.0, description="each joint [rad]")]
    force_offset: Annotated[float, Field(gt=0.0, description="each axis [N]")]
    torque_offset: Annotated[float, Field(gt=0.0, description="each axis [N.m]")]
    force_gain: Annotated[float, Field(gt=0.0, lt=1.0, description="deviation of a gain from 1 [-]")]
    keep: Annotated[int, Field(ge=1, le=100, description="previous files that are kept [1]")]


def implausible(calibration: Calibration, model: RobotModel, limits: CalibrationLimits) -> str:
    """What is wrong with a calibration.

    Returns:
        The first value that is not finite or beyond its limit, by name; empty when there is none.
    """
    checks = _axes("gyro_bias", calibration.gyro_bias, limits.gyro_bias, "rad/s")
    checks += _axes("accel_bias", calibration.accel_bias, limits.accel_bias, "m/s^2")
    for name, value in zip(model.joint_names, calibration.encoder_offsets, strict=True):
        checks.append((f"encoder_offsets.{name}", float(value), limits.encoder_offset, "rad"))
    for foot, row, gain in zip(FOOT_NAMES, calibration.wrench_offsets, calibration.force_gains, strict=True):
        checks += _axes(f"{foot} force_offset", row[:3], limits.force_offset, "N")
        checks += _axes(f"{foot} torque_offset", row[3:], limits.torque_offset, "N.m")
        checks.append((f"{foot} force_gain - 1", float(gain) - 1.0, limits.force_gain, ""))
    for name, value, limit, unit in checks:
        if not np.isfinite(value) or abs(value) > limit:
            return f"{name} is {value:.4g} {unit}, beyond +-{limit:g}".replace("  ", " ")
    return ""


def _axes(name: str, values: Vector, limit: float, unit: str) -> list[tuple[str, float, float, str]]:
    return [(f"{name}.{axis}", float(value), limit, unit) for axis, value in zip("xyz", values, strict=True)]
