"""Noise of the robot's sensors, as its profile has it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.errors import ConfigError
from models.robot_model import RobotModel
from models.types import SensorData, Vector


class SensorNoise:
    """Turns exact measurements into what the robot's sensors would say.

    For each channel, with white noise w ~ N(0, 1) once a tick:

        y = clip(round_r(x + s (b + sigma w)), -range, range),    b += walk sqrt(tick) w'

    - joint position: rounded to the encoder's resolution r, no noise besides;
    - joint velocity and torque: sigma from the profile;
    - gyro and accelerometer: sigma = noise density / sqrt(tick), turn-on bias b drawn once per seed, which then walks,
      clipped to range;
    - foot wrenches: sigma and turn-on offset b from the profile, which does not walk.

    The noise of a tick depends on the seed and on how often ``advance`` was called since ``reset``, and on nothing
    else: not on the motion, and not on how often ``measure`` is called.

    Args:
        model: Robot; its profile holds the figures.
        period: Length of a tick [s].
        seed: Non-negative seed.
        scale: s, which multiplies noise and biases; with 0 the measurements are exact and not rounded either.

    Raises:
        ConfigError: The seed is negative, or ``scale`` is negative or not finite.
    """

    def __init__(self, model: RobotModel, *, period: float, seed: int, scale: float = 1.0) -> None:
        if not 0.0 <= scale < np.inf:
            raise ConfigError(f"sensor_noise: {scale} is not a finite, non-negative scale")
        nj = self._nj = model.nj
        self.scale = scale
        self.size = 3 * nj + 18
        """Channels: q, v, tau (3 nj), gyro (3), accel (3), wrenches left and right (12)."""
        imu, encoders, feet = model.profile.sensors.imu, model.profile.sensors.encoders, model.profile.sensors.feet
        self._imu = slice(3 * nj, 3 * nj + 6)
        wrenches = slice(3 * nj + 6, self.size)
        sigma, bias = np.zeros(self.size), np.zeros(self.size)
        sigma[nj : 2 * nj] = encoders.velocity_noise
        sigma[2 * nj : 3 * nj] = encoders.torque_noise * model.tau_max
        sigma[self._imu] = np.repeat([imu.gyro_noise_density, imu.accel_noise_density], 3) / np.sqrt(period)
        bias[self._imu] = np.repeat([imu.gyro_bias, imu.accel_bias], 3)
        sigma[wrenches] = np.tile(np.repeat([feet.force_noise, feet.torque_noise], 3), 2)
        bias[wrenches] = np.tile(np.repeat([feet.force_offset, feet.torque_offset], 3), 2)
        self._sigma, self._bias_sigma = scale * sigma, scale * bias
        self._walk = scale * np.repeat([imu.gyro_bias_walk, imu.accel_bias_walk], 3) * np.sqrt(period)
        self._range = np.repeat([imu.gyro_range, imu.accel_range], 3)
        self._resolution = encoders.resolution
        self._seed = seed
        self._drawn = np.zeros(self.size + 6)
        self._white, self._white_walk = self._drawn[: self.size], self._drawn[self.size :]
        self._error = np.zeros(self.size)
        self.reset()

    def reset(self, seed: int | None = None) -> None:
        """Start over: the same seed gives the same biases and the same noise again; a new one replaces it."""
        if seed is not None:
            self._seed = seed
        if self._seed < 0:
            raise ConfigError(f"seed: {self._seed} is negative")
        biases, white = np.random.SeedSequence(self._seed).spawn(2)
        self._bias = self._bias_sigma * np.random.default_rng(biases).standard_normal(self.size)
        self._rng = np.random.default_rng(white)
        self.advance()

    def advance(self) -> None:
        """Draw the noise of the next tick."""
        if self.scale > 0.0:
            self._rng.standard_normal(out=self._drawn)
            self._white_walk *= self._walk
            self._bias[self._imu] += self._white_walk
            np.multiply(self._sigma, self._white, out=self._error)
            self._error += self._bias

    def measure(self, t: float, exact: NDArray[np.float64]) -> SensorData:
        """Measurements of this tick.

        Args:
            t: Stamp [s].
            exact: True values of all channels (size,); becomes part of the result and is changed in place.

        Returns:
            The sample; its arrays are views of ``exact``.
        """
        nj = self._nj
        if self.scale > 0.0:
            exact += self._error
            if self._resolution > 0.0:
                q = exact[:nj]
                q /= self._resolution
                np.rint(q, out=q)
                q *= self._resolution
            imu = exact[self._imu]
            np.minimum(imu, self._range, out=imu)
            np.maximum(imu, -self._range, out=imu)
        return unpack(t, exact, nj)


def unpack(t: float, values: Vector, nj: int) -> SensorData:
    """The channels of ``SensorNoise.size`` as a sample, without copying."""
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
