"""Black box: ring buffer of the signals of the control process over the last seconds, written at every tick.

``add`` copies one tick into arrays whose pages are already mapped, without allocation or I/O, in about 7 us. While
``sealed``, after a fault, ``add`` does nothing, so ``record`` may run in another thread.
"""

import json
from collections import deque
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass as schema

from controllers.input_log import InputLog, TickInputs, plain
from controllers.recording.black_box_file import BlackBoxRecord, ReplayStart
from controllers.stack import ControlStack, StackSnapshot
from models.config import STRICT, default_config
from models.constants import NANOSECONDS
from models.law_state import Captured, LawState, describe
from models.robot_model import RobotModel
from models.types import ControlResult, Mode, RobotState, SensorData, SolveStatus

CHECKPOINT_PERIOD = 4.0  #: Time between two checkpoints [s]; a checkpoint takes about half a tick


@dataclass(slots=True)
class Checkpoint:
    """State of the stack after a tick."""

    stamp: int  # of the tick [ns]
    row: int  # number of the tick in the black box
    memory: StackSnapshot  # state of the stack without its stages
    in_force: dict[str, tuple[object, ...]]  # inputs in force
    stages: dict[str, tuple[LawState, Captured]]  # state of each stage


class Checkpoints:
    """Ring buffer of checkpoints of a stack over a ``duration`` [s], oldest first."""

    def __init__(self, stack: ControlStack, log: InputLog, duration: float) -> None:
        self._stack, self._log = stack, log
        count = int(duration / CHECKPOINT_PERIOD) + 2
        self._slots: list[dict[str, list[NDArray[Any]]]] = [{} for _ in range(count)]
        self.ring: deque[Checkpoint] = deque(maxlen=count)
        self._next = 0
        self._due = 0

    def prepare(self) -> None:
        """Allocate memory, after the stages have been built and before the first active tick."""
        for slot in self._slots:
            for name, stage in self._log.stages.items():
                if name not in slot:
                    slot[name] = stage.memory()

    def clear(self) -> None:
        """Discard all checkpoints, at a reset of the robot."""
        self.ring.clear()
        self._due = 0

    def tick(self, stamp: int, row: int) -> None:
        """Take a checkpoint when due, after an active tick with a stamp [ns] and a ``row``."""
        if self._due - CHECKPOINT_PERIOD * NANOSECONDS <= stamp < self._due:
            return
        self._due = stamp + round(CHECKPOINT_PERIOD * NANOSECONDS)
        slot = self._slots[self._next]
        self._next = (self._next + 1) % len(self._slots)
        captured = {name: (stage, stage.capture(slot[name])) for name, stage in self._log.stages.items()}
        self.ring.append(Checkpoint(stamp, row, self._stack.snapshot, self._log.in_force, captured))

    def start(self, rows: NDArray[np.int64]) -> ReplayStart | None:
        """Oldest checkpoint after which no row (n,) is missing; None if there is none."""
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


def memory_to_plain(memory: StackSnapshot) -> dict[str, Any]:
    """Convert the state of a stack to plain values for JSON; exact."""
    feet = [[each.active, each.wrench.tolist()] for each in memory.state.contacts]
    fields: dict[str, Any] = memory._asdict()
    calibration = None if memory.correction is None else plain(memory.correction)
    return fields | {
        "state": plain(memory.state) | {"contacts": feet},
        "mode": memory.mode.value,
        "correction": calibration,
    }


_MODES = {mode: index for index, mode in enumerate(Mode)}
_STATUSES = {status: index for index, status in enumerate(SolveStatus)}

#: Arrays that are NaN for a tick without a result
_RESULTS = ("command_q", "command_v", "command_tau", "planned_wrenches", "dcm", "zmp", "residual")
_EVENTS = 256  #: Largest number of events in memory


@schema(frozen=True, slots=True, config=STRICT)
class BlackBoxConfig:
    """Schema of ``controllers/config/black_box.yaml``."""

    duration: Annotated[float, Field(gt=0, le=120)]  #: Recorded time before a fault [s]
    after: Annotated[float, Field(ge=0, le=10)]  #: Recorded time after a fault [s]
    period: Annotated[float, Field(ge=1e-4, le=1)]  #: Least time between two rows [s]
    keep: Annotated[int, Field(ge=1, le=1000)]  #: Number of newest files of a robot that are kept [1]
    folder: str  #: Folder of the files; empty for the user's state folder


