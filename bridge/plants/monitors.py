"""Monitors of a real robot: values beyond the thresholds of its profile cause a warning, a hold or damping."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bridge.plants.hardware import Finding, ForeignCommands, Level, beyond, real_robot
from models.profile import Hardware, Thresholds
from models.robot_model import RobotModel
from models.types import SensorData, Vector


@dataclass(frozen=True, slots=True)
class LowSample:
    """One state of a robot: the values that the monitors use, common to all protocols."""

    sensors: SensorData  #: Joints and IMU
    temperature: Vector  #: Temperatures of each motor (nj, sensors) [degC]
    voltage: Vector  #: Supply voltage of each drive (nj,), 0 where not measured [V]
    motor_state: Vector  #: Error word of each drive (nj,), 0 without an error


class HardwareMonitor:
    """Compares every state of the robot with the thresholds of its profile.

    A quantity takes effect after it has been beyond a threshold for ``persistence``; the worst joint may change
    meanwhile. ``warnings``, ``holds`` and ``damps`` are the present reasons by level.
    """

    def __init__(self, model: RobotModel, hardware: Hardware) -> None:
        self._names, self._hardware = model.joint_names, hardware
        self._since: dict[tuple[str, int], float] = {}
        self._loss, self._window = 0.0, real_robot().count_window  # share of states lost [-], averaged over [s]
        self._foreign = ForeignCommands("lowcmd", hardware.foreign_commands)
        self._torque_limit, self._saturated = hardware.saturation * model.tau_max, np.zeros(model.nj)
        self.warnings: tuple[str, ...] = ()
        self.holds: tuple[str, ...] = ()
        self.damps: tuple[str, ...] = ()
        self.foreign = False  #: Whether commands of other programs are on the network
        self._sample: LowSample | None = None

    def step(self, sample: LowSample, lost: int, dt: float, foreign: int = 0, *, own: bool = False) -> None:
        """Check a state, ``dt`` [s] after the last one.

        Since the last state, ``lost`` states were lost and ``foreign`` commands of other programs were received. While
        the vendor's controller is active (``own``), ``foreign`` includes its commands.
        """
        share = min(dt / self._window, 1.0)
        self._loss += share * (lost / (lost + 1.0) - self._loss)
        self._saturated += share * ((np.abs(sample.sensors.tau) >= self._torque_limit) - self._saturated)
        self._sample = sample
        others = self._foreign.step(foreign, dt, self._hardware.own_commands if own else None)
        self.foreign = others is not None
        found = [finding for finding in (*self._find(sample), others) if finding is not None]
        t = sample.sensors.t
        present = {}
        for finding in found:
            for level in range(finding.level + 1):  # a value beyond hold is beyond warn, too
                key = finding.quantity, level
                present[key] = self._since.get(key, t)
        self._since = present
        lasting = [
            each
            for each in found
            if each.at_once or t - present[each.quantity, each.level] >= self._hardware.persistence
        ]
        self.warnings, self.holds, self.damps = (
            tuple(each.reason for each in lasting if each.level == level) for level in Level
        )

    @property
    def values(self) -> dict[str, str]:
        """Newest values for the diagnostics; empty before the first state."""
        if self._sample is None:
            return {}
        hottest, voltage = self._sample.temperature.max(axis=1), self._sample.voltage
        fed, worst = voltage[voltage > 0.0], self._saturated.max()
        return {
            "hottest motor [degC]": f"{hottest.max():.0f} ({self._names[int(hottest.argmax())]})",
            "lowest voltage [V]": f"{fed.min():.1f}" if fed.size else "not measured",
            "states lost [%]": f"{100.0 * self._loss:.1f}",
            "torque saturated [%]": f"{100.0 * worst:.0f} ({self._names[int(self._saturated.argmax())]})",
        }

    def _find(self, sample: LowSample) -> list[Finding | None]:
        given = self._hardware
        hottest = sample.temperature.max(axis=1)  # (nj,)
        fed = np.where(sample.voltage > 0.0, sample.voltage, np.inf)  # 0: not measured
        return [
            self._worst("motor temperature", "degC", hottest, np.argmax, given.motor_temperature),
            self._worst("voltage", "V", fed, np.argmin, given.voltage),
            self._worst("torque saturation", "", self._saturated, np.argmax, given.torque_saturation),
            beyond("lost states", self._loss, "", given.lost_packets),
            self._error(sample.motor_state),
            None
            if given.voltage is None or sample.voltage.any()
            else Finding(
                Level.WARN, "no voltage", "voltage: not measured by any drive, so a low voltage is not detected"
            ),
        ]

    def _worst(
        self, what: str, unit: str, values: Vector, pick: Callable[[Vector], np.intp], bounds: Thresholds | None
    ) -> Finding | None:
        if bounds is None:
            return None
        joint = int(pick(values))
        return beyond(what, float(values[joint]), unit, bounds, self._names[joint])

    def _error(self, states: Vector) -> Finding | None:
        faulty = np.flatnonzero(states)
        if not faulty.size:
            return None
        joint = int(faulty[0])
        return Finding(
            Level[self._hardware.motor_error.upper()],
            "motor error",
            f"motor of '{self._names[joint]}': error word {int(states[joint]):#x}",
        )
