"""Complementary filter: orientation of an IMU from its gyro and accelerometer."""

import math
from typing import Annotated

import numpy as np
import pinocchio as pin
from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, NonNegative, Positive, default_config
from models.constants import GRAVITY
from models.errors import MessageError
from models.types import Matrix, Vector


@dataclass(frozen=True, slots=True, config=STRICT)
class OrientationFilterConfig:
    """Schema of ``controllers/config/orientation_filter.yaml``."""

    kp: Positive  #: rate at which the tilt follows the accelerometer [1/s]
    ki: NonNegative  #: rate at which the bias follows the tilt error [1/s^2]
    #: deviation of |specific force| / gravity from 1 at which the accelerometer is not used [-]
    accel_band: Annotated[float, Field(gt=0.0, le=1.0)]
    bias_max: Positive  #: largest gyro bias on each axis [rad/s]
    rest_gyro: Positive  #: unbiased angular rate below which the IMU is at rest [rad/s]
    rest_accel: Annotated[float, Field(gt=0.0, lt=1.0)]  #: deviation of |specific force| / gravity from 1 at rest [-]
    rest_time: NonNegative  #: time at rest after which the bias follows the rate [s]
    rest_time_constant: Positive  #: time constant of the bias estimate at rest [s]


class OrientationFilter:
    r"""Roll and pitch from gravity, yaw integrated, gyro bias estimated at rest.

    .. math::
        \dot R = R [\omega - b + \alpha k_p e]_\times, \quad \dot b = -\alpha k_i e, \quad
        e = \frac{a}{|a|} \times R^\top z, \quad \alpha = \max(0, 1 - ||a| / g - 1| / \text{accel\_band})

    omega is the measured rate (3,) [rad/s] and a the specific force (3,) [m/s^2], both in the IMU frame. R is the
    orientation of the IMU in a level frame (3, 3), b the bias (3,) [rad/s], and z points up. e has no vertical
    component, so yaw is the integral of the rate. After ``rest_time`` at rest, b also follows omega with
    ``rest_time_constant``, about the vertical too, so that yaw does not drift. b is limited to ``bias_max``.

    Assumptions:
        Forces average to gravity over 1 / kp. A steady turn slower than ``rest_gyro`` looks like a bias.

    References:
        Mahony, Hamel, Pflimlin: Nonlinear complementary filters on the special orthogonal group (2008): the explicit
        complementary filter with bias correction, section V.
    """

    def __init__(self, config: OrientationFilterConfig | None = None) -> None:
        self.config = config or default_config(OrientationFilterConfig, "controllers", "orientation_filter")
        self._quiet = 0.0  # time since the IMU last moved [s]
        self._orientation = pin.Quaternion.Identity()
        self.bias: Vector = np.zeros(3)

    @property
    def resting(self) -> bool:
        """Whether the IMU is at rest, so that the bias follows the rate."""
        return self._quiet > self.config.rest_time

    @property
    def rotation(self) -> Matrix:
        """Orientation as a matrix (3, 3)."""
        return np.asarray(self._orientation.matrix())

    @property
    def quaternion(self) -> Vector:
        """Orientation as a unit quaternion xyzw (4,), a copy."""
        return np.array(self._orientation.coeffs())

    def reset(self, gyro: Vector, accel: Vector, yaw: float = 0.0) -> None:
        """Start at rest with a yaw [rad]; ``MessageError`` names the value that contradicts rest.

        The mean angular rate (3,) [rad/s] is the initial bias; the mean specific force (3,) [m/s^2] gives the vertical.
        """
        rate, share = float(np.abs(gyro).max()), float(np.linalg.norm(accel)) / GRAVITY
        if not rate <= self.config.bias_max:
            raise MessageError(f"not at rest: it turns at {rate:.3g} rad/s, at most {self.config.bias_max:g}")
        if not abs(share - 1.0) <= self.config.rest_accel:
            bound = self.config.rest_accel
            raise MessageError(f"not at rest: the specific force is {share:.3g} g, within {bound:g} of 1 expected")
        roll = math.atan2(accel[1], accel[2])
        pitch = math.atan2(-accel[0], math.hypot(accel[1], accel[2]))
        self._orientation = pin.Quaternion(pin.rpy.rpyToMatrix(roll, pitch, yaw))
        self.bias = np.array(gyro, dtype=np.float64)
        self._quiet = 0.0

    def step(self, gyro: Vector, accel: Vector, dt: float) -> None:
        """Add a finite sample of rate (3,) [rad/s] and specific force (3,) [m/s^2], ``dt`` [s] after the last one."""
        config, rate = self.config, gyro - self.bias
        norm = float(np.linalg.norm(accel))
        deviation = abs(norm / GRAVITY - 1.0)
        trust = max(0.0, 1.0 - deviation / config.accel_band)
        error = trust / norm * np.cross(accel, self.rotation[2]) if trust > 0.0 else np.zeros(3)
        quiet = bool(np.abs(rate).max() < config.rest_gyro) and deviation < config.rest_accel
        self._quiet = self._quiet + dt if quiet else 0.0
        learn = min(dt / config.rest_time_constant, 1.0) if self.resting else 0.0
        self._orientation = self._orientation * pin.Quaternion(pin.exp3(dt * (rate + config.kp * error)))
        self._orientation.normalize()
        self.bias = np.clip(self.bias + learn * rate - dt * config.ki * error, -config.bias_max, config.bias_max)
