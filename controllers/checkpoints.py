"""States of the laws from the last seconds, so that what a black box holds can be run again."""

from __future__ import annotations

import json
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.applied import Applied, TickNote, plain
from models.constants import NANOSECONDS
from models.law_state import Bytes, Captured, LawState
from models.law_state_file import describe
from models.types import RobotState

PERIOD = 4.0
"""Time between two checkpoints [s]: one takes as long as half a tick."""

STANDING, WALKING = ("estimator", "tuning", "balance", "gait"), ("estimator", "tuning", "walker", "gait")
"""Laws whose state counts. The one that does not move the joints starts over when it takes over."""


@dataclass(frozen=True, slots=True)
class ReplayStart:
    """Where a replay begins, and what the laws were told from there on.

    Attributes:
        told: Settings, notes, motions, and a description of the state.
        memory: Of the state.
    """

    told: dict[str, Any]
    memory: Bytes


@dataclass(slots=True)
class Checkpoint:
    """The laws after a tick.

    Attributes:
        stamp: Of the tick [ns].
        row: Number of its row in the black box.
        walking: Whether the walker moved the joints.
        state: The estimate.
        scheduled: Feet that the reference had in contact.
        in_force: What the laws had been told and still held.
        laws: State of each law.
    """

    stamp: int
    row: int
    walking: bool
    state: RobotState
    scheduled: tuple[bool, bool] | None
    in_force: dict[str, tuple[object, ...]]
    laws: dict[str, tuple[LawState, Captured]]


class Checkpoints:
    """A ring of copies of the state of the laws, taken after a tick, once the command is out.

    Args:
        applied: What the laws are told, and where their state is.
        duration: What the ring is to span [s].

    Attributes:
        ring: The checkpoints, the oldest first.
    """

    def __init__(self, applied: Applied, duration: float) -> None:
        self._applied = applied
        count = int(duration / PERIOD) + 2
        self._slots: list[dict[str, tuple[Bytes, list[NDArray[Any]]]]] = [{} for _ in range(count)]
        self.ring: deque[Checkpoint] = deque(maxlen=count)
        self._next = 0
        self._due = 0

    def prepare(self) -> None:
        """Take memory, once the laws have been built and before they move the joints."""
        for slot in self._slots:
            for name, law in self._applied.laws.items():
                if name not in slot:
                    memory = law.memory()
                    slot[name] = memory, law.views(memory)

    def clear(self) -> None:
        """The robot starts over."""
        self.ring.clear()
        self._due = 0

    def tick(
        self, stamp: int, row: int, state: RobotState, scheduled: tuple[bool, bool] | None, *, walking: bool
    ) -> None:
        """Take a checkpoint when one is due, after a tick with which a law has moved the joints.

        Args:
            stamp: Of the tick [ns].
            row: Number of its row in the black box.
            state: Its estimate.
            scheduled: Feet that its reference has in contact.
            walking: Whether it was the walker's.
        """
        if self._due - PERIOD * NANOSECONDS <= stamp < self._due:
            return
        self._due = stamp + round(PERIOD * NANOSECONDS)
        slot = self._slots[self._next]
        self._next = (self._next + 1) % len(self._slots)
        laws = self._applied.laws
        wanted = [name for name in (WALKING if walking else STANDING) if name in laws]
        captured = {name: (laws[name], laws[name].capture(*slot[name])) for name in wanted}
        self.ring.append(Checkpoint(stamp, row, walking, state, scheduled, self._applied.in_force, captured))

    def start(self, rows: NDArray[np.int64]) -> ReplayStart | None:
        """The oldest checkpoint from which on no row is missing; None without one.

        Args:
            rows: Numbers of the rows that are there, the oldest first (n,).
        """
        gaps = np.flatnonzero(np.diff(rows) != 1)
        first = int(rows[gaps[-1] + 1] if gaps.size else rows[0]) if rows.size else 0
        checkpoint = next((each for each in self.ring if rows.size and each.row >= first), None)
        if checkpoint is None:
            return None
        applied, memory, states = self._applied, [], {}
        size = 0
        for name, (law, captured) in checkpoint.laws.items():
            data, told = describe(law, captured)
            states[name] = told | {"begin": size, "size": len(data)}
            memory.append(data)
            size += len(data)
        notes = [text for stamp, text in list(applied.kept) if stamp >= checkpoint.stamp]
        entries = [entry for note in map(TickNote.read, notes) for entry in (*note.before, *note.after)]
        followed = {entry[1] for entry in entries if entry[0] == "follow"}
        motions = {number: plain(motion) for number, motion in dict(applied.motions).items() if number in followed}
        feet = [[each.active, each.wrench.tolist()] for each in checkpoint.state.contacts]
        told = {
            "stamp": checkpoint.stamp,
            "row": checkpoint.row,
            "walking": checkpoint.walking,
            "state": plain(checkpoint.state) | {"contacts": feet},
            "scheduled": checkpoint.scheduled,
            "in_force": checkpoint.in_force,
            "settings": applied.settings,
            "laws": states,
            "notes": notes,
            "motions": motions,
        }
        return ReplayStart(json.loads(json.dumps(told)), np.concatenate(memory))
