"""Samples averaged over short windows: what every calibration works on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.robot_model import RobotModel
from models.types import Matrix, SensorData, Vector

_ROUNDING = 1e-6
"""Relative rounding of stamps that does not lengthen a window."""


@dataclass(frozen=True, slots=True)
class Window:
    """Means of the samples of one window.

    Attributes:
        t: Stamp of its last sample [s].
        samples: How many it averages.
        q: Joint positions (nj,) [rad].
        v: Joint velocities (nj,) [rad/s].
        gyro: Angular rate (3,) [rad/s].
        accel: Specific force (3,) [m/s^2].
        wrenches: Ground reactions (2, 6) [N, N.m].
    """

    t: float
    samples: int
    q: Vector
    v: Vector
    gyro: Vector
    accel: Vector
    wrenches: Matrix

    @property
    def speed(self) -> float:
        """Largest mean joint speed [rad/s]."""
        return float(np.abs(self.v).max())

    @property
    def loads(self) -> Vector:
        """Normal force on each foot (2,) [N]."""
        return self.wrenches[:, 2]


class WindowAverager:
    """Averages samples over windows of a fixed length.

    A sample that is not finite, or not newer than the one before, is left out and counted.

    Args:
        model: The robot.
        length: Of a window [s].

    Attributes:
        windows: The finished ones.
        unusable: Samples that were left out.
    """

    def __init__(self, model: RobotModel, length: float) -> None:
        self._nj, self._length = model.nj, length
        self._sum = np.zeros(2 * model.nj + 18)
        self._values = np.zeros(2 * model.nj + 18)
        self.clear()

    def clear(self) -> None:
        """Forget everything."""
        self.windows: list[Window] = []
        self.unusable = 0
        self._last = -np.inf
        self._begin = 0.0
        self._restart(0.0)

    def _restart(self, t: float) -> None:
        self._sum[:] = 0.0
        self._count = 0
        self._begin = t

    def add(self, sensors: SensorData) -> None:
        """Take one sample."""
        values, nj = self._values, self._nj
        values[:nj], values[nj : 2 * nj] = sensors.q, sensors.v
        values[-18:-15], values[-15:-12] = sensors.gyro, sensors.accel
        values[-12:] = sensors.wrenches.ravel()
        if not sensors.t > self._last or not np.isfinite(values).all():
            self.unusable += 1
            return
        if self._count == 0 or sensors.t - self._last > self._length:
            self._restart(sensors.t)  # the first sample, or the first after a gap
        self._last = sensors.t
        self._sum += values
        self._count += 1
        # n samples span n - 1 periods of the n that they stand for; stamps are rounded
        full = self._length * (self._count - 1) / self._count * (1.0 - _ROUNDING)
        if self._count > 1 and sensors.t - self._begin >= full:
            self._finish(sensors.t)

    def _finish(self, t: float) -> None:
        mean, nj = self._sum / self._count, self._nj
        self.windows.append(
            Window(
                t=t,
                samples=self._count,
                q=mean[:nj],
                v=mean[nj : 2 * nj],
                gyro=mean[-18:-15],
                accel=mean[-15:-12],
                wrenches=mean[-12:].reshape(2, 6),
            )
        )
        self._sum[:] = 0.0
        self._count = 0
