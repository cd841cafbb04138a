"""Black box: the last seconds of all signals of the control process, in a ring that is filled at every tick.

``add`` copies one tick into arrays whose pages were touched before: no allocation, no I/O, some 7 us. After a fault
``seal`` stops the filling, ``write`` may then run in another thread, and ``unseal`` resumes. Between them ``add`` does
nothing, so the two never touch the same row.
"""

from collections import deque
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from controllers.recording.black_box_file import BlackBoxRecord
from controllers.recording.checkpoints import Checkpoint, Checkpoints
from controllers.stack import ControlStack
from models.config import STRICT, default_config
from models.constants import NANOSECONDS
from models.robot_model import RobotModel
from models.types import ControlResult, Mode, RobotState, SensorData, SolveStatus

_MODES = {mode: index for index, mode in enumerate(Mode)}
_STATUSES = {status: index for index, status in enumerate(SolveStatus)}

#: Arrays without a value for a tick without a result
_RESULTS = ("command_q", "command_v", "command_tau", "planned_wrenches", "dcm", "zmp", "residual")
_EVENTS = 256  #: Events that are kept


@dataclass(frozen=True, slots=True, config=STRICT)
class BlackBoxConfig:
    """Schema of ``controllers/config/black_box.yaml``."""

    duration: Annotated[float, Field(gt=0, le=120, description="What is kept from before a fault [s]")]
    after: Annotated[float, Field(ge=0, le=10, description="What is kept from after a fault [s]")]
    period: Annotated[float, Field(ge=1e-4, le=1, description="Least time between two rows [s]")]
    keep: Annotated[int, Field(ge=1, le=1000, description="Newest files of a robot that are kept [1]")]
    folder: Annotated[str, Field(description="Folder of the files; empty for the user's state folder")]


class BlackBox:
    """Ring of the last ``duration + after`` seconds.

    With a ``stack`` that logs its inputs, the record can be run again. ``config`` is the packaged one when None.
    """

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
        self._sealed = self._added = False
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
        """Store one tick, unless the ring is sealed or the last row is less than half a period away.

        The stamp of the row is that of the estimate; without ``sensors``, joints and torques are its, too. ``stamp`` is
        that of the tick [ns], of the estimate when None.
        """
        t = state.t
        if self._checkpoints is not None and not self._count:
            self._checkpoints.prepare()
        self._ticks += t != self._last
        self._added = not self._sealed and abs(t - self._last) >= self._least
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
        """Copy the state of the stack when that is due; after ``add``, for a tick with which a law moved the joints.

        A tick that ``add`` left out, such as one that is answered again, is skipped.
        """
        if self._checkpoints is None or not self._added:
            return
        last = self._next - 1
        self._checkpoints.tick(int(self._columns["stamp"][last]), int(self._columns["number"][last]))

    def event(self, t: float, text: str) -> None:
        """Add an event at time t [s]."""
        if not self._sealed:
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

    def seal(self) -> None:
        """Store no more rows until ``unseal``, so that another thread may write."""
        self._sealed = True

    def unseal(self) -> None:
        """Resume; the ring keeps its rows, and the stamps show the gap."""
        self._sealed = False

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

    def write(self, path: Path, reason: str) -> None:
        """Write the ring as a file; see ``BlackBoxRecord.save``. Raises PoiseError when the disk refuses."""
        self.record(reason).save(path)
