"""Inputs of the control stack between two ticks, recorded so that a replay can repeat them at the same ticks.

The messages of sensors, commands and trajectories do not show when the stack received an input: which mode began with
which tick, which velocity was in force, which samples made a tick and how long it was. A tick without a change has no
record.

A message is a JSON object: ``stamp`` of the tick [ns]; ``number``, which counts them; ``before`` and ``after``, the
inputs before and after that tick's estimate, oldest first; ``again``, whether the same state was answered once more.
Doubles are written so that they are read back bit for bit. Each entry is a list, its word first:

======================================== ========================================================================
``start`` {...}                          the estimator starts: ``robot``, ``settings`` of the stages, ``sample``, and
                                         ``calibration`` of the sensors. ``steps``: whether it then advances by this
                                         tick's sample, too. ``after``: stamp of the last tick before [ns]
``sample`` {source: stamp or null, ...}  sources whose sample has another stamp than the tick [ns], or none
``dt`` seconds                           from here on the time between two samples of the estimator
``law_dt`` seconds                       the same of the whole-body law
``reset``                                the whole-body laws start over
``mode`` name                            the mode from here on
``follow`` crc, times                    a motion: CRC-32 of its message; its times [s], of which the message's
                                         nanoseconds lose digits
``stop_motion``                          the motion ends
``head`` pan, tilt                       targets of the head's joints [rad, rad]
``gain`` name, value                     a gain of the standing law moves to a value
``velocity`` forward, left, turn         of a walk, once [m/s, m/s, rad/s]
``hold_velocity`` forward, left, turn    the same, repeated at every tick from here on until ``stop`` or ``reset``
``stop``                                 of a walk
``walk_to`` x, y, yaw, z                 goal of a walk [m, m, rad, m]
``take_steps`` [[foot, x, y, yaw, z]...], touchdown  footsteps, and after which touchdown of a route, null from standing
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
KEPT, MOTIONS = 16384, 8  #: Newest records and motions that are kept


class InputLog:
    """Collects the inputs of the stack until the end of a tick."""

    def __init__(self) -> None:
        self.stages: dict[str, LawState] = {}  #: Location of the state of each stage
        self.kept: deque[tuple[int, str]] = deque(maxlen=KEPT)  #: The newest records, stamp [ns] and message
        self.motions: dict[int, JointTrajectory] = {}  #: The newest trajectories by their number
        #: Numbers a motion; by default with a checksum of its positions
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
        """Find the state of a stage that has just been built, for checkpoints; objects apart hold none of it."""
        self.stages[stage] = LawState(built, (self, *apart))

    def follow(self, number: int, trajectory: JointTrajectory) -> None:
        """Record that a motion begins, and keep the motion."""
        self.note("follow", number, trajectory.times.tolist())
        self.motions[number] = trajectory
        if len(self.motions) > MOTIONS:
            del self.motions[next(iter(self.motions))]

    @property
    def pending(self) -> bool:
        """Whether there are inputs that are in no record yet."""
        return bool(self._before or self._after)

    @property
    def in_force(self) -> dict[str, tuple[object, ...]]:
        """Inputs that hold until they change, by word."""
        return dict(self._last)

    def note(self, word: str, *values: object) -> None:
        """Record an input; see the words above."""
        self._now.append((word, *values))

    def begin(
        self, robot: str, sample: SensorData, calibration: Calibration | None, *, steps: bool = False, after: int = 0
    ) -> None:
        """Record that the estimator starts from a measured sample; all inputs in force are recorded anew from here on.

        With ``steps`` it then advances by this tick's sample, too. ``after`` is the stamp of its last tick before [ns],
        0 without one; ``calibration`` corrects the samples from now on.
        """
        self._last.clear()
        start = {"robot": robot, "settings": self.settings, "sample": plain(sample), "steps": steps, "after": after}
        self.note("start", start | {"calibration": None if calibration is None else plain(calibration)})

    def note_change(self, word: str, *values: object) -> None:
        """Record an input that holds until it changes, if it has changed."""
        if self._last.get(word) != values:
            self._last[word] = values
            self.note(word, *values)

    def forget(self, word: str) -> None:
        """An input holds no more: it is recorded anew when it comes again."""
        self._last.pop(word, None)

    def clear(self) -> None:
        """Drop the inputs of this tick."""
        self._now = self._before
        self._before.clear()
        self._after.clear()

    def estimated(self) -> None:
        """Inputs until the end of the tick come after its estimate."""
        self._now = self._after

    def take(self, stamp: int, *, again: bool = False) -> str:
        """End a tick of a stamp [ns], or another answer to its state; returns its message, empty without inputs."""
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
    """A record of arrays for JSON, exact to the last bit."""
    held = structs.asdict(data) if isinstance(data, Struct) else asdict(data)
    return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in held.items()}


@dataclass(frozen=True, slots=True)
class TickInputs:
    """One message of ``InputLog``, read back."""

    stamp: int  # of the tick [ns]
    number: int  # counts the messages of one run
    before: tuple[Entry, ...] = ()  # inputs before the estimate
    after: tuple[Entry, ...] = ()  # inputs after it
    again: bool = False  # the state of that tick was answered once more

    @classmethod
    def read(cls, text: str) -> TickInputs:
        """Read a message; MessageError when it is malformed."""
        try:
            return convert(json.loads(text), cls)
        except (ValueError, ValidationError) as error:
            raise MessageError(f"not a record of inputs: {error}") from error

    def value(self, word: str) -> Any:
        """First value of the newest entry of a word; None without one."""
        found = [entry[1] for entry in (*self.before, *self.after) if entry[0] == word]
        return found[-1] if found else None