class BlackBox:
    """Ring buffer of ``duration + after`` seconds. A record can be replayed if ``stack`` logs its inputs."""

    def __init__(
        self, model: RobotModel, config: BlackBoxConfig | None = None, stack: ControlStack | None = None
    ) -> None:
        self.config = config or default_config(BlackBoxConfig, "controllers", "black_box")
        self._model = model
        self._rows = round((self.config.duration + self.config.after) / self.config.period)
        nq, nv, nj = model.nq, model.nv, model.nj
        single, double = np.float32, np.float64  # inputs and outputs of the laws are stored exactly
        kinds: dict[str, tuple[Any, ...]] = {
            "t": (double,), "sample_t": (double,), "stamp": (np.int64,), "number": (np.int64,),
            "q": (single, nq), "v": (single, nv),
            "joint_q": (double, nj), "joint_v": (double, nj), "joint_tau": (double, nj),
            "gyro": (double, 3), "accel": (double, 3), "wrenches": (double, 2, 6),
            "command_q": (double, nj), "command_v": (double, nj), "command_tau": (double, nj),
            "planned_wrenches": (single, 2, 6), "dcm": (single, 2), "zmp": (single, 2), "residual": (single,),
            "mode": (np.int8,), "status": (np.int8,),
        }  # fmt: skip
        #: Arrays by their name in the record; filled here, so that no page fault occurs in a tick
        self._columns: dict[str, NDArray[Any]] = {
            name: np.full((self._rows, *shape), np.nan if issubclass(kind, np.floating) else -1, dtype=kind)
            for name, (kind, *shape) in kinds.items()
        }
        self._events: deque[tuple[float, str]] = deque(maxlen=_EVENTS)
        self._next = self._count = 0
        self._ticks = 0
        self._last = -np.inf
        self._least = 0.5 * self.config.period
        self.sealed = self._added = False  # sealed: no rows are added, and the stamps show the gap
        log, duration = None if stack is None else stack.log, self.config.duration + self.config.after
        self._checkpoints = None if stack is None or log is None else Checkpoints(stack, log, duration)

    def __len__(self) -> int:
        return self._count

    def add(
        self,
        state: RobotState,
        sensors: SensorData | None,
        result: ControlResult | None,
        mode: Mode,
        stamp: int | None = None,
    ) -> None:
        """Store the tick of a stamp [ns] unless sealed or half a period early; ``sensors`` default to the estimate."""
        t = state.t
        if self._checkpoints is not None and not self._count:
            self._checkpoints.prepare()
        self._ticks += t != self._last
        self._added = not self.sealed and abs(t - self._last) >= self._least
        if not self._added:
            return
        i, row = self._next, self._columns
        row["t"][i] = self._last = t
        row["stamp"][i], row["number"][i] = round(t * NANOSECONDS) if stamp is None else stamp, self._ticks
        row["q"][i], row["v"][i], row["mode"][i] = state.q, state.v, _MODES[mode]
        if sensors is not None:
            row["sample_t"][i] = sensors.t
            row["joint_q"][i], row["joint_v"][i], row["joint_tau"][i] = sensors.q, sensors.v, sensors.tau
            row["gyro"][i], row["accel"][i], row["wrenches"][i] = sensors.gyro, sensors.accel, sensors.wrenches
        else:
            row["joint_q"][i], row["joint_v"][i], row["joint_tau"][i] = state.q[7:], state.v[6:], state.tau
            row["gyro"][i] = row["accel"][i] = row["sample_t"][i] = np.nan
            row["wrenches"][i, 0], row["wrenches"][i, 1] = state.contacts[0].wrench, state.contacts[1].wrench
        if result is not None:
            command = result.command
            row["command_q"][i], row["command_v"][i], row["command_tau"][i] = command.q, command.v, command.tau
            row["planned_wrenches"][i], row["dcm"][i], row["zmp"][i] = result.wrenches, result.dcm, result.zmp
            row["residual"][i], row["status"][i] = result.residual, _STATUSES[result.status]
        else:
            for name in _RESULTS:
                row[name][i] = np.nan
            row["status"][i] = -1
        self._next = i + 1 if i + 1 < self._rows else 0
        self._count = min(self._count + 1, self._rows)

    def checkpoint(self) -> None:
        """Take a checkpoint when due; call it after ``add`` in an active tick."""
        if self._checkpoints is None or not self._added:
            return
        last = self._next - 1
        self._checkpoints.tick(int(self._columns["stamp"][last]), int(self._columns["number"][last]))

    def event(self, t: float, text: str) -> None:
        """Add an event at time ``t`` [s]; its text is cut after 200 characters."""
        if not self.sealed:
            self._events.append((t, text[:200]))

    def clear(self) -> None:
        """Clear the ring buffer, at a reset of the robot."""
        self._events.clear()
        self._next = self._count = 0
        self._last = -np.inf
        if self._checkpoints is not None:
            self._checkpoints.clear()

    @property
    def checkpoints(self) -> deque[Checkpoint]:
        """Checkpoints in memory, oldest first."""
        return deque() if self._checkpoints is None else self._checkpoints.ring

    def record(self, reason: str) -> BlackBoxRecord:
        """Copy of the ring buffer, oldest row first."""
        first = self._next if self._count == self._rows else 0
        order = (np.arange(self._count) + first) % self._rows
        arrays: dict[str, Any] = {name: column[order] for name, column in self._columns.items()}
        oldest = arrays["t"].min() if self._count else 0.0
        return BlackBoxRecord(
            robot=self._model.name,
            reason=reason,
            joint_names=self._model.joint_names,
            events=tuple(event for event in self._events if event[0] >= oldest),
            replay=None if self._checkpoints is None else self._checkpoints.start(arrays["number"]),
            **arrays,
        )
