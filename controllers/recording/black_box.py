"""Black box: the last seconds of all signals of the control process, in a ring that is filled at every tick.

``add`` copies one tick into arrays whose pages were touched before: no allocation, no I/O, some 7 us. While
``sealed``, after a fault, ``add`` does nothing and ``record`` may run in another thread: they never touch the same row.
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

CHECKPOINT_PERIOD = 4.0  #: Time between two checkpoints [s]: one takes as long as half a tick


@dataclass(slots=True)
class Checkpoint:
    """The stack after a tick."""

    stamp: int  # of the tick [ns]
    row: int  # number of its row in the black box
    memory: StackSnapshot  # of the stack
    in_force: dict[str, tuple[object, ...]]  # inputs that held
    stages: dict[str, tuple[LawState, Captured]]  # state of each stage


class Checkpoints:
    """A ring of copies of the state of a stack over a ``duration`` [s], taken after a tick, the oldest first."""

    def __init__(self, stack: ControlStack, log: InputLog, duration: float) -> None:
        self._stack, self._log = stack, log
        count = int(duration / CHECKPOINT_PERIOD) + 2
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
        """Take a checkpoint when due, after a tick of a stamp [ns] and a ``row`` that has moved the joints."""
        if self._due - CHECKPOINT_PERIOD * NANOSECONDS <= stamp < self._due:
            return
        self._due = stamp + round(CHECKPOINT_PERIOD * NANOSECONDS)
        slot = self._slots[self._next]
        self._next = (self._next + 1) % len(self._slots)
        captured = {name: (stage, stage.capture(slot[name])) for name, stage in self._log.stages.items()}
        self.ring.append(Checkpoint(stamp, row, self._stack.snapshot, self._log.in_force, captured))

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


def memory_to_plain(memory: StackSnapshot) -> dict[str, Any]:
    """The memory of a stack for JSON; exact."""
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

#: Arrays without a value for a tick without a result
_RESULTS = ("command_q", "command_v", "command_tau", "planned_wrenches", "dcm", "zmp", "residual")
_EVENTS = 256  #: Events that are kept


@schema(frozen=True, slots=True, config=STRICT)
class BlackBoxConfig:
    """Schema of ``controllers/config/black_box.yaml``."""

    duration: Annotated[float, Field(gt=0, le=120)]  #: What is kept from before a fault [s]
    after: Annotated[float, Field(ge=0, le=10)]  #: What is kept from after a fault [s]
    period: Annotated[float, Field(ge=1e-4, le=1)]  #: Least time between two rows [s]
    keep: Annotated[int, Field(ge=1, le=1000)]  #: Newest files of a robot that are kept [1]
    folder: str  #: Folder of the files; empty for the user's state folder


class BlackBox:
    """Ring of the last ``duration + after`` seconds; with a ``stack`` that logs its inputs, it can be run again."""

    def __init__(
        self, model: RobotModel, config: BlackBoxConfig | None = None, stack: ControlStack | None = None
    ) -> None:
        self.config = config or default_config(BlackBoxConfig, "controllers", "black_box")
        self._model = model
        self._rows = round((self.config.duration + self.config.after) / self.config.period)
        nq, nv, nj = model.nq, model.nv, model.nj
        single, double = np.float32, np.float64  # inputs and outputs of the laws are kept to the last bit
        kinds: dict[str, tuple[Any, ...]] = {
            "t": (double,), "sample_t": (double,), "stamp": (np.int64,), "number": (np.int64,),
            "q": (single, nq), "v": (single, nv),
            "joint_q": (double, nj), "joint_v": (double, nj), "joint_tau": (double, nj),
            "gyro": (double, 3), "accel": (double, 3), "wrenches": (double, 2, 6),
            "command_q": (double, nj), "command_v": (double, nj), "command_tau": (double, nj),
            "planned_wrenches": (single, 2, 6), "dcm": (single, 2), "zmp": (single, 2), "residual": (single,),
            "mode": (np.int8,), "status": (np.int8,),
        }  # fmt: skip
        #: Arrays by their name in the record; written to at once, so that no page is missing when the robot stands
        self._columns: dict[str, NDArray[Any]] = {
            name: np.full((self._rows, *shape), np.nan if issubclass(kind, np.floating) else -1, dtype=kind)
            for name, (kind, *shape) in kinds.items()
        }
        self._events: deque[tuple[float, str]] = deque(maxlen=_EVENTS)
        self._next = self._count = 0
        self._ticks = 0
        self._last = -np.inf
        self._least = 0.5 * self.config.period
        self.sealed = self._added = False  # sealed: rows are kept as they are, and the stamps show the gap
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
        """Store a tick of a stamp [ns], unless sealed or half a period early; without ``sensors`` by the estimate."""
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
        """Copy the state of the stack when that is due, after ``add`` of a tick whose law moved the joints."""
        if self._checkpoints is None or not self._added:
            return
        last = self._next - 1
        self._checkpoints.tick(int(self._columns["stamp"][last]), int(self._columns["number"][last]))

    def event(self, t: float, text: str) -> None:
        """Add an event at time t [s]."""
        if not self.sealed:
            self._events.append((t, text[:200]))

    def clear(self) -> None:
        """Clear the ring; the robot starts over."""
        self._events.clear()
        self._next = self._count = 0
        self._last = -np.inf
        if self._checkpoints is not None:
            self._checkpoints.clear()

    @property
    def checkpoints(self) -> deque[Checkpoint]:
        """States of the laws that are held, the oldest first."""
        return deque() if self._checkpoints is None else self._checkpoints.ring

    def record(self, reason: str) -> BlackBoxRecord:
        """A copy of the ring, the oldest row first."""
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
