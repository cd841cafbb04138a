"""Which corrections of a sensor are plausible; the schema of ``models/config/calibration.yaml``."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from models.calibration import Calibration
from models.config import STRICT
from models.robot_model import RobotModel
from models.types import FOOT_NAMES


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
    checks = [
        *((f"gyro_bias.{a}", v, limits.gyro_bias, "rad/s") for a, v in zip("xyz", calibration.gyro_bias, strict=True)),
        *((f"accel_bias.{a}", v, limits.accel_bias, "m/s^2") for a, v in zip("xyz", calibration.accel_bias, strict=True)),
        *(
            (f"encoder_offsets.{name}", v, limits.encoder_offset, "rad")
            for name, v in zip(model.joint_names, calibration.encoder_offsets, strict=True)
        ),
    ]
    for foot, row, gain in zip(FOOT_NAMES, calibration.wrench_offsets, calibration.force_gains, strict=True):
        checks += [(f"{foot} force_offset.{a}", v, limits.force_offset, "N") for a, v in zip("xyz", row[:3], strict=True)]
        checks += [
            (f"{foot} torque_offset.{a}", v, limits.torque_offset, "N.m") for a, v in zip("xyz", row[3:], strict=True)
        ]
        checks.append((f"{foot} force_gain - 1", gain - 1.0, limits.force_gain, ""))
    for name, value, limit, unit in checks:
        if not np.isfinite(value) or abs(value) > limit:
            return f"{name} is {value:.4g} {unit}, beyond +-{limit:g}".replace("  ", " ")
    return ""
