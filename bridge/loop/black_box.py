"""Black box of the closed loop: filled at every tick, written after a fault has damped the robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from bridge.loop.lockstep import Lockstep
from controllers.recording.black_box import BlackBox
from controllers.recording.black_box_file import BlackBoxFolder
from controllers.safety.supervisor import ACTIVE_MODES
from controllers.stack import ControlStack
from models.types import Mode


class LoopBlackBox:
    """Writes one file into ``folder`` each time a fault ends an active mode; ``files`` lists them.

    ``events`` are stamps and texts, read when a file is written; ``box`` is the ring.
    """

    def __init__(self, stack: ControlStack, folder: Path, events: Sequence[tuple[float, str]]) -> None:
        self._stack, self._events = stack, events
        self.box = BlackBox(stack.robot, stack=stack)
        self.files: list[Path] = []
        self._folder = BlackBoxFolder(stack.robot.name, folder, self.box.config.keep)
        self._before = Mode.OFF
        self._due: float | None = None

    def tick(self, lockstep: Lockstep) -> None:
        """Record one tick and write when due; ``PoiseError`` when writing fails."""
        stack = self._stack
        supervisor, t, mode = stack.supervisor, stack.state.t, stack.mode
        if lockstep.tick <= 1:  # a new run
            self.box.clear()
            self._before, self._due = Mode.OFF, None
        result = stack.result if mode in ACTIVE_MODES else None
        self.box.add(stack.state, stack.raw, result, mode, lockstep.stamp)
        pending = stack.log is not None and stack.log.pending  # inputs since the tick, which the next note repeats
        if result is not None and stack.scheduled is not None and not pending:
            self.box.checkpoint()
        if self._before in ACTIVE_MODES and mode in (Mode.DAMP, Mode.OFF) and supervisor.faults:
            self._due = t + self.box.config.after
        self._before = mode
        if self._due is not None and t >= self._due:
            self._due = None
            record = self.box.record("; ".join(supervisor.faults))
            events = tuple(event for event in self._events if event[0] >= record.t[0])
            self.files.append(self._folder.save(replace(record, events=events)))
