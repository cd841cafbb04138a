"""States of the control stack from the last seconds, so that the record of a black box can be run again."""

import json
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.input_log import InputLog, TickInputs, plain
from controllers.stack import ControlStack, StackMemory
from models.constants import NANOSECONDS
from models.law_state import Bytes, Captured, LawState, describe

PERIOD = 4.0  #: Time between two checkpoints [s]: one takes as long as half a tick


@dataclass(frozen=True, slots=True)
class ReplayStart:
    """Start of a replay, and the inputs of the stack from there on."""

    record: dict[str, Any]  # settings, inputs, motions, and a description of the state
    data: Bytes  # arrays of the state


@dataclass(slots=True)
class Checkpoint:
    """The stack after a tick."""

    stamp: int  # of the tick [ns]
    row: int  # number of its row in the black box
    memory: StackMemory  # of the stack
    in_force: dict[str, tuple[object, ...]]  # inputs that held
    stages: dict[str, tuple[LawState, Captured]]  # state of each stage


class Checkpoints:
    """A ring of copies of the state of a stack over a ``duration`` [s], taken after a tick, once the command is out.

    ``ring`` holds the checkpoints, the oldest first.
    """

    def __init__(self, stack: ControlStack, log: InputLog, duration: float) -> None:
        self._stack, self._log = stack, log
        count = int(duration / PERIOD) + 2
        self._slots: list[dict[str, list[NDArray[Any]]]] = [{} for _ in range(count)]
        self.ring: deque[Checkpoint] = deque(maxlen=count)
        self._next = 0
        self._due = 0

    def prepare(self) -> None:
        """Allocate memory, once the stages have been built and before they move the joints."""
        for slot in self._slots:
            for name, stage in self._log.stages.items():
                if name not in slot:
                    slot[name] = stage.memory()

    def clear(self) -> None:
        """The robot starts over."""
        self.ring.clear()
        self._due = 0

    def tick(self, stamp: int, row: int) -> None:
        """Take a checkpoint when one is due, after a tick with which a law has moved the joints.

        ``stamp`` is that of the tick [ns], ``row`` the number of its row in the black box.
        """
        if self._due - PERIOD * NANOSECONDS <= stamp < self._due:
            return
        self._due = stamp + round(PERIOD * NANOSECONDS)
        slot = self._slots[self._next]
        self._next = (self._next + 1) % len(self._slots)
        captured = {name: (stage, stage.capture(slot[name])) for name, stage in self._log.stages.items()}
        self.ring.append(Checkpoint(stamp, row, self._stack.memory, self._log.in_force, captured))

    def start(self, rows: NDArray[np.int64]) -> ReplayStart | None:
        """The oldest checkpoint from which on no row (n,) is missing; None without one."""
        gaps = np.flatnonzero(np.diff(rows) != 1)
        first = int(rows[gaps[-1] + 1] if gaps.size else rows[0]) if rows.size else 0
        checkpoint = next((each for each in self.ring if rows.size and each.row >= first), None)
        if checkpoint is None:
            return None
        log, data, stages = self._log, [], {}
        size = 0
        for name, (stage, captured) in checkpoint.stages.items():
            part, description = describe(stage, captured)
            stages[name] = description | {"begin": size, "size": len(part)}
            data.append(part)
            size += len(part)
        inputs = [text for stamp, text in list(log.kept) if stamp >= checkpoint.stamp]
        entries = [entry for each in map(TickInputs.read, inputs) for entry in (*each.before, *each.after)]
        followed = {entry[1] for entry in entries if entry[0] == "follow"}
        record = {
            "stamp": checkpoint.stamp,
            "row": checkpoint.row,
            "memory": memory_to_plain(checkpoint.memory),
            "in_force": checkpoint.in_force,
            "settings": log.settings,
            "stages": stages,
            "inputs": inputs,
            "motions": {number: plain(motion) for number, motion in dict(log.motions).items() if number in followed},
        }
        return ReplayStart(json.loads(json.dumps(record)), np.concatenate(data))


def memory_to_plain(memory: StackMemory) -> dict[str, Any]:
    """The memory of a stack for JSON; exact."""
    feet = [[each.active, each.wrench.tolist()] for each in memory.state.contacts]
    fields: dict[str, Any] = memory._asdict()
    calibration = None if memory.correction is None else plain(memory.correction)
    return fields | {
        "state": plain(memory.state) | {"contacts": feet},
        "mode": memory.mode.value,
        "correction": calibration,
    }
