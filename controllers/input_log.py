"""Records the inputs of the control stack in each tick, so that a replay can apply them at the same ticks.

The messages of sensors, commands and trajectories do not show when the stack received them: the first tick of a mode,
the velocity in force, the samples of a tick and its length. A tick without a change has no record.

A message is a JSON object: ``stamp`` of the tick [ns]; ``number``, a counter of messages; ``before`` and ``after``, the
inputs before and after the estimate of the tick, oldest first; ``again``, true when the law ran again on the same
state. Doubles are read back bit for bit. Each entry is a list that starts with its word:

======================================== ========================================================================
``start`` {...}                          start of the estimator: ``robot``, ``settings`` of the stages, ``sample``,
                                         ``calibration`` of the sensors; ``steps``: the estimator also advances by the
                                         sample of this tick; ``after``: stamp of the previous tick [ns]
``sample`` {source: stamp or null, ...}  sources whose sample has another stamp than the tick [ns], or is missing
``dt`` seconds                           time between two samples of the estimator, from this tick on
``law_dt`` seconds                       time between two ticks of the whole-body law, from this tick on
``reset``                                reset of the whole-body laws
``mode`` name                            mode from this tick on
``follow`` crc, times                    start of a motion: CRC-32 of its message; its times [s], since the nanoseconds
                                         of the message round them
``stop_motion``                          end of the motion
``head`` pan, tilt                       targets of the head joints [rad, rad]
``gain`` name, value                     target of a gain of the standing law
``velocity`` forward, left, turn         velocity of a walk, applied once [m/s, m/s, rad/s]
``hold_velocity`` forward, left, turn    velocity of a walk, applied at every tick until ``stop`` or ``reset``
``stop``                                 end of a walk
``walk_to`` x, y, yaw, z                 goal of a walk [m, m, rad, m]
``take_steps`` [[foot, x, y, yaw, z]...], touchdown  footsteps; the touchdown of the route they follow, null if standing
======================================== ========================================================================
"""

from __future__ import annotations

import json
import zlib
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from msgspec import Struct, ValidationError, convert, structs

from models.calibration import Calibration
from models.errors import MessageError
from models.law_state import LawState
from models.types import JointTrajectory, SensorData

Entry = tuple[Any, ...]  #: Word and values
KEPT, MOTIONS = 16384, 8  #: Number of newest records and motions in memory


class InputLog:
    """Collects the inputs of the stack until the end of a tick."""

    def __init__(self) -> None:
        self.stages: dict[str, LawState] = {}  #: State of each stage, by reference
        self.kept: deque[tuple[int, str]] = deque(maxlen=KEPT)  #: Newest records: stamp [ns] and message
        self.motions: dict[int, JointTrajectory] = {}  #: Newest trajectories by number
        #: Returns the number of a motion; a checksum of its positions by default
        self.number: Callable[[JointTrajectory], int] = lambda motion: zlib.crc32(motion.positions.tobytes())
        self.settings: dict[str, object] = {}  #: Configuration of each stage
        self._before: list[Entry] = []
        self._after: list[Entry] = []
        self._now = self._before
        self._count = 0
        self._last: dict[str, tuple[object, ...]] = {}

    def describe(self, stage: str, config: Any) -> None:
        """Record the configuration of a stage, a dataclass."""
        self.settings[stage] = asdict(config)

    def watch(self, stage: str, built: object, *apart: object) -> None:
        """Register the state of a newly built stage for checkpoints; the objects ``apart`` are excluded."""
        self.stages[stage] = LawState(built, (self, *apart))

    def follow(self, number: int, trajectory: JointTrajectory) -> None:
        """Record the start of a motion, and store the motion."""
        self.note("follow", number, trajectory.times.tolist())
        self.motions[number] = trajectory
        if len(self.motions) > MOTIONS:
            del self.motions[next(iter(self.motions))]

    @property
    def pending(self) -> bool:
        """Whether there are inputs without a record."""
        return bool(self._before or self._after)

    @property
    def in_force(self) -> dict[str, tuple[object, ...]]:
        """Last values of the inputs that are recorded only on change, by word."""
        return dict(self._last)

    def note(self, word: str, *values: object) -> None:
        """Record an input; the module's docstring lists the words."""
        self._now.append((word, *values))

    def begin(
        self, robot: str, sample: SensorData, calibration: Calibration | None, *, steps: bool = False, after: int = 0
    ) -> None:
        """Record that the estimator starts from a measured sample. All inputs in force are then recorded again.

        With ``steps``, the estimator also advances by the sample of this tick. ``after`` is the stamp of the previous
        tick [ns], 0 without one; ``calibration`` corrects the samples from this tick on.
        """
        self._last.clear()
        start = {"robot": robot, "settings": self.settings, "sample": plain(sample), "steps": steps, "after": after}
        self.note("start", start | {"calibration": None if calibration is None else plain(calibration)})

    def note_change(self, word: str, *values: object) -> None:
        """Record an input if its values differ from the last ones."""
        if self._last.get(word) != values:
            self._last[word] = values
            self.note(word, *values)

    def forget(self, word: str) -> None:
        """Discard the last values of an input, so that the next ones are recorded."""
        self._last.pop(word, None)

    def clear(self) -> None:
        """Drop the inputs of this tick."""
        self._now = self._before
        self._before.clear()
        self._after.clear()

    def estimated(self) -> None:
        """Assign the inputs from now to the end of the tick to ``after``."""
        self._now = self._after

    def take(self, stamp: int, *, again: bool = False) -> str:
        """End the tick of a stamp [ns], or a repeated run on its state; returns its message, empty without inputs."""
        self._now = self._before
        if not self._before and not self._after:
            return ""
        record = {"stamp": stamp, "number": self._count, "before": self._before, "after": self._after, "again": again}
        text = json.dumps(record)
        self.kept.append((stamp, text))
        self._count += 1
        self.clear()
        return text


def plain(data: Any) -> dict[str, object]:
    """Convert a record of arrays to plain values for JSON; exact to the last bit."""
    held = structs.asdict(data) if isinstance(data, Struct) else asdict(data)
    return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in held.items()}


@dataclass(frozen=True, slots=True)
class TickInputs:
    """A decoded message of ``InputLog``."""

    stamp: int  # of the tick [ns]
    number: int  # counts the messages of one run
    before: tuple[Entry, ...] = ()  # inputs before the estimate
    after: tuple[Entry, ...] = ()  # inputs after it
    again: bool = False  # the law ran again on the state of this tick

    @classmethod
    def read(cls, text: str) -> TickInputs:
        """Decode a message; ``MessageError`` when it is malformed."""
        try:
            return convert(json.loads(text), cls)
        except (ValueError, ValidationError) as error:
            raise MessageError(f"not a record of inputs: {error}") from error

    def value(self, word: str) -> Any:
        """First value of the newest entry with a word; None without an entry."""
        found = [entry[1] for entry in (*self.before, *self.after) if entry[0] == word]
        return found[-1] if found else None
