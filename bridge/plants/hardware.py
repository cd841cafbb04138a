"""Common parts of the plants of real robots: robot clock, sample counter, thresholds, run marker, shutdown."""

import fcntl
import os
import secrets
import time
from collections.abc import Sequence
from contextlib import suppress
from enum import IntEnum
from functools import cache
from io import FileIO
from pathlib import Path
from tempfile import TemporaryFile
from typing import Annotated, Any, NamedTuple, Protocol

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from bridge.plants.base import HardwarePlant
from controllers.joints.joint_servo import fade_to_damping
from models.config import STRICT, Count, Fraction, Positive, default_config
from models.errors import ConfigError
from models.files import state_folder
from models.profile import Thresholds
from models.robot_model import RobotModel
from models.types import JointCommand, SensorData

SESSION = "POISE_SESSION"  #: Environment variable with the number of a graph, hexadecimal
MILLISECONDS = 0.001  #: Tick of a millisecond counter [s]
#: Finding after ``close``
CLOSED = "the connection was closed when the driver was deactivated: clean up the driver and configure it again"


@dataclass(frozen=True, slots=True, config=STRICT)
class RealRobotConfig:
    """Schema of ``bridge/config/real_robot.yaml``, which has units and meanings."""

    gap_max: Positive
    rate_window: Positive
    rate_tolerance: Fraction
    count_window: Positive
    command_period: Positive
    close_time: Positive
    last_commands: Count
    silence_max: Positive
    beat_period: Positive
    guard_warn: Positive
    guard_hold: Positive
    guard_kill: Positive
    guard_time: Positive
    guard_priority: Annotated[int, Field(ge=1, le=99)]
    look_period: Positive
    ask_period: Positive
    answer_age_max: Positive
    position_max: Positive
    remote_unchanged: Positive


def real_robot() -> RealRobotConfig:
    """The packaged configuration."""
    return default_config(RealRobotConfig, "bridge", "real_robot")


@cache
def session() -> int:
    """Number (32 bits) in the commands of a driver; its guard gets the same number from their launcher."""
    return int(os.environ[SESSION], 16) if SESSION in os.environ else secrets.randbits(32)


class Level(IntEnum):
    """Effect of a value beyond a threshold."""

    WARN = 0
    HOLD = 1
    DAMP = 2


class Finding(NamedTuple):
    """One value beyond a threshold."""

    level: Level
    quantity: str  # measured quantity without the joint, because ``persistence`` counts over all joints
    reason: str  # quantity, joint, value and threshold
    at_once: bool = False  # whether it takes effect without ``persistence``


def beyond(quantity: str, value: float, unit: str, bounds: Thresholds, joint: str = "") -> Finding | None:
    """Finding for the most severe threshold that a value is beyond; None for none. ``joint`` is optional."""
    what = f"{quantity} of '{joint}'" if joint else quantity
    sign = 1.0 if bounds.rising else -1.0
    for level, bound in ((Level.DAMP, bounds.damp), (Level.HOLD, bounds.hold), (Level.WARN, bounds.warn)):
        if sign * (value - bound) > 0.0:
            side = "above" if bounds.rising else "below"
            text = f"{what}: {value:.3g} {unit} {side} {bound:g} {unit}"
            return Finding(level, quantity, text.replace("  ", " ").rstrip())
    return None


class ForeignCommands:
    """Rate of the commands of other programs on a robot's network over ``count_window``; without ``persistence``.

    Commands of the vendor's controller can only be distinguished by their rate, which is subtracted while it is active.
    The count restarts when that controller becomes active or inactive. ``topic`` is named in the finding.
    """

    def __init__(self, topic: str, bounds: Thresholds) -> None:
        self._topic, self._bounds = topic, bounds
        self._window, self._tolerance = real_robot().count_window, real_robot().rate_tolerance
        self._rate = 0.0  # [Hz]
        self._own: float | None = None  # rate of the vendor's controller [Hz], None while it is inactive

    def step(self, count: int, dt: float, own: float | None = None) -> Finding | None:
        """Add a number of commands, ``dt`` [s] after the last call; ``own`` is the vendor controller's rate [Hz]."""
        if own != self._own:
            self._own, self._rate = own, 0.0
        self._rate += count - min(dt / self._window, 1.0) * self._rate
        others = self._rate - (1.0 + self._tolerance) * (own or 0.0)
        found = beyond(f"{self._topic} of another program", others, "Hz", self._bounds)
        if found is None:
            return None
        remedy = ": end it" if own is None else (
            ": end it; if none runs, the robot's own controller sends them: give their rate as hardware.own_commands "
            "of the profile"
        )  # fmt: skip
        return found._replace(reason=found.reason + remedy, at_once=True)


