"""Errors of the simulated sensors: those of the robot's profile, and additional ones."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from models.config import parse_yaml, read_yaml, refuse_unknown
from models.errors import ConfigError
from models.numerics.compiled import njit
from models.numerics.unboxed import Unboxed, unbox
from models.robot_model import RobotModel
from models.types import Matrix, SensorData, Vector


@dataclass(frozen=True, slots=True)
class SensorErrors:
    """Errors in addition to the profile's, not scaled by ``sensor_noise``; one number applies to all axes or joints."""

    gyro_bias: ArrayLike = 0.0  #: Constant error of the angular rate (3,) [rad/s]
    accel_bias: ArrayLike = 0.0  #: Constant error of the specific force (3,) [m/s^2]
    misalignment: ArrayLike = 0.0  #: Rotation vector from the nominal to the true mounting of the IMU (3,) [rad]
    gyro_scale: ArrayLike = 0.0  #: Relative gain error of each axis of the gyro (3,) [-]
    accel_scale: ArrayLike = 0.0  #: Relative gain error of each axis of the accelerometer (3,) [-]
    #: Measured minus true position, for all joints (nj,) or by joint name [rad]
    encoder_offsets: ArrayLike | Mapping[str, float] = field(default=0.0)
    force_offsets: ArrayLike = 0.0  #: Measured force of each unloaded foot, in its sole frame (2, 3) [N]
    torque_offsets: ArrayLike = 0.0  #: Measured torque of each unloaded foot, in its sole frame (2, 3) [N.m]
    wrench_gains: ArrayLike = 0.0  #: Relative gain error of each axis of each foot (2, 6) [-]

    def array(self, name: str, shape: tuple[int, ...]) -> Matrix:
        """A field as an array of a shape; ``ConfigError`` if the shape does not fit or a value is not finite."""
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
    """Errors from a YAML file or YAML such as ``{gyro_bias: [0.05, 0, 0]}``, None if empty; else ``ConfigError``."""
    if not text.strip():
        return None
    inline = text.lstrip().startswith("{")
    data = parse_yaml(text, "sensor_errors") if inline else read_yaml(Path(text))
    refuse_unknown(data, [entry.name for entry in fields(SensorErrors)], "sensor_errors" if inline else text)
    return SensorErrors(**data)


TAIL = 18  #: Channels after the joints: gyro (3), accelerometer (3), wrenches left and right (12)


