"""Black box of the closed loop: filled at every tick, written when a fault has had the robot damped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from bridge.lockstep import Lockstep
from controllers.black_box import BlackBox
from controllers.black_box_file import BlackBoxFolder
from controllers.supervisor import ACTIVE_MODES
from models.applied import Applied
from models.robot_model import RobotModel
from models.types import Mode


class LoopBlackBox:
    """Writes one file for each time that a fault ends an active mode.

    Args:
        robot: The robot.
        folder: Where the files go.
        events: Stamp and text of what happened; read when a file is written.
        applied: What the laws are told, so that a file can be run again; None where it cannot.

    Attributes:
        box: The ring.
        files: What was written.
    """

    def __init__(
        self, robot: RobotModel, folder: Path, events: Sequence[tuple[float, str]], applied: Applied | None
    ) -> None:
        self.box = BlackBox(robot, applied=applied)
        self.files: list[Path] = []
        self._folder = BlackBoxFolder(robot.name, folder, self.box.config.keep)
        self._events, self._applied = events, applied
        self._before = Mode.OFF
        self._due: float | None = None

    def tick(self, lockstep: Lockstep) -> None:
        """Keep one tick; write when the time has come.

        Raises:
            PoiseError: The disk refuses.
        """
        supervisor, t = lockstep.supervisor, lockstep.state.t
        mode = supervisor.mode
        if lockstep.tick <= 1:  # it starts over
            self.box.clear()
            self._before, self._due = Mode.OFF, None
        result = lockstep.result if mode in ACTIVE_MODES else None
        self.box.add(lockstep.state, lockstep.heard, result, mode, lockstep.stamp)
        told = self._applied is not None and self._applied.pending  # by the supervisor, and the next note says it again
        if result is not None and lockstep.scheduled is not None and not told:
            self.box.checkpoint(lockstep.state, lockstep.scheduled, walking=lockstep.laws.walking)
        if self._before in ACTIVE_MODES and mode in (Mode.DAMP, Mode.OFF) and supervisor.faults:
            self._due = t + self.box.config.after
        self._before = mode
        if self._due is not None and t >= self._due:
            self._due = None
            record = self.box.record("; ".join(supervisor.faults))
            events = tuple(event for event in self._events if event[0] >= record.t[0])
            self.files.append(self._folder.save(replace(record, events=events)))
