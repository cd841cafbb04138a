"""A Unitree humanoid by its low-level protocol: the robot as the driver program sees it."""

import secrets
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import numpy as np

from bridge.plants.base import HardwarePlant
from bridge.plants.unitree.codec import BUTTONS, LowSample, TickClock, UnitreeCodec, is_foreign, joint_command
from bridge.plants.unitree.link import DdsLink, RobotLink
from bridge.plants.unitree.monitors import HardwareMonitor
from bridge.plants.unitree.wire import read_low_cmd
from controllers.joints.joint_servo import damping_command, fade_to_damping
from models.errors import ConfigError, MessageError
from models.files import state_folder
from models.robot_model import RobotModel
from models.types import JointCommand, SensorData

GAP_MAX = 2.0  #: Largest step of the robot's tick that is no restart [s]
RATE_TOLERANCE = 0.1  #: Relative deviation of the rate of the states that is accepted at the start [-]
RATE_WINDOW = 0.5  #: Over which that rate is measured [s]
CLOSE_COMMANDS, CLOSE_PERIOD = 100, 0.002  #: Commands with which ``close`` damps, and the time between two [s]
LAST_COMMANDS = 5  #: Commands with which ``hand_over`` ends the guard, too: some may be lost
RATES = (500.0, 1000.0)  #: Supported rates of state and command [Hz]


