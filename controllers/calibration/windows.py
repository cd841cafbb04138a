"""Averages of samples over short windows, check for rest in them, and the outcome of a calibration."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from controllers.calibration.config import RestConfig
from models.calibration import Calibration
from models.robot_model import RobotModel
from models.types import CommandReply, Matrix, SensorData, Vector

AXES = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of a calibration."""

    reply: CommandReply  # success or the reason of the refusal, with details
    calibration: Calibration | None = None  # None when refused


def refuse(reason: str, details: dict[str, float]) -> Outcome:
    """Outcome of a refused calibration, with details."""
    return Outcome(CommandReply(False, reason, details))


def accept(reason: str, details: dict[str, float], calibration: Calibration) -> Outcome:
    """Outcome of a successful calibration, with details."""
    return Outcome(CommandReply(True, reason, details), calibration)


def named(name: str, values: Vector) -> dict[str, float]:
    """A vector (3,) as details ``name_x``, ``name_y``, ``name_z``."""
    return {f"{name}_{axis}": float(value) for axis, value in zip(AXES, values, strict=True)}


_ROUNDING = 1e-6  #: Relative tolerance on the length of a window, for rounded stamps [-]


@dataclass(frozen=True, slots=True)
class Window:
    """Means of the samples of one window."""

    t: float  # stamp of the last sample [s]
    samples: int  # number of samples
    q: Vector  # joint positions (nj,) [rad]
    v: Vector  # joint velocities (nj,) [rad/s]
    gyro: Vector  # angular rate (3,) [rad/s]
    accel: Vector  # specific force (3,) [m/s^2]
    wrenches: Matrix  # ground reactions (2, 6) [N, N.m]

    @property
    def speed(self) -> float:
        """Largest mean joint speed [rad/s]."""
        return float(np.abs(self.v).max())

    @property
    def loads(self) -> Vector:
        """Normal force on each foot (2,) [N]."""
        return self.wrenches[:, 2]


class WindowAverager:
    """Averages samples over windows of ``length`` [s]; ``unusable`` counts samples that are not finite or not newer."""

    def __init__(self, model: RobotModel, length: float) -> None:
        self._nj, self._length = model.nj, length
        self._sum = np.zeros(2 * model.nj + 18)
        self._values = np.zeros(2 * model.nj + 18)
        self.clear()

    def clear(self) -> None:
        """Discard all windows and samples."""
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
        """Add one sample."""
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
        # n samples cover n periods, their stamps span n - 1; stamps are rounded
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


def duration(windows: Sequence[Window], length: float) -> float:
    """Time covered by windows of ``length`` [s]."""
    return len(windows) * length


def unrest(windows: Sequence[Window], model: RobotModel, config: RestConfig) -> tuple[str, dict[str, float]]:
    """Violated bound of rest (empty at rest); details: speed, drift, spreads as standard deviations of window means."""
    speeds = np.abs([w.v for w in windows]).max(axis=0)  # (nj,)
    drifts = np.ptp([w.q for w in windows], axis=0)  # (nj,)
    details = {
        "joint_speed": float(speeds.max()),
        "joint_drift": float(drifts.max()),
        "gyro_spread": float(np.std([w.gyro for w in windows], axis=0).max()),
        "accel_spread": float(np.std([w.accel for w in windows], axis=0).max()),
    }
    if details["joint_speed"] > config.joint_speed:
        return _joint(model, speeds, "moves at", "rad/s", config.joint_speed), details
    if details["joint_drift"] > config.joint_drift:
        return _joint(model, drifts, "has moved by", "rad", config.joint_drift), details
    if details["gyro_spread"] > config.gyro_spread:
        spread = details["gyro_spread"]
        return f"the angular rate varies by {spread:.3g} rad/s (at most {config.gyro_spread:g})", details
    if details["accel_spread"] > config.accel_spread:
        spread = details["accel_spread"]
        return f"the specific force varies by {spread:.3g} m/s^2 (at most {config.accel_spread:g})", details
    return "", details


def _joint(
    model: RobotModel, values: np.ndarray[tuple[int, ...], np.dtype[np.float64]], verb: str, unit: str, limit: float
) -> str:
    i = int(np.argmax(values))
    return f"joint '{model.joint_names[i]}' {verb} {values[i]:.3g} {unit} (at most {limit:g})"


#: Unit of a detail by pattern of its name
UNITS = {
    r"time(_\w+)?": "s",
    r"joint_speed|gyro_spread|gyro_drift|(turning|gyro_bias)_[xyz]": "rad/s",
    r"accel_norm|accel_spread|accel_bias_[xyz]": "m/s^2",
    r"joint_drift|tilt|disagreement|sigma_\w+": "rad",
    r"load|weight|load_spread|load_error|force_spread|(left|right)_f[xyz]": "N",
    r"(left|right)_t[xyz]": "N.m",
    r"singular_(max|min)": "1/rad",
}
#: Pattern of names without a unit: counts, ratios and directions
PLAIN = r"(samples|windows|joints)(_\w+)?|residual|shift|gravity_[xyz]|(left|right)_gain"


def name_and_unit(text: str) -> tuple[str, str]:
    """Name and unit of a detail such as ``gyro_bias_x [rad/s]``; unit empty for counts and ratios, rad for a joint."""
    name, bracket, unit = text.partition(" [")
    if bracket:
        unit = unit.removesuffix("]")
        return name, "" if unit == "-" else unit
    if re.fullmatch(PLAIN, name):
        return name, ""
    return name, next((unit for pattern, unit in UNITS.items() if re.fullmatch(pattern, name)), "rad")
