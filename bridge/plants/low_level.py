"""Common part of the low-level protocols of Unitree and Booster: one message per state, one command for all drives."""

from collections.abc import Mapping
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from bridge.plants.hardware import CLOSED, RealPlant, RobotClock, RobotConnection, real_robot, session
from bridge.plants.monitors import HardwareMonitor, LowSample
from controllers.joints.joint_servo import damping_command
from models.errors import ConfigError, MessageError
from models.robot_model import RobotModel
from models.types import JointCommand, SensorData

SampleT = TypeVar("SampleT", bound=LowSample)


class LowLink(RobotConnection, Protocol):
    """A connection to a robot whose vendor's controller can be released."""

    def vendor(self) -> str | None:
        """Name of the vendor's active controller; empty when none is active, None while unknown."""

    def release(self) -> None:
        """Request the end of the vendor's controller."""


class LowLevelPlant(RealPlant, Generic[SampleT]):
    """States in, commands of the drives' PD law out, on the robot's clock.

    All messages between two ticks are read, so that no press of a button is missed. Unusable messages are counted and
    skipped.

    Args:
        model: The robot, with a section ``hardware`` in its profile.
        name: Name of the plant.
        place: Interface and domain of the robot; they name the default marker file.
        marker: File that marks an unfinished run; empty for the default.
        period: Time between two states [s].
        clock: Converts the counts of the states to time.
        buttons: Names of the buttons of the remote controller.

    Subclasses set ``_link`` after this constructor.

    Raises:
        ConfigError: A robot with foot sensors, without ``hardware``, or with an unknown stop button.
    """

    state_name = "state"  #: Name of a state in the protocol
    service_name = "the robot's service"  #: Service that reports the vendor's active controller

    def __init__(
        self,
        model: RobotModel,
        name: str,
        place: tuple[str, int],
        marker: str,
        period: float,
        clock: RobotClock,
        buttons: tuple[str, ...],
    ) -> None:
        hardware = model.profile.hardware
        if hardware is None or model.profile.sensors.feet.fitted:
            raise ConfigError(
                f"robot '{model.name}' needs 'hardware' and 'sensors.feet.fitted: false' in its profile, "
                f"as g1_hardware has"
            )
        if unknown := set(hardware.stop_buttons).difference(buttons):
            raise ConfigError(
                f"robot '{model.name}': hardware.stop_buttons: unknown {', '.join(sorted(unknown))}; known: "
                f"{', '.join(buttons)}"
            )
        interface, domain = place
        super().__init__(model, name, f"{interface}-{domain}", marker, period)
        self._hardware, self._where = hardware, f"{interface}, domain {domain}"
        self._link: LowLink
        self._session = session()  # number of this driver in its commands
        self._clock = clock
        self.monitor = HardwareMonitor(model, hardware)
        self._sample: SampleT | None = None
        self._restarts_seen = 0
        self._pressed = frozenset[str]()  # buttons pressed in any message of this read
        self._button = ""  # stop button among them
        self.refused = 0  #: Messages that could not be decoded
        self._why = ""
        self._fault = ""  # error of the service that reports the vendor's controller
        self._foreign = 0  # commands of other programs since the last sample
        self._waiting: list[Any] = []  # received from the link, not read yet

    def read(self) -> SensorData:
        self._stop, self._pressed, self._jumped = "", frozenset(), False
        if self._closed:
            return self._sensors
        self.guard.step(self._link.beats(), commanded=self._marker.made)
        self._foreign += sum(map(self._is_foreign, self._link.commands()))
        waiting, self._waiting = [*self._waiting, *self._link.take()], []
        samples = [sample for message in waiting if (sample := self._use(message)) is not None]
        buttons = self._pressed.intersection(self._hardware.stop_buttons)
        self._stop = self._button = f"button {', '.join(sorted(buttons))} of the remote controller" if buttons else ""
        self.counter.idle(arrived=bool(samples))
        for sample in samples:
            self._accept(sample)
        if self._clock.restarts > self._restarts_seen:
            self._restarts_seen, self._jumped = self._clock.restarts, True
            self._stop = self._stop or "the robot's clock has jumped: it was restarted"
        if not self._stop and self.monitor.damps:
            self._stop = "; ".join(self.monitor.damps)
        return self._sensors

    @property
    def pressed(self) -> str:
        return self._button

    @property
    def arrived(self) -> bool:
        """Whether a message has arrived since the last ``read``."""
        if not self._waiting and not self._closed:
            self._waiting = self._link.take()
        return bool(self._waiting)

    def _use(self, message: Any) -> SampleT | None:
        try:
            return self._decode(message)
        except MessageError as error:
            self.refused, self._why = self.refused + 1, str(error)
            return None

    def _accept(self, sample: SampleT) -> None:
        """Process one sample: rate, lost states, monitors."""
        if self._sample is not None and sample.sensors.t <= self._sample.sensors.t:
            return  # a repeated sample
        step, lost = self.counter.step(sample.sensors.t)
        self.monitor.step(sample, lost, step, self._foreign, own=bool(self.vendor))
        self._foreign = 0
        self._stop = self._stop or self._change(sample)
        self._sample = sample
        self._sensors = sample.sensors

    @property
    def findings(self) -> tuple[str, ...]:
        """Failed checks of the robot's messages."""
        sample, found = self._sample, list[str]()
        if self._closed:
            return (CLOSED,)
        if sample is None:
            why = f"; refused: {self._why}" if self._why else ", check cable, address and domain"
            return (f"no {self.state_name} on {self._where}{why}",)
        found += self.counter.findings(self.state_name)
        if self.refused and self._why:
            found.append(f"{self.refused} messages refused: {self._why}")
            self._why = ""
        if (beyond := np.flatnonzero(np.abs(sample.sensors.q) > real_robot().position_max)).size:
            found.append(f"motor {int(beyond[0])} measures {sample.sensors.q[beyond[0]]:.1f} rad")
        return (
            *found,
            *self.doubts,
            *self._checks(sample),
            *self.guard.warnings,
            *self.guard.holds,
            *self.monitor.holds,
            *self.monitor.damps,
        )

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why the robot or its active controller is unknown."""
        if self._sample is None:
            return (f"no {self.state_name} on {self._where}",)
        silent = [self._fault or f"{self.service_name} does not answer"] if self.vendor is None else []
        return (*silent, *self._identity(self._sample))

    @property
    def vendor(self) -> str | None:
        """Name of the vendor's active controller."""
        if self._closed:
            return None
        try:
            return self._link.vendor()
        except MessageError as error:
            self._fault = str(error)
            return None

    def release_vendor(self) -> None:
        self._link.release()

    def hand_over(self) -> None:
        if (self._marker.made or self.guard.armed) and self._sampled and not self._closed:
            self.guard.armed = False
            self._end_guard()
        self._marker.remove()

    def _finish(self) -> None:
        self._end_guard()

    def _end_guard(self) -> None:
        """Send the last damping command: the robot keeps it, and it disarms the guard."""
        data = self._encode_command(damping_command(self._model), last=True)
        for _ in range(real_robot().last_commands):
            self._link.send(data)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of the monitors and of a silent guard."""
        return (*self.monitor.warnings, *super().warnings)

    @property
    def holds(self) -> tuple[str, ...]:
        """Holds of the monitors and of a silent guard."""
        return (*self.monitor.holds, *super().holds)

    @property
    def foreign(self) -> bool:
        return self.monitor.foreign

    @property
    def monitored(self) -> Mapping[str, str]:
        return self.monitor.values

    @property
    def report(self) -> Mapping[str, str]:
        """Values of the monitors and counts of states."""
        vendor = self.vendor
        return {
            **self.monitored,
            **self.guard.values,
            "state rate [Hz]": f"{self.counter.rate:.0f}",
            "states refused": str(self.refused),
            "states lost": str(self.counter.lost),
            "restarts of the robot": str(self._clock.restarts),
            "vendor's controller": "unknown" if vendor is None else vendor or "released",
        }

    def _decode(self, message: Any) -> SampleT | None:
        """Decode a sample and add its buttons to ``_pressed``; None for other messages. Raises ``MessageError``."""
        raise NotImplementedError

    def _encode_command(self, command: JointCommand, *, last: bool = False) -> bytes:
        """Serialised message of a command; one with ``last`` disarms the guard."""
        raise NotImplementedError

    def _is_foreign(self, data: bytes) -> bool:
        """Whether a serialised command is of another program."""
        raise NotImplementedError

    def _change(self, sample: SampleT) -> str:
        """Reason to damp that follows from the last two samples; empty for none."""
        return ""

    def _identity(self, sample: SampleT) -> list[str]:
        """Why a sample does not come from the profile's robot."""
        return []

    def _checks(self, sample: SampleT) -> list[str]:
        """Additional failed checks of the newest sample."""
        return []