class GuardWatch:
    """State of the guard process by its heartbeats, which report whether it is armed.

    ``period`` is the period of ``step`` [s]. A guard that is silent, or does not receive the driver's commands, causes
    a hold, because nothing would damp the robot if its driver failed.
    """

    def __init__(self, period: float) -> None:
        self._period, self._config = period, real_robot()
        self.silence = np.inf  #: Time since the last heartbeat [s]
        self.armed = False  #: Whether the guard damps the robot when the driver is silent, by the last heartbeat
        self._unarmed = 0.0  # time for which the driver's commands have not armed the guard [s]

    def step(self, beats: Sequence[bool], *, commanded: bool = False) -> None:
        """Process the heartbeats of one period; ``commanded`` is whether the driver commands the robot."""
        self.silence = 0.0 if beats else self.silence + self._period
        self.armed = beats[-1] if beats else self.armed
        self._unarmed = self._unarmed + self._period if commanded and not self.armed else 0.0

    @property
    def warnings(self) -> tuple[str, ...]:
        """Reasons of a warning."""
        return self._silent(self._config.guard_warn) if not self.holds else ()

    @property
    def holds(self) -> tuple[str, ...]:
        """Reasons of a hold."""
        limit = self._config.guard_hold
        if self._unarmed <= limit:
            return self._silent(limit)
        return (*self._silent(limit), f"guard process without a command of the driver for more than {limit:g} s")

    @property
    def values(self) -> dict[str, str]:
        """Entries of the diagnostics."""
        return {"guard silent for [s]": f"{self.silence:.2f}", "guard armed": str(self.armed).lower()}

    def _silent(self, limit: float) -> tuple[str, ...]:
        return (f"guard process silent for more than {limit:g} s",) if self.silence > limit else ()


class RobotClock:
    """Time from a counter of the robot, which may wrap and restarts with the robot.

    The time advances by the difference of two counts. A count that goes back, or jumps ahead by more than ``gap_max``
    [s], is a restart: the time advances by one ``period`` [s] and ``restarts`` is incremented. ``tick`` is the length
    of a count [s], ``wrap`` the number of counts after which the counter wraps.
    """

    def __init__(self, period: float, gap_max: float, tick: float = MILLISECONDS, wrap: int = 1 << 32) -> None:
        self._tick, self._wrap = tick, wrap
        self._period, self._gap_max = max(round(period / tick), 1), round(gap_max / tick)
        self._last: int | None = None
        self._counts = 0
        self.restarts = 0  #: Jumps of the robot's clock

    def step(self, count: int) -> float:
        """Time of a count [s]; a repeated count gives the same time."""
        if self._last is None:
            self._counts = self._period
        else:
            ahead = (count - self._last) % self._wrap
            if ahead > self._gap_max:
                self.restarts += 1
                ahead = self._period
            self._counts += ahead
        self._last = count
        return self._counts * self._tick


class SampleCounter:
    """Rate of the samples, number of lost samples, and silence since the last one.

    ``period`` is the time between two samples of the robot, and between two calls of ``idle`` [s].
    """

    def __init__(self, period: float) -> None:
        self._period = period
        self._config = real_robot()
        self.rate = 0.0  #: Rate of the received samples over ``rate_window`` [Hz]
        self.lost = 0  #: Lost samples
        self.silence = 0.0  #: Time without a sample [s]
        self._last: float | None = None
        self._counted, self._since = 0, 0.0

    def idle(self, *, arrived: bool) -> None:
        """Count one period of the driver; ``arrived`` is whether it had samples."""
        self.silence = 0.0 if arrived else self.silence + self._period

    def step(self, t: float) -> tuple[float, int]:
        """Count a sample at a time [s]; returns the time since the last one [s] and the samples lost between them."""
        step = t if self._last is None else t - self._last
        lost = 0 if self._last is None else max(round(step / self._period) - 1, 0)
        self.lost += lost
        self._counted += 1
        self._last = t
        if t - self._since >= self._config.rate_window:
            self.rate = self._counted / (t - self._since)
            self._counted, self._since = 0, t
        return step, lost

    def findings(self, what: str) -> list[str]:
        """Deviations from the expected rate of samples called ``what``; empty for none."""
        expected, found = 1.0 / self._period, []
        if self.silence > self._config.rate_window:
            found.append(f"no {what} for {self.silence:.1f} s")
        if abs(self.rate - expected) > self._config.rate_tolerance * expected:
            found.append(f"{what} at {self.rate:.0f} Hz instead of {expected:.0f} Hz")
        return found


