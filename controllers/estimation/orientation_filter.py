"""Complementary filter: orientation of an IMU from its gyro and accelerometer alone."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
import pinocchio as pin
from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, default_config
from models.constants import GRAVITY
from models.errors import MessageError
from models.numerics.compiled import njit
from models.numerics.so3 import exponential, multiply, orthonormalise, rotate_transposed, to_quaternion
from models.types import Matrix, Vector


@dataclass(frozen=True, slots=True, config=STRICT)
class OrientationFilterConfig:
    """Schema of ``controllers/config/orientation_filter.yaml``."""

    kp: Annotated[float, Field(gt=0.0, description="rate at which the tilt follows the accelerometer [1/s]")]
    ki: Annotated[float, Field(ge=0.0, description="rate at which the bias follows the tilt's error [1/s^2]")]
    accel_band: Annotated[
        float, Field(gt=0.0, le=1.0, description="deviation of |specific force| / gravity from 1 without any trust [-]")
    ]
    bias_max: Annotated[float, Field(gt=0.0, description="largest gyro bias, each axis [rad/s]")]
    rest_gyro: Annotated[float, Field(gt=0.0, description="angular rate less bias below which it rests [rad/s]")]
    rest_accel: Annotated[
        float, Field(gt=0.0, lt=1.0, description="deviation of |specific force| / gravity from 1 at rest [-]")
    ]
    rest_time: Annotated[float, Field(ge=0.0, description="of quiet before it counts as rest [s]")]
    rest_time_constant: Annotated[float, Field(gt=0.0, description="of the bias learnt at rest [s]")]


class OrientationFilter:
    r"""Roll and pitch from gravity, yaw integrated, gyro bias learnt at rest.

    .. math::
        \dot R = R [\omega - b + \alpha k_p e]_\times, \quad \dot b = -\alpha k_i e, \quad
        e = \frac{a}{|a|} \times R^\top z, \quad \alpha = \max(0, 1 - ||a| / g - 1| / \text{accel\_band})

    with omega the gyro (3,) [rad/s], a the specific force (3,) [m/s^2], both in the frame of the unit, R its
    orientation in a level frame (3, 3), b the bias (3,) [rad/s] and z up. e has no part along the vertical, so yaw is
    the integral of the rate. When rate and force have been quiet for ``rest_time``, b also follows the rate itself with
    ``rest_time_constant``, about the vertical too: then yaw stands still as well.

    Attributes:
        rotation: R (3, 3).
        bias: b (3,) [rad/s].
        resting: Whether the bias is being learnt at rest.

    Assumptions:
        Forces average to gravity over 1 / kp. A steady turn slower than ``rest_gyro`` looks like a bias.

    References:
        Mahony, Hamel, Pflimlin: Nonlinear complementary filters on the special orthogonal group (2008): the explicit
        complementary filter with bias correction, section V.
    """

    def __init__(self, config: OrientationFilterConfig | None = None) -> None:
        self.config = c = config or default_config(OrientationFilterConfig, "controllers", "orientation_filter")
        self._gains = np.array([c.kp, c.ki, c.accel_band, c.bias_max])
        self._rest = np.array([c.rest_gyro, c.rest_accel, c.rest_time, c.rest_time_constant])
        self._quiet = np.zeros(1)
        self._quaternion = np.array([0.0, 0.0, 0.0, 1.0])
        self.rotation: Matrix = np.eye(3)
        self.bias: Vector = np.zeros(3)
        self.step(np.zeros(3), np.array([0.0, 0.0, GRAVITY]), 0.0)  # compile here, not at the first sample

    @property
    def resting(self) -> bool:
        """Whether the bias is being learnt at rest."""
        return bool(self._quiet[0] > self.config.rest_time)

    @property
    def quaternion(self) -> Vector:
        """Orientation as a unit quaternion xyzw (4,), a copy."""
        to_quaternion(self.rotation, self._quaternion)
        return self._quaternion.copy()

    def reset(self, gyro: Vector, accel: Vector, yaw: float = 0.0) -> None:
        """Start at rest with a yaw [rad].

        The mean angular rate (3,) [rad/s] is the first bias, the mean specific force (3,) [m/s^2] the vertical.

        Raises:
            MessageError: The unit is not at rest; names the value.
        """
        rate, share = float(np.abs(gyro).max()), float(np.linalg.norm(accel)) / GRAVITY
        if not rate <= self.config.bias_max:
            raise MessageError(f"not at rest: it turns at {rate:.3g} rad/s, at most {self.config.bias_max:g}")
        if not abs(share - 1.0) <= self.config.rest_accel:
            bound = self.config.rest_accel
            raise MessageError(f"not at rest: the specific force is {share:.3g} g, within {bound:g} of 1 expected")
        roll = math.atan2(accel[1], accel[2])
        pitch = math.atan2(-accel[0], math.hypot(accel[1], accel[2]))
        self.rotation = np.ascontiguousarray(pin.rpy.rpyToMatrix(roll, pitch, yaw))
        self.bias = np.array(gyro, dtype=np.float64)
        self._quiet[:] = 0.0

    def step(self, gyro: Vector, accel: Vector, dt: float) -> None:
        """Add a finite sample of rate (3,) [rad/s] and specific force (3,) [m/s^2], ``dt`` [s] after the last one."""
        _step(gyro, accel, dt, self._gains, self._rest, self.rotation, self.bias, self._quiet)


@njit(cache=True)
def _step(
    gyro: Vector, accel: Vector, dt: float, gains: Vector, rest: Vector, rotation: Matrix, bias: Vector, quiet: Vector
) -> None:
    """One step of ``OrientationFilter``; ``gains``: kp, ki, accel_band, bias_max; ``rest``: as the schema orders it."""
    norm = math.sqrt(accel[0] ** 2 + accel[1] ** 2 + accel[2] ** 2)
    deviation = abs(norm / GRAVITY - 1.0)
    error = np.zeros(3)
    trust = max(0.0, 1.0 - deviation / gains[2])
    if trust > 0.0:
        up = np.empty(3)
        rotate_transposed(rotation, np.array([0.0, 0.0, 1.0]), up)
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            error[i] = trust * (accel[j] * up[k] - accel[k] * up[j]) / norm
    fastest = 0.0
    for i in range(3):
        fastest = max(fastest, abs(gyro[i] - bias[i]))
    quiet[0] = quiet[0] + dt if fastest < rest[0] and deviation < rest[1] else 0.0
    learn = min(dt / rest[3], 1.0) if quiet[0] > rest[2] else 0.0
    turn, increment, before = np.empty(3), np.empty((3, 3)), rotation.copy()
    for i in range(3):
        turn[i] = dt * (gyro[i] - bias[i] + gains[0] * error[i])
        bias[i] += learn * (gyro[i] - bias[i]) - dt * gains[1] * error[i]
        bias[i] = min(max(bias[i], -gains[3]), gains[3])
    exponential(turn, increment)
    multiply(before, increment, rotation)
    orthonormalise(rotation)
