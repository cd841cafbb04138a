"""Sensor calibration of one robot: corrections and their plausible limits (``models/config/calibration.yaml``)."""

from __future__ import annotations

import dataclasses
from dataclasses import replace
from typing import Annotated

import numpy as np
from msgspec import structs
from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, Fraction, Positive
from models.constants import FOOT_NAMES
from models.robot_model import RobotModel
from models.types import JointCommand, Matrix, SensorData, Vector


@dataclasses.dataclass(frozen=True, slots=True)
class Calibration:
    """Sensor corrections of one robot."""

    robot: str
    gyro_bias: Vector  # measured minus true angular rate, in the frame of the IMU (3,) [rad/s]
    accel_bias: Vector  # measured minus true specific force, in the frame of the IMU (3,) [m/s^2]
    encoder_offsets: Vector  # measured minus true joint positions (nj,) [rad]
    wrench_offsets: Matrix  # unloaded readings, in the sole frame (2, 6) [N, N.m]
    force_gains: Vector  # ratio of true to measured normal force of each foot, offset removed (2,) [-]
    stamps: tuple[tuple[str, str], ...] = ()  # of the last calibration of 'imu', 'joints', 'feet', ISO 8601

    @classmethod
    def none(cls, model: RobotModel) -> Calibration:
        """Calibration without corrections."""
        return cls(model.name, np.zeros(3), np.zeros(3), np.zeros(model.nj), np.zeros((2, 6)), np.ones(2))

    def without_joints(self) -> Calibration:
        """Copy without encoder offsets, for samples whose encoders the joint drivers have already corrected."""
        return replace(self, encoder_offsets=np.zeros_like(self.encoder_offsets))


def correct_encoders(sensors: SensorData, offsets: Vector | None) -> SensorData:
    """Part of ``apply_calibration`` for the joint drivers: q = q_m - o_q (nj,) [rad]; disabled when None."""
    return sensors if offsets is None else structs.replace(sensors, q=sensors.q - offsets)


def encoder_command(command: JointCommand, offsets: Vector | None) -> JointCommand:
    """Command for drives whose encoders read true positions plus ``offsets`` (nj,) [rad]; unchanged when None."""
    return command if offsets is None else structs.replace(command, q=command.q + offsets)


def apply_calibration(sensors: SensorData, calibration: Calibration) -> SensorData:
    """Corrected copy of one sample; velocities and torques are unchanged, NaN stays NaN.

    q = q_m - o_q, w = w_m - b_w, f = f_m - b_f, W = W_m - o_W, W_z = g_z W_z
    """
    wrenches = sensors.wrenches - calibration.wrench_offsets
    wrenches[:, 2] *= calibration.force_gains
    return SensorData(
        t=sensors.t,
        q=sensors.q - calibration.encoder_offsets,
        v=sensors.v,
        tau=sensors.tau,
        gyro=sensors.gyro - calibration.gyro_bias,
        accel=sensors.accel - calibration.accel_bias,
        wrenches=wrenches,
    )


@dataclass(frozen=True, slots=True, config=STRICT)
class CalibrationLimits:
    """Maximum plausible corrections, and number of calibration files to keep."""

    gyro_bias: Positive  #: each axis [rad/s]
    accel_bias: Positive  #: each axis [m/s^2]
    encoder_offset: Positive  #: each joint [rad]
    force_offset: Positive  #: each axis [N]
    torque_offset: Positive  #: each axis [N.m]
    force_gain: Fraction  #: deviation of a gain from 1 [-]
    keep: Annotated[int, Field(ge=1, le=100)]  #: number of previous files to keep [1]


def implausible(calibration: Calibration, model: RobotModel, limits: CalibrationLimits) -> str:
    """Message about the first value that is not finite or beyond its limit; empty when there is none."""
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
