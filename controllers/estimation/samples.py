"""Replaces and counts unusable parts of samples: values that are not finite, not new or at full scale."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.estimation.feet import NOT_FINITE, SATURATED, FootSensorState
from controllers.estimation.stamps import JumpFilter
from models.errors import MessageError
from models.numerics.compiled import njit
from models.numerics.unboxed import Unboxed, unbox
from models.profile import Sensors
from models.types import SensorData

Array = NDArray[np.float64]

#: Bits of ``SensorBuffer.accept``: parts of a sample that are not finite, or a rate at full scale
BAD_JOINTS, BAD_TORQUES, BAD_IMU, BAD_FEET = 1, 2, 4, 8
STALE = 16  #: Bit of ``SensorBuffer.accept``: the sample is not newer than the last one, or its stamp jumps ahead
#: Bits of ``SensorBuffer.accept``: an axis is at full scale; forces and wrenches are used, with less weight
SATURATED_IMU, SATURATED_FEET = 32, 64


@dataclass(slots=True)
class EstimatorHealth:
    """Events of the estimator since ``reset``; counters only grow."""

    steps: int = 0  # calls of ``step``
    stale: int = 0  # samples with a stamp that is not newer or jumps ahead, or steps that are not positive
    invalid_joints: int = 0  # samples with a non-finite joint position or velocity; kinematics are skipped
    invalid_torques: int = 0  # samples with a non-finite joint torque; the last good ones are used
    invalid_imu: int = 0  # samples with a non-finite rate or specific force; the last good one is held
    invalid_feet: int = 0  # samples with a non-finite wrench; the last one is held, then leg torques are used
    saturated_imu: int = 0  # samples with a rate (refused) or a force (used with more noise) at full scale
    saturated_feet: int = 0  # samples with a wrench at full scale; its centre of pressure has less weight
    rejected: int = 0  # updates whose innovation is not finite or not positive definite
    gated: int = 0  # sole measurements with less weight after a contradiction (slip, bad sensor)
    slips: tuple[int, int] = (0, 0)  # of the left and the right foot
    sensor_faults: tuple[int, int] = (0, 0)  # faults of the left and the right foot sensor
    foot_sensors: tuple[FootSensorState, FootSensorState] = (FootSensorState.SOUND, FootSensorState.SOUND)
    friction: float = math.nan  # coefficient of the ground, estimated; NaN before the first step [-]
    coasting: float = 0.0  # time without IMU or joints [s]; 0 when sound

    def count(self, missing: int, dt: float) -> None:
        """Count the unusable parts that ``SensorBuffer.accept`` found in a step of ``dt`` [s]."""
        self.stale += (missing & STALE) > 0
        self.invalid_joints += (missing & BAD_JOINTS) > 0
        self.invalid_torques += (missing & BAD_TORQUES) > 0
        self.invalid_imu += (missing & BAD_IMU) > 0
        self.invalid_feet += (missing & BAD_FEET) > 0
        self.saturated_imu += (missing & SATURATED_IMU) > 0
        self.saturated_feet += (missing & SATURATED_FEET) > 0
        self.coasting = self.coasting + dt if missing & (STALE | BAD_JOINTS | BAD_IMU) else 0.0


class SampleMemory(NamedTuple):
    """Arrays of ``SensorBuffer``."""

    scales: Array  # saturation thresholds of rate, specific force, sole force and sole torque (4,)
    new_joints: Array  # of the newest sample (3, nj)
    new_imu: Array  # (2, 3)
    new_wrenches: Array  # (2, 6)
    joints: Array  # last good values (3, nj)
    imu: Array  # (2, 3)
    previous_rate: Array  # (3,)
    wrenches: Array  # (2, 6)
    feet: Array  # (2,)


class SensorBuffer:
    """Last good values of all measurements; a stamp jump above ``gap`` [s] is refused unless the next continues it."""

    def __init__(self, nj: int, sensors: Sensors, saturation: float, gap: float) -> None:
        imu, feet = sensors.imu, sensors.feet
        scales = [imu.gyro_range, imu.accel_range, feet.force_range or math.inf, feet.torque_range or math.inf]
        self._scales = saturation * np.array(scales)
        self.feet = np.zeros(2)  #: State of each foot's newest sample: 0 sound, ``NOT_FINITE`` or ``SATURATED`` (2,)
        self.t = -math.inf  #: Stamp of the newest sample [s]
        self._gap, self._jumps = gap, JumpFilter(gap)
        self.joints = np.zeros((3, nj))  #: Positions, velocities, torques [rad, rad/s, N.m]
        self.imu = np.zeros((2, 3))  #: Rate, specific force [rad/s, m/s^2]
        self.previous_rate = np.zeros(3)  #: Rate one step earlier [rad/s]
        self.wrenches = np.zeros((2, 6))  #: Wrench of each foot [N, N.m]
        new = np.zeros((3, nj)), np.zeros((2, 3)), np.zeros((2, 6))
        good = self.joints, self.imu, self.previous_rate, self.wrenches, self.feet
        self.memory = SampleMemory(self._scales, *new, *good)
        self._unboxed, self._new = unbox(self.memory), (*new[0], *new[1], new[2])

    def reset(self, sensors: SensorData) -> None:
        """Start from one sample, wrenches optional; ``MessageError`` names an unusable value."""
        nj = self.joints.shape[1]
        shapes = {"q": (nj,), "v": (nj,), "tau": (nj,), "gyro": (3,), "accel": (3,), "wrenches": (2, 6)}
        for name, shape in shapes.items():
            value = np.asarray(getattr(sensors, name))
            if value.shape != shape:
                raise MessageError(f"sensors.{name}: shape {value.shape}, expected {shape}")
            if name != "wrenches" and not np.isfinite(value).all():
                raise MessageError(f"sensors.{name}: not finite")
        if not math.isfinite(sensors.t):
            raise MessageError("sensors.t: not finite")
        self.t, self._jumps = -math.inf, JumpFilter(self._gap)
        self.wrenches[:] = 0.0
        self.accept(sensors)
        self.previous_rate[:] = self.imu[0]

    def accept(self, sensors: SensorData) -> int:
        """Copy the usable parts of a sample; returns the bits ``BAD_*`` and ``SATURATED_*``, or ``STALE``."""
        if not self._goes_on(sensors.t):
            return STALE
        self.t = sensors.t
        q, v, tau, gyro, accel, wrenches = self._new
        q[:], v[:], tau[:] = sensors.q, sensors.v, sensors.tau
        gyro[:], accel[:], wrenches[:] = sensors.gyro, sensors.accel, sensors.wrenches
        missing: int = _accept(self._unboxed)
        return missing

    def _goes_on(self, t: float) -> bool:
        """Whether a stamp [s] is newer than the last one, and close to it or the continuation of a jump."""
        return self.t < t < math.inf and (self.t == -math.inf or self._jumps.accepts(self.t, t))


@njit(cache=True)
def _copy_finite(new: Array, good: Array) -> bool:
    """Copy a matrix unless an element is not finite; returns whether it was copied."""
    for i in range(new.shape[0]):
        for j in range(new.shape[1]):
            if not math.isfinite(new[i, j]):
                return False
    for i in range(new.shape[0]):
        for j in range(new.shape[1]):
            good[i, j] = new[i, j]
    return True


@njit(cache=True)
def _saturated(values: Array, scale: float) -> bool:
    """Whether one of three axes is at full scale."""
    return bool(max(abs(values[0]), abs(values[1]), abs(values[2])) >= scale)


@njit(cache=True)
def _accept(samples: Unboxed[SampleMemory]) -> int:
    """``SensorBuffer.accept`` of the sample in the memory."""
    scales, new_joints, new_imu, new_wrenches, joints, imu, previous_rate, wrenches, feet = samples.record
    bad = 0
    if not _copy_finite(new_joints[:2], joints[:2]):
        bad += BAD_JOINTS
    if not _copy_finite(new_joints[2:], joints[2:]):
        bad += BAD_TORQUES
    for i in range(3):
        previous_rate[i] = imu[0, i]
    if not np.isfinite(new_imu).all():
        bad += BAD_IMU
    elif _saturated(new_imu[0], scales[0]):
        bad += BAD_IMU + SATURATED_IMU  # the error of the angle has no bound
    else:
        imu[:] = new_imu
        if _saturated(imu[1], scales[1]):
            bad += SATURATED_IMU
    invalid = saturated = False
    for foot in range(2):
        feet[foot] = 0.0
        if not _copy_finite(new_wrenches[foot : foot + 1], wrenches[foot : foot + 1]):
            feet[foot], invalid = NOT_FINITE, True
        elif _saturated(wrenches[foot, 0:3], scales[2]) or _saturated(wrenches[foot, 3:6], scales[3]):
            feet[foot], saturated = SATURATED, True
    if invalid:
        bad += BAD_FEET
    if saturated:
        bad += SATURATED_FEET
    return bad