class UnitreePlant(HardwarePlant):
    """LowState in, LowCmd with the drives' own PD law out, on the clock of the robot's tick.

    The samples between two ticks are all read: a press of a button in any of them is seen. Those with a wrong checksum
    are counted and left out. ``close`` damps the joints. A file in the user's state folder marks a driver that has
    commanded the robot and has not closed: ``crashed``.

    Args:
        model: The robot, with a section ``hardware`` in its profile.
        network_interface: Of this computer, to the robot; only named in messages, see ``bridge/launch/unitree.py``.
        domain: DDS domain of the robot.
        rate: Rate of the robot's states and of the commands [Hz]: 500 or 1000.
        marker: File that marks an unfinished run; that of the interface when empty.
        link: Connection to the robot; one over DDS when None.

    Raises:
        ConfigError: A robot with other joints, with foot sensors or without ``hardware``, or another rate.
    """

    def __init__(
        self,
        model: RobotModel,
        network_interface: str = "lo",
        domain: int = 0,
        rate: float = 500.0,
        marker: str = "",
        link: RobotLink | None = None,
    ) -> None:
        if rate not in RATES:
            raise ConfigError(f"rate: {rate:g} Hz; the robot runs at {' or '.join(f'{each:g}' for each in RATES)} Hz")
        hardware = model.profile.hardware
        if hardware is None or model.profile.sensors.feet.fitted:
            raise ConfigError(
                f"robot '{model.name}' needs 'hardware' and 'sensors.feet.fitted: false' in its profile, "
                f"as g1_hardware has"
            )
        self._stop_buttons = frozenset(hardware.stop_buttons)
        if unknown := self._stop_buttons.difference(BUTTONS):
            raise ConfigError(
                f"robot '{model.name}': hardware.stop_buttons: unknown {', '.join(sorted(unknown))}; known: "
                f"{', '.join(BUTTONS)}"
            )
        self._period = 1.0 / rate
        self._session = secrets.randbits(32)
        self._clock = TickClock(self._period, GAP_MAX)
        self._codec = UnitreeCodec(model, self._clock, self._session)
        self._hardware, self._where = hardware, f"{network_interface}, domain {domain}"
        self.monitor = HardwareMonitor(model, hardware, self._period)
        nothing = np.full(model.nj, np.nan)
        three = np.full(3, np.nan)
        self._sensors = SensorData(0.0, nothing, nothing, nothing, three, three, np.full((2, 6), np.nan))
        self._sample: LowSample | None = None
        self._previous = 0.0  # time of the last sample [s]
        self._rate = 0.0
        self._counted, self._counted_since = 0, 0.0
        self._silent = 0.0  # time without a state [s]
        self._restarts = self._restarts_seen = 0
        self._stop = ""
        self._fault: str | None = None  # of the motion switcher
        self.refused = 0  #: States with a wrong checksum or size
        self.lost = 0  #: States that did not arrive
        self._why = ""
        self._model = model
        self._sent = b""  # the last command
        self._foreign = 0  # commands of other programs since the last sample
        folder = Path(marker) if marker else state_folder("unitree") / f"{network_interface}-{domain}"
        self._marker = folder
        self._crashed = folder.exists()
        self._marked = False
        self._link: RobotLink = DdsLink(domain) if link is None else link
        self._closed = False
        self._waiting: list[bytes] = []  # taken from the link, and not read yet

    @property
    def period(self) -> float:
        return self._period

    def read(self) -> SensorData:
        self._stop = ""
        if self._closed:
            return self._sensors
        foreign = sum(is_foreign(data, self._session) for data in self._link.commands())
        if self.vendor == "":  # else they may be those of the active controller
            self._foreign += foreign
        waiting, self._waiting = [*self._waiting, *self._link.take()], []
        samples = [sample for data in waiting if (sample := self._decode(data)) is not None]
        self._silent = 0.0 if samples else self._silent + self._period
        for sample in samples:
            self._accept(sample)
        if self._clock.restarts > self._restarts_seen:
            self._restarts_seen = self._clock.restarts
            self._stop = self._stop or "the robot's clock has jumped: it was restarted"
        if not self._stop and self.monitor.damps:
            self._stop = "; ".join(self.monitor.damps)
        return self._sensors

    @property
    def arrived(self) -> bool:
        """Whether a state has come since the last ``read``."""
        if not self._waiting and not self._closed:
            self._waiting = self._link.take()
        return bool(self._waiting)

    def _decode(self, data: bytes) -> LowSample | None:
        try:
            return self._codec.decode(data)
        except MessageError as error:
            self.refused, self._why = self.refused + 1, str(error)
            return None

    def _accept(self, sample: LowSample) -> None:
        """Take over one sample: buttons, rate, lost states, monitors."""
        t = sample.sensors.t
        step = t - self._previous
        if pressed := self._stop_buttons & sample.pressed:
            self._stop = f"button {', '.join(sorted(pressed))} of the remote controller"
        if step <= 0.0 and self._sample is not None:
            return  # a repeated sample
        lost = 0 if self._sample is None else max(round(step / self._period) - 1, 0)
        self.lost += lost
        self.monitor.step(sample, lost, step, self._foreign)
        self._foreign = 0
        self._counted += 1
        if t - self._counted_since >= RATE_WINDOW:
            self._rate = self._counted / (t - self._counted_since)
            self._counted, self._counted_since = 0, t
        if self._sample is not None and sample.mode_machine != self._sample.mode_machine:
            self._stop = self._stop or f"mode_machine changed to {sample.mode_machine}"
        self._sample, self._previous = sample, t
        self._sensors = sample.sensors

    def write(self, command: JointCommand) -> None:
        """Send a command; before the first state nothing is sent: the type of the robot must be echoed."""
        if self._sample is None or self._closed:
            return
        if not self._marked:
            self._marked = True
            self._marker.parent.mkdir(parents=True, exist_ok=True)
            self._marker.touch()
        self._sent = self._codec.encode(command, self._sample.mode_machine, self._sample.tick)
        self._link.send(self._sent)

    def hand_over(self) -> None:
        if self._sample is not None and not self._closed:
            data = self._codec.encode(damping_command(self._model), self._sample.mode_machine, last=True)
            for _ in range(LAST_COMMANDS):
                self._link.send(data)
        self._marked = self._crashed = False
        self._unmark()

    def _unmark(self) -> None:
        with suppress(OSError):
            self._marker.unlink(missing_ok=True)

    def close(self) -> None:
        """Damp the joints, also when the robot was not commanded by this driver after a crash; leave the domain.

        The torque of the last command fades.
        """
        if self._closed:
            return
        self._closed = True
        if self._sample is not None and (self._marked or self._crashed):
            model, last = self._model, damping_command(self._model)
            if self._sent:
                last = joint_command(read_low_cmd(self._sent), model.nj)
            for count in range(CLOSE_COMMANDS):
                command = fade_to_damping(model, last, count * CLOSE_PERIOD)
                self._link.send(self._codec.encode(command, self._sample.mode_machine))
                time.sleep(CLOSE_PERIOD)
        self._link.close()
        if self._sample is not None or self._marked:
            self._unmark()

    @property
    def crashed(self) -> bool:
        """Whether the marker of an unfinished run was there at the start."""
        return self._crashed

    @property
    def findings(self) -> tuple[str, ...]:
        """Failed checks of the robot's messages."""
        sample, found = self._sample, []
        if self._closed:
            return ("the connection was closed with the driver's deactivation: clean it up and configure it again",)
        if sample is None:
            why = f"; refused: {self._why}" if self._why else ", check cable, address and domain"
            return (f"no lowstate on {self._where}{why}",)
        if self._silent > RATE_WINDOW:
            found.append(f"no lowstate for {self._silent:.1f} s")
        if self.refused and self._why:
            found.append(f"{self.refused} states refused: {self._why}")
            self._why = ""
        expected = 1.0 / self._period
        if abs(self._rate - expected) > RATE_TOLERANCE * expected:
            found.append(f"lowstate at {self._rate:.0f} Hz instead of {expected:.0f} Hz")
        if sample.mode_machine != self._hardware.mode_machine:
            found.append(
                f"mode_machine {sample.mode_machine} is another robot than the profile's {self._hardware.mode_machine}"
            )
        if (beyond := np.flatnonzero(np.abs(sample.sensors.q) > 2.0 * np.pi)).size:
            found.append(f"motor {int(beyond[0])} measures {sample.sensors.q[beyond[0]]:.1f} rad")
        if self.vendor is None:
            found.append(self._fault or "the motion switcher of the robot does not answer")
        if (version := self._link.version()) not in ("", self._hardware.switcher_version):
            found.append(
                f"motion switcher {version} is another than {self._hardware.switcher_version}: see what releases "
                f"its controller, then set hardware.switcher_version of the profile"
            )
        return (*found, *self.monitor.holds, *self.monitor.damps)

    @property
    def vendor(self) -> str | None:
        """Name of Unitree's active controller."""
        if self._closed:
            return None
        try:
            return self._link.vendor()
        except MessageError as error:
            self._fault = str(error)
            return None

    def release_vendor(self) -> None:
        self._link.release()

    @property
    def stop(self) -> str:
        """Reason to damp, of the newest ``read``."""
        return self._stop

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of the monitors."""
        return self.monitor.warnings

    @property
    def holds(self) -> tuple[str, ...]:
        """Holds of the monitors."""
        return self.monitor.holds

    @property
    def report(self) -> Mapping[str, str]:
        """Values of the monitors and counts of states."""
        vendor = self.vendor
        return {
            **self.monitor.values,
            "state rate [Hz]": f"{self._rate:.0f}",
            "states refused": str(self.refused),
            "states lost": str(self.lost),
            "restarts of the robot": str(self._clock.restarts),
            "vendor's controller": "unknown" if vendor is None else vendor or "released",
            "motion switcher": self._link.version() or "version unknown",
        }