class SensorNoise:
    """Computes measurements of the robot's sensors from exact values.

    For each channel, with white noise w ~ N(0, 1) per tick and age a ~ U(0, jitter) per tick and sensor unit::

        x' = x(t - a),    y = clip(round_r(A x' + b + o + sigma w), -range, range),    b += walk sqrt(tick) w'

    - joint position: offset o, drawn once per seed; resolution r of the encoder; no white noise;
    - joint velocity and torque: sigma from the profile;
    - gyro and accelerometer: sigma = noise density / sqrt(tick); turn-on bias b, drawn once per seed, with a random
      walk; A = (1 + diag(scale)) exp(misalignment)', drawn once per seed, with the same rotation for both sensors;
    - foot wrenches: sigma and turn-on offset o from the profile; A = 1 + diag(gain) + crosstalk. Element i, j of the
      crosstalk is a share, drawn once per seed, times range_i / range_j.

    The sensor units are encoders, IMU and feet. x(t - a) is interpolated between the last two ticks. Random values
    depend only on the non-negative seed and the number of calls of ``advance`` since ``reset``. ``scale`` multiplies
    all of them, but not ``errors``; with 0 the measurements are not rounded, and exact except for ``errors``.
    ``period`` is the tick [s]. Raises ``ConfigError`` for a negative seed, a negative or non-finite ``scale``, or
    unusable ``errors``, ``JointNameError`` when ``errors`` names an unknown joint.
    """

    def __init__(
        self, model: RobotModel, *, period: float, seed: int, scale: float = 1.0, errors: SensorErrors | None = None
    ) -> None:
        if not 0.0 <= scale < np.inf:
            raise ConfigError(f"sensor_noise: {scale} is not a finite, non-negative scale")
        nj = self._nj = model.nj
        self.scale = scale
        self.size = 3 * nj + TAIL  #: Channels: q, v, tau (3 nj), gyro (3), accel (3), wrenches left and right (12)
        self._imu, self._tail = slice(3 * nj, 3 * nj + 6), slice(3 * nj, self.size)
        sensors = model.profile.sensors
        imu, encoders, feet = sensors.imu, sensors.encoders, sensors.feet
        sigma, bias = np.zeros(self.size), np.zeros(self.size)
        bias[:nj] = encoders.offset
        sigma[nj : 2 * nj] = encoders.velocity_noise
        sigma[2 * nj : 3 * nj] = encoders.torque_noise * model.tau_max
        sigma[self._imu] = np.repeat([imu.gyro_noise_density, imu.accel_noise_density], 3) / np.sqrt(period)
        bias[self._imu] = np.repeat([imu.gyro_bias, imu.accel_bias], 3)
        sigma[3 * nj + 6 :] = np.tile(np.repeat([feet.force_noise, feet.torque_noise], 3), 2)
        bias[3 * nj + 6 :] = np.tile(np.repeat([feet.force_offset, feet.torque_offset], 3), 2)
        self._sigma, self._bias_sigma = scale * sigma, scale * bias
        self._walk = scale * np.repeat([imu.gyro_bias_walk, imu.accel_bias_walk], 3) * np.sqrt(period)
        force, torque = feet.force_range or np.inf, feet.torque_range or np.inf
        reach = np.repeat([imu.gyro_range, imu.accel_range, force, torque, force, torque], 3)  # (18,)
        step = np.zeros(self.size)  # 0: not rounded
        if scale > 0.0:
            force, torque = feet.force_resolution, feet.torque_resolution
            step[:nj] = encoders.resolution
            step[self._tail] = np.repeat([imu.gyro_resolution, imu.accel_resolution, force, torque, force, torque], 3)
        else:
            reach[:] = np.inf
        self._jitter = scale * min(sensors.latency.jitter / period, 1.0)
        self._given = errors or SensorErrors()
        self._given_bias = self._added(model)
        self._imu_spec, self._feet_spec = imu, feet
        self._exact = scale == 0.0 and errors is None and feet.fitted
        self._seed = seed
        self._drawn, self._ages = np.zeros(self.size + 6), np.zeros(3)
        self._bias, self._error, self._now, self._before = np.zeros((4, self.size))
        self._matrix = np.zeros((TAIL, TAIL))
        state = self._bias, self._error, self._matrix, self._drawn, self._ages
        self._unboxed = unbox(_Memory(self._sigma, self._walk, step, reach, *state))
        self.reset()

    def _added(self, model: RobotModel) -> Vector:
        """Constant part of the additional errors (size,)."""
        given, added = self._given, np.zeros(self.size)
        added[: self._nj] = given.offsets(model)
        added[self._imu] = np.concatenate([given.array("gyro_bias", (3,)), given.array("accel_bias", (3,))])
        wrenches = np.hstack([given.array("force_offsets", (2, 3)), given.array("torque_offsets", (2, 3))])  # (2, 6)
        added[3 * self._nj + 6 :] = wrenches.ravel()
        return added

    def reset(self, seed: int | None = None) -> None:
        """Restart with the present seed, which repeats the errors, or with a new one."""
        if seed is not None:
            self._seed = seed
        if self._seed < 0:
            raise ConfigError(f"seed: {self._seed} is negative")
        biases, white, constants, ages = np.random.SeedSequence(self._seed).spawn(4)
        drawn = np.random.default_rng(biases).standard_normal(self.size)
        self._bias[:] = self._error[:] = self._bias_sigma * drawn + self._given_bias
        self._matrix[:] = self._gains(np.random.default_rng(constants))
        self._rng, self._age_rng = np.random.default_rng(white), np.random.default_rng(ages)
        self._ticks = self._measured = 0
        self.advance()

    @property
    def bias(self) -> Vector:
        """Present bias of every channel, random and additional (size,); for scoring only."""
        return self._bias.copy()

    @property
    def gains(self) -> Matrix:
        """Gain matrix of the channels after the joints (18, 18); for scoring only."""
        return self._matrix.copy()

    def _gains(self, rng: np.random.Generator) -> Matrix:
        """Matrix A of IMU and feet, block-diagonal (18, 18)."""
        imu, feet, given, scale = self._imu_spec, self._feet_spec, self._given, self.scale
        turn = scale * imu.misalignment * rng.standard_normal(3) + given.array("misalignment", (3,))
        rotation = pin.exp3(turn).T
        matrix = np.zeros((TAIL, TAIL))
        for at, sigma, name in ((0, imu.gyro_scale, "gyro_scale"), (3, imu.accel_scale, "accel_scale")):
            gains = 1.0 + scale * sigma * rng.standard_normal(3) + given.array(name, (3,))
            matrix[at : at + 3, at : at + 3] = gains[:, None] * rotation
        ranges = np.repeat([feet.force_range or 1.0, feet.torque_range or 1.0], 3)
        given_gains = given.array("wrench_gains", (2, 6))
        for foot in range(2):
            block = scale * feet.crosstalk * rng.standard_normal((6, 6)) * ranges[:, None] / ranges
            np.fill_diagonal(block, 1.0 + scale * feet.gain * rng.standard_normal(6) + given_gains[foot])
            at = 6 + 6 * foot
            matrix[at : at + 6, at : at + 6] = block
        return matrix

    def advance(self) -> None:
        """Draw the noise of the next tick."""
        self._ticks += 1
        if self.scale > 0.0:
            self._rng.standard_normal(out=self._drawn)
            _draw_errors(self._unboxed)
            if self._jitter > 0.0:
                self._age_rng.random(out=self._ages)

    def measure(self, t: float, exact: NDArray[np.float64]) -> SensorData:
        """Measurements at a stamp [s]: views of ``exact``, the true channels (size,), modified in place."""
        nj = self._nj
        if self._exact:
            return unpack(t, exact, nj)
        if self._jitter > 0.0:
            self._remember(exact)
        _distort(exact, self._before, self._jitter, nj, self._unboxed)
        sensors = unpack(t, exact, nj)
        if not self._feet_spec.fitted:
            sensors.wrenches[:] = np.nan
        return sensors

    def _remember(self, exact: NDArray[np.float64]) -> None:
        """Store the values of this tick and of the last one; for the first sample both are the same."""
        if self._measured != self._ticks:
            if self._measured == self._ticks - 1 and self._ticks > 1:
                self._now, self._before = self._before, self._now
            else:
                self._before[:] = exact
            self._now[:] = exact
            self._measured = self._ticks


