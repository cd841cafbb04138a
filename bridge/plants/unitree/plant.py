"""Plant of a Unitree humanoid with its low-level protocol."""

import time
from collections.abc import Mapping

import numpy as np

from bridge.plants.hardware import RobotClock, real_robot
from bridge.plants.low_level import LowLevelPlant
from bridge.plants.unitree.codec import (
    BUTTONS,
    PRESS_IT,
    RATES,
    UnitreeCodec,
    UnitreeSample,
    is_foreign,
    joint_command,
    read_times,
)
from bridge.plants.unitree.link import DdsLink, RobotLink
from bridge.plants.unitree.wire import LOW_CMD
from models.errors import ConfigError
from models.robot_model import RobotModel
from models.types import JointCommand

FASTER = 1.2  #: Ratio of measured to given speed above which the start waits
PROFILES = {2: "g1_mode_2_hardware", 5: "g1_hardware"}  #: Packaged profile of a ``mode_machine``


class UnitreePlant(LowLevelPlant[UnitreeSample]):
    """LowState in, LowCmd out, on the clock of the robot's tick; states with a wrong checksum are refused.

    Args:
        model: The robot, with a section ``hardware`` in its profile.
        network_interface: This computer's interface to the robot; only for messages, see ``bridge/launch/hardware.py``.
        domain: DDS domain of the robot.
        rate: Rate of the robot's states and of the commands [Hz]: 500 or 1000.
        marker: File that marks an unfinished run; empty for the default of interface and domain.
        remote: Whether the robot has a remote controller; False only for a simulated robot.
        speed: Speed of the robot's time over real time, 0.1 to 1; below 1 only for a simulated robot.
        link: Connection to the robot; over DDS when None.

    Raises:
        ConfigError: A robot with other joints, with foot sensors or without ``hardware``, or another rate or speed.
    """

    guard_process = "bridge.plants.unitree.guard:connect"
    _link: RobotLink
    state_name = "lowstate"
    own_controller = "Unitree's controller"
    service_name = "the motion switcher of the robot"

    def __init__(
        self,
        model: RobotModel,
        network_interface: str = "lo",
        domain: int = 0,
        rate: float = RATES[0],
        marker: str = "",
        remote: bool = True,
        speed: float = 1.0,
        link: RobotLink | None = None,
    ) -> None:
        rate, self._speed = read_times({"rate": rate, "speed": speed})
        clock = RobotClock(1.0 / rate, real_robot().gap_max)
        super().__init__(model, "unitree", (network_interface, domain), marker, 1.0 / rate, clock, BUTTONS)
        self._codec = UnitreeCodec(model, clock, self._session)
        if self._hardware.mode_machine is None or self._hardware.voltage is None:
            raise ConfigError(f"robot '{model.name}' needs hardware.mode_machine and hardware.voltage in its profile")
        self._remote = remote
        self.tried = not remote  #: Whether a stop button has been pressed
        self._released = not remote  # whether it has been released since
        self._begun: tuple[float, float] | None = None  # robot's and monotonic time of the first state [s]
        self._unchanged = np.inf  # time since the last change of the remote controller [s]
        self._link = DdsLink(domain) if link is None else link

    @property
    def speed(self) -> float:
        return self._speed

    def _decode(self, message: bytes) -> UnitreeSample:
        sample = self._codec.decode(message)
        self._pressed |= sample.pressed
        pressed = not sample.pressed.isdisjoint(self._hardware.stop_buttons)
        self._released = self._released or (self.tried and not pressed)
        self.tried = self.tried or pressed
        return sample

    @property
    def pressed(self) -> str:
        return self._button if self._released or self.crashed else ""

    def _accept(self, sample: UnitreeSample) -> None:
        before = self._sample
        super()._accept(sample)
        changed = before is not None and sample.remote != before.remote
        self._unchanged = 0.0 if changed else self._unchanged + self._period
        self._begun = self._begun or (sample.sensors.t, time.monotonic())

    def _is_foreign(self, data: bytes) -> bool:
        return is_foreign(data, self._session)

    def _change(self, sample: UnitreeSample) -> str:
        if self._sample is not None and sample.mode_machine != self._sample.mode_machine:
            return f"mode_machine changed to {sample.mode_machine}"
        return ""

    def _encode_command(self, command: JointCommand, *, last: bool = False) -> bytes:
        """LowCmd of a command, with ``mode_machine`` and tick of the newest state."""
        sample = self._sample
        mode_machine, tick = (0, 0) if sample is None else (sample.mode_machine, sample.tick)
        return self._codec.encode(command, mode_machine, tick, last)

    def _decode_command(self, data: bytes) -> JointCommand:
        return joint_command(LOW_CMD.read(data), self._model.nj)

    def _identity(self, sample: UnitreeSample) -> list[str]:
        found, given = [], self._hardware
        if sample.mode_machine != given.mode_machine:
            robot = PROFILES.get(sample.mode_machine)
            remedy = f": poise up --robot {robot}" if robot else "; no packaged profile is for it"
            found.append(
                f"mode_machine {sample.mode_machine} is another robot than the profile's {given.mode_machine}{remedy}"
            )
        if (version := self._link.version()) not in ("", given.switcher_version):
            found.append(
                f"motion switcher {version} is not version {given.switcher_version}: check how it releases "
                f"its controller, then set hardware.switcher_version of the profile"
            )
        return found

    def _checks(self, sample: UnitreeSample) -> list[str]:
        found = []
        if self._speed < 1.0 and self._begun is not None:  # the guard of a real robot would damp it too late
            begun, since = self._begun
            passed = time.monotonic() - since
            measured = (sample.sensors.t - begun) / max(passed, real_robot().rate_window)
            if measured > FASTER * self._speed:
                found.append(
                    f"the robot's time has speed {measured:.1f}, not {self._speed:g}: a real robot has speed 1"
                )
        if not self.tried:
            buttons = " or ".join(self._hardware.stop_buttons)
            found.append(f"the stop button of the remote controller, {buttons}: {PRESS_IT}")
        return found

    @property
    def remote_age(self) -> float | None:
        return self._unchanged if self._remote else None

    @property
    def warnings(self) -> tuple[str, ...]:
        """As ``LowLevelPlant``, and a warning for an unchanged remote controller, which may be out of range."""
        limit = real_robot().remote_unchanged
        quiet = self._remote and self.tried and self._unchanged > limit
        own = (f"remote controller unchanged for more than {limit:g} s: check that it is on and in range",)
        return (*super().warnings, *own * quiet)

    @property
    def report(self) -> Mapping[str, str]:
        """Values of the monitors and counts of states."""
        return {**super().report, "motion switcher": self._link.version() or "version unknown"}