class RunMarker:
    """A file that exists while a driver commands the robot. The driver's process locks it and writes its number to it.

    ``crashed`` is whether a driver that has ended left the file. Raises ``ConfigError`` if the process of the file is
    alive, or if no file exists and none can be written. ``failure`` reports later errors of the file system.
    """

    def __init__(self, file: Path) -> None:
        self._file = file
        self._locked: FileIO | None = None
        self.made = False  #: Whether this driver has commanded the robot
        self.failure = ""  #: Why the run could not be marked
        self.crashed = file.exists() and self._lock() is not None
        self._unlock()
        if self.crashed:
            return
        if file.exists():
            raise ConfigError(
                f"process {file.read_text(encoding='utf-8').strip()} is the driver of another 'poise up' and commands "
                "this robot: end it with Ctrl-C before you start another one"
            )
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            with TemporaryFile(dir=file.parent, buffering=0) as trial:
                trial.write(b"\n")
        except OSError as error:
            raise ConfigError(
                f"{file.parent} cannot be written, the folder of the driver's marker file: {error}; "
                "free space there, or set XDG_STATE_HOME to another folder"
            ) from error

    def make(self) -> None:
        """Create the marker before the first command."""
        if self.made:
            return
        self.made = True
        try:
            self._file.parent.mkdir(parents=True, exist_ok=True)
            if (locked := self._lock()) is not None:
                locked.truncate(0)
                locked.write(f"{os.getpid()}\n".encode())
        except OSError as error:
            self.failure = (
                f"the marker of this run is incomplete, so a crash of the driver may not be detected: {error}"
            )

    def remove(self) -> None:
        """Remove the marker after the last command; the next command begins a new run."""
        self.made = self.crashed = False
        self.failure = ""
        with suppress(OSError):
            if self._file.exists() and self._lock() is not None:
                self._file.unlink(missing_ok=True)
        self._unlock()

    def _lock(self) -> FileIO | None:
        """Lock the file until ``_unlock`` or the end of this process; None if another process has locked it."""
        if self._locked is None:
            file = FileIO(self._file, "a+")
            try:
                fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                file.close()
                return None
            self._locked = file
        return self._locked

    def _unlock(self) -> None:
        if self._locked is not None:
            self._locked.close()
            self._locked = None


class RobotConnection(Protocol):
    """A connection to a robot."""

    def take(self) -> list[Any]:
        """Messages of the robot since the last call, the oldest first."""

    def send(self, data: bytes) -> None:
        """Send a serialised command."""

    def commands(self) -> list[bytes]:
        """Serialised commands of all programs since the last call, including those of this connection."""

    def beats(self) -> list[bool]:
        """Heartbeats of the guard process since the last call; each is whether the guard is armed."""

    def close(self) -> None:
        """Leave the robot's domain."""


class RealPlant(HardwarePlant):
    """Period, run marker and shutdown of the plant of a real robot.

    ``close`` fades the torque of the last command into damping. If the guard has begun this fade after ``silence_max``,
    ``close`` continues it. A robot that this driver has not commanded gets no command, and the marker of a
    crash remains. ``name`` of the plant and ``where`` (robot's interface and domain) make up the path of the marker if
    ``marker`` is empty. ``period`` is the time between two samples [s].
    """

    def __init__(self, model: RobotModel, name: str, where: str, marker: str, period: float) -> None:
        self._period = period
        self.counter = SampleCounter(period)
        nothing, three = np.full(model.nj, np.nan), np.full(3, np.nan)
        self._sensors = SensorData(0.0, nothing, nothing, nothing, three, three, np.full((2, 6), np.nan))
        self._model = model
        self._sent, self._sent_at = b"", 0.0  # the last command and its time on the monotonic clock [s]
        self._marker = RunMarker(Path(marker) if marker else state_folder(name) / where)
        self.guard = GuardWatch(period)
        self._stop = ""
        self._jumped = False  # whether the robot's clock jumped in the newest ``read``
        self._closed = False
        self._link: RobotConnection

    @property
    def period(self) -> float:
        return self._period

    @property
    def crashed(self) -> bool:
        """Whether the marker of an unfinished run existed at the start."""
        return self._marker.crashed

    @property
    def unfinished(self) -> bool:
        return self._marker.crashed or self._marker.made or self.guard.armed

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of a silent guard and of a run that could not be marked."""
        return (*self.guard.warnings, *filter(None, [self._marker.failure]))

    @property
    def holds(self) -> tuple[str, ...]:
        """Holds of the guard watch."""
        return self.guard.holds

    @property
    def stop(self) -> str:
        """Reason to damp in the newest ``read``."""
        return self._stop

    @property
    def jumped(self) -> bool:
        return self._jumped

    @property
    def _sampled(self) -> bool:
        """Whether a sample has been received."""
        return self._sensors.t > 0.0

    def write(self, command: JointCommand) -> None:
        """Send a command; nothing is sent before the first sample."""
        if self._sampled and not self._closed:
            self._marker.make()
            self._send(command)

    def close(self) -> None:
        """Damp the joints if this driver has commanded them, and leave the domain."""
        if self._closed:
            return
        if self._marker.made:
            last, config = self._decode_command(self._sent), real_robot()
            faded = max(time.monotonic() - self._sent_at - config.silence_max / self.speed, 0.0)  # by the guard [s]
            for count in range(round(config.close_time / config.command_period)):
                self.read()
                command = fade_to_damping(self._model, last, faded + count * config.command_period)
                self._send(command)
                time.sleep(config.command_period)
            self._finish()
            self._marker.remove()
        self._closed = True
        self._link.close()

    def _send(self, command: JointCommand) -> None:
        self._sent, self._sent_at = self._encode_command(command), time.monotonic()
        self._link.send(self._sent)

    def _encode_command(self, command: JointCommand) -> bytes:
        """Serialised message of a command for the newest state."""
        raise NotImplementedError

    def _decode_command(self, data: bytes) -> JointCommand:
        """Command in a message of ``_encode_command``."""
        raise NotImplementedError

    def _finish(self) -> None:
        """Hook of a protocol: further messages after the damping of ``close``."""
