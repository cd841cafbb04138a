"""What the laws are told between two ticks, noted so that a replay can tell them the same at the same ticks.

The sensors, the commands and the trajectories are messages of their own. What they do not say is when the laws heard
what: which mode began with which tick, which velocity was in force, which samples made a tick and how long it was. A
tick at which nothing of this changes has no note.

A message is a JSON object: ``stamp`` of the tick [ns]; ``number``, which counts them; ``before`` and ``after``, what
the laws were told before and after that tick's estimate, oldest first; ``again``, whether the law that moves the joints
answered the same state once more. Doubles are written so that they are read back bit for bit. Each entry is a list,
its word first:

======================================== ========================================================================
``start`` {...}                          the estimator starts: ``robot``, ``settings`` of the laws, ``sample``, and
                                         ``calibration`` of the sensors. ``steps``: whether it then advances by this
                                         tick's sample, too. ``after``: stamp of the last tick before [ns]
``sample`` {source: stamp or null, ...}  sources whose sample has another stamp than the tick [ns], or none
``dt`` seconds                           from here on the time between two samples of the estimator
``law_dt`` seconds                       the same of the law that moves the joints
``run`` true or false                    from here on a law moves the joints, or none does
``reset``                                the laws start over
``walk`` true or false, mode             the walker takes over, or it is left for a mode
``follow`` crc, times                    a motion: CRC-32 of its message; its times [s] where the message's
                                         nanoseconds do not hold them
``stop_motion``                          the motion ends
``head`` pan, tilt                       angles that the head's joints are sent to [rad, rad]
``gain`` name, value                     a gain of the standing law goes over to a value
``velocity`` forward, left, turn         of a walk, once [m/s, m/s, rad/s]
``hold_velocity`` forward, left, turn    the same, told again at every tick of the walker
``stop``                                 of a walk
``walk_to`` x, y, yaw, z                 goal of a walk [m, m, rad, m]
``take_steps`` [[foot, x, y, yaw, z]...] footsteps
======================================== ========================================================================
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Collection
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from msgspec import Struct, structs

from models.calibration import Calibration
from models.errors import MessageError
from models.law_state import LawState
from models.types import JointTrajectory, SensorData

Entry = tuple[Any, ...]
"""Word and values."""


KEPT, MOTIONS = 16384, 8
"""Newest notes and motions that are kept."""


class Applied:
    """Collects what the laws are told until the end of a tick.

    Attributes:
        robot: Name of the robot; empty before the first start.
        settings: How each law is set.
        laws: Where the state of each law is.
        kept: The newest notes, stamp [ns] and message.
        motions: The newest trajectories by the number in their note.
    """

    def __init__(self) -> None:
        self.robot = ""
        self.laws: dict[str, LawState] = {}
        self.kept: deque[tuple[int, str]] = deque(maxlen=KEPT)
        self.motions: dict[int, JointTrajectory] = {}
        self._before: list[Entry] = []
        self._after: list[Entry] = []
        self._now = self._before
        self._number = 0
        self._last: dict[str, tuple[object, ...]] = {}
        self.settings: dict[str, object] = {}

    def describe(self, law: str, config: Any) -> None:
        """Say how a law is set; config is its dataclass."""
        self.settings[law] = asdict(config)

    def watch(self, law: str, built: object, apart: Collection[object] = ()) -> None:
        """Have the state of a law, which has just been built, be found; ``apart`` as in ``LawState``."""
        self.laws[law] = LawState(built, (*apart, self))

    def follow(self, number: int, trajectory: JointTrajectory, *times: list[float]) -> None:
        """Note that a motion begins, and keep it."""
        self.note("follow", number, *times)
        self.motions[number] = trajectory
        if len(self.motions) > MOTIONS:
            del self.motions[next(iter(self.motions))]

    @property
    def pending(self) -> bool:
        """Whether the laws have been told something that no note holds yet."""
        return bool(self._before or self._after)

    @property
    def in_force(self) -> dict[str, tuple[object, ...]]:
        """What holds until it changes, by its word."""
        return dict(self._last)

    def note(self, word: str, *values: object) -> None:
        """Note something that happened; see the words above."""
        self._now.append((word, *values))

    def begin(
        self,
        robot: str,
        sample: SensorData,
        *,
        steps: bool = False,
        calibration: Calibration | None = None,
        after: int = 0,
    ) -> None:
        """Note that the estimator starts; whatever holds is told anew from here on.

        Args:
            robot: Name of the profile.
            sample: What it starts from.
            steps: Whether it then advances by this tick's sample, too.
            calibration: What the samples are corrected by from now on.
            after: Stamp of its last tick before [ns]; 0 for none.
        """
        self._last.clear()
        self.robot = robot
        start = {"robot": robot, "settings": self.settings, "sample": plain(sample), "steps": steps, "after": after}
        self.note("start", start | {"calibration": None if calibration is None else plain(calibration)})

    def note_change(self, word: str, *values: object) -> None:
        """Note it unless it is what was noted last."""
        if self._last.get(word) != values:
            self._last[word] = values
            self.note(word, *values)

    def estimated(self) -> None:
        """What comes now until the tick ends is after its estimate."""
        self._now = self._after

    def take(self, stamp: int, *, again: bool = False) -> str:
        """End a tick of a stamp [ns], or another answer to its state; returns its message, empty without any note."""
        self._now = self._before
        if not self._before and not self._after:
            return ""
        told = {"stamp": stamp, "number": self._number, "before": self._before, "after": self._after, "again": again}
        text = json.dumps(told)
        self.kept.append((stamp, text))
        self._number += 1
        self._before.clear()
        self._after.clear()
        return text


def plain(data: Any) -> dict[str, object]:
    """A record of arrays for JSON, exact to the last bit."""
    held = structs.asdict(data) if isinstance(data, Struct) else asdict(data)
    return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in held.items()}


@dataclass(frozen=True, slots=True)
class TickNote:
    """One message of ``Applied``, read back.

    Attributes:
        stamp: Of the tick [ns].
        number: Counts the messages of one run.
        before: What was told before the estimate.
        after: What was told after it.
        again: Whether it is of another answer to the state of that tick.
    """

    stamp: int
    number: int
    before: tuple[Entry, ...] = ()
    after: tuple[Entry, ...] = ()
    again: bool = False

    @classmethod
    def read(cls, text: str) -> TickNote:
        """Read a message.

        Raises:
            MessageError: It is none.
        """
        try:
            data = json.loads(text)
            before, after = (tuple(tuple(entry) for entry in data[name]) for name in ("before", "after"))
            return cls(int(data["stamp"]), int(data["number"]), before, after, bool(data["again"]))
        except (ValueError, KeyError, TypeError) as error:
            raise MessageError(f"not a note of what the laws were told: {error}") from error

    def value(self, word: str) -> Any:
        """First value of the newest entry of a word; None without one."""
        found = [entry[1] for entry in (*self.before, *self.after) if entry[0] == word]
        return found[-1] if found else None
