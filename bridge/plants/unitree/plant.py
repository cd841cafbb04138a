"""A Unitree humanoid by its low-level protocol: the robot as the driver program sees it."""

import secrets
from collections.abc import Mapping

import numpy as np

from bridge.plants.hardware import RealPlant, RobotClock, real_robot
from bridge.plants.unitree.codec import BUTTONS, LowSample, UnitreeCodec, is_foreign, joint_command
from bridge.plants.unitree.link import DdsLink, RobotLink
from bridge.plants.unitree.monitors import HardwareMonitor
from bridge.plants.unitree.wire import read_low_cmd
from controllers.joints.joint_servo import damping_command
from models.errors import ConfigError, MessageError
from models.robot_model import RobotModel
from models.types import JointCommand, SensorData

RATES = (500.0, 1000.0)  #: Supported rates of state and command [Hz]


class UnitreePlant(RealPlant):
    """LowState in, LowCmd with the drives' own PD law out, on the clock of the robot's tick.

    The samples between two ticks are all read: a press of a button in any of them is seen. Those with a wrong checksum
    are counted and left out. ``close`` damps the joints. A file in the user's state folder marks a driver that has
    commanded the robot and has not closed: ``crashed``.

    Args:
        model: The robot, with a section ``hardware`` in its profile.
        network_interface: Of this computer, to the robot; only named in messages, see ``bridge/launch/hardware.py``.
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
        super().__init__(model, "unitree", f"{network_interface}-{domain}", marker, 1.0 / rate)
        self._session = secrets.randbits(32)
        self._clock = RobotClock(self._period, real_robot().gap_max)
        self._codec = UnitreeCodec(model, self._clock, self._session)
        self._hardware, self._where = hardware, f"{network_interface}, domain {domain}"
        self.monitor = HardwareMonitor(model, hardware, self._period)
        self._sample: LowSample | None = None
        self._restarts_seen = 0
        self._fault: str | None = None  # of the motion switcher
        self.refused = 0  #: States with a wrong checksum or size
        self._why = ""
        self._foreign = 0  # commands of other programs since the last sample
        self._link: RobotLink = DdsLink(domain) if link is None else link
        self._waiting: list[bytes] = []  # taken from the link, and not read yet

    def read(self) -> SensorData:
        self._stop = ""
        if self._closed:
            return self._sensors
        foreign = sum(is_foreign(data, self._session) for data in self._link.commands())
        if self.vendor == "":  # else they may be those of the active controller
            self._foreign += foreign
        waiting, self._waiting = [*self._waiting, *self._link.take()], []
        samples = [sample for data in waiting if (sample := self._decode(data)) is not None]
        self.counter.idle(arrived=bool(samples))
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
        if pressed := self._stop_buttons & sample.pressed:
            self._stop = f"button {', '.join(sorted(pressed))} of the remote controller"
        if self._sample is not None and sample.sensors.t <= self._sample.sensors.t:
            return  # a repeated sample
        step, lost = self.counter.step(sample.sensors.t)
        self.monitor.step(sample, lost, step, self._foreign)
        self._foreign = 0
        if self._sample is not None and sample.mode_machine != self._sample.mode_machine:
            self._stop = self._stop or f"mode_machine changed to {sample.mode_machine}"
        self._sample = sample
        self._sensors = sample.sensors

    def _encode_command(self, command: JointCommand, *, last: bool = False) -> bytes:
        """LowCmd of a command; the type of the robot is echoed."""
        sample = self._sample
        mode_machine, tick = (0, 0) if sample is None else (sample.mode_machine, sample.tick)
        return self._codec.encode(command, mode_machine, tick, last)

    def _decode_command(self, data: bytes) -> JointCommand:
        return joint_command(read_low_cmd(data), self._model.nj)

    def hand_over(self) -> None:
        if self._sampled and not self._closed:
            data = self._encode_command(damping_command(self._model), last=True)
            for _ in range(real_robot().last_commands):
                self._link.send(data)
        self._marker.remove()

    @property
    def findings(self) -> tuple[str, ...]:
        """Failed checks of the robot's messages."""
        sample, found = self._sample, list[str]()
        if self._closed:
            return ("the connection was closed with the driver's deactivation: clean it up and configure it again",)
        if sample is None:
            why = f"; refused: {self._why}" if self._why else ", check cable, address and domain"
            return (f"no lowstate on {self._where}{why}",)
        found += self.counter.findings("lowstate")
        if self.refused and self._why:
            found.append(f"{self.refused} states refused: {self._why}")
            self._why = ""
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
    def own_controller(self) -> str:
        """Unitree's."""
        return "Unitree's controller"

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
            "state rate [Hz]": f"{self.counter.rate:.0f}",
            "states refused": str(self.refused),
            "states lost": str(self.counter.lost),
            "restarts of the robot": str(self._clock.restarts),
            "vendor's controller": "unknown" if vendor is None else vendor or "released",
            "motion switcher": self._link.version() or "version unknown",
        }
