"""What a calibration found out about one robot's sensors, and how it corrects a sample."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from msgspec import structs

from models.robot_model import RobotModel
from models.types import Matrix, SensorData, Vector


@dataclass(frozen=True, slots=True)
class Calibration:
    """Corrections of the sensors of one robot.

    Attributes:
        robot: Name of the robot's profile.
        gyro_bias: Measured minus true angular rate, in the frame of the inertial unit (3,) [rad/s].
        accel_bias: Measured minus true specific force, in the same frame (3,) [m/s^2].
        encoder_offsets: Measured minus true joint positions (nj,) [rad].
        wrench_offsets: What each foot sensor reads at no load, in its sole frame (2, 6) [N, N.m].
        force_gains: True over measured normal force of each foot, offset removed (2,) [-].
        stamps: When each part was calibrated ('imu', 'joints', 'feet'), as ISO 8601 text; a part left out never was.
    """

    robot: str
    gyro_bias: Vector
    accel_bias: Vector
    encoder_offsets: Vector
    wrench_offsets: Matrix
    force_gains: Vector
    stamps: tuple[tuple[str, str], ...] = ()

    @classmethod
    def none(cls, model: RobotModel) -> Calibration:
        """The calibration of a robot that was never calibrated: it corrects nothing."""
        return cls(model.name, np.zeros(3), np.zeros(3), np.zeros(model.nj), np.zeros((2, 6)), np.ones(2))

    def without_joints(self) -> Calibration:
        """What is left to correct when the joint drivers have corrected their encoders themselves."""
        return replace(self, encoder_offsets=np.zeros_like(self.encoder_offsets))


def correct_encoders(sensors: SensorData, offsets: Vector) -> SensorData:
    """The part of ``apply_calibration`` that the joint drivers do: a new sample with q = q_m - o_q, the rest as it is.

    Args:
        sensors: As measured; not changed.
        offsets: Measured minus true joint positions (nj,) [rad].
    """
    return structs.replace(sensors, q=sensors.q - offsets)


def apply_calibration(sensors: SensorData, calibration: Calibration) -> SensorData:
    """Correct one sample.

    ::

        q = q_m - o_q,   w = w_m - b_w,   f = f_m - b_f,   W = W_m - o_W,   W_z = g_z W_z

    Args:
        sensors: As measured; not changed.
        calibration: Of the same robot.

    Returns:
        A new sample; velocities and torques are those of ``sensors``. NaN stays NaN.
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