class _Memory(NamedTuple):
    """Constants and state of ``SensorNoise``; "last channels" are those after the joints (18,)."""

    sigma: Vector  # (size,)
    walk: Vector  # (6,)
    step: Vector  # resolution, 0 for no rounding (size,)
    reach: Vector  # full scale of the last channels (18,)
    bias: Vector  # (size,)
    error: Vector  # additive error of the tick (size,)
    matrix: Matrix  # A of the last channels (18, 18)
    drawn: Vector  # white noise of channels and bias random walk (size + 6,)
    ages: Vector  # ages of encoders, IMU and feet relative to the jitter (3,)


@njit(cache=True)
def _draw_errors(noise: Unboxed[_Memory]) -> None:
    """Biases and errors of one tick, from white noise."""
    memory = noise.record
    size, first = memory.error.shape[0], memory.error.shape[0] - TAIL
    for i in range(6):
        memory.bias[first + i] += memory.drawn[size + i] * memory.walk[i]
    for i in range(size):
        memory.error[i] = memory.sigma[i] * memory.drawn[i] + memory.bias[i]


@njit(cache=True)
def _distort(values: Vector, before: Vector, jitter: float, nj: int, noise: Unboxed[_Memory]) -> None:
    """Compute measurements from exact values (size,), in place; ``before`` are the exact values of the last tick."""
    memory = noise.record
    first = 3 * nj
    if jitter > 0.0:
        for i in range(values.shape[0]):
            unit = 0 if i < first else (1 if i < first + 6 else 2)
            values[i] += jitter * memory.ages[unit] * (before[i] - values[i])
    tail = values[first:].copy()
    for i in range(TAIL):
        total = 0.0
        for k in range(TAIL):
            total += memory.matrix[i, k] * tail[k]
        values[first + i] = total
    for i in range(values.shape[0]):
        value, step = values[i] + memory.error[i], memory.step[i]
        values[i] = np.rint(value / step) * step if step > 0.0 else value
    for i in range(TAIL):
        values[first + i] = max(min(values[first + i], memory.reach[i]), -memory.reach[i])


def unpack(t: float, values: Vector, nj: int) -> SensorData:
    """Views of the channels of ``SensorNoise`` as a sample."""
    i = 3 * nj
    return SensorData(
        t=t,
        q=values[:nj],
        v=values[nj : 2 * nj],
        tau=values[2 * nj : i],
        gyro=values[i : i + 3],
        accel=values[i + 3 : i + 6],
        wrenches=values[i + 6 : i + 18].reshape(2, 6),
    )
