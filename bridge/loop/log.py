"""Records of a closed loop: a log with one row for each sample, and a black box that is written after a fault."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bridge.loop.lockstep import Lockstep
from bridge.record.recording import Recording
from controllers.recording.black_box import BlackBox
from controllers.recording.black_box_file import BlackBoxFolder
from controllers.safety.supervisor import ACTIVE_MODES
from controllers.stack import ControlStack
from models.errors import ConfigError, PoiseError
from models.robot_model import RobotModel
from models.types import ControlResult, Matrix, Mode, RobotState, SolveStatus, Vector
from planners.gait.planner import GaitPlanner
from planners.gait.state import GaitPhase

if TYPE_CHECKING:
    from bridge.loop.recorder import LoopRecorder

_FIRST_ROWS = 1024
_STATUS = tuple(SolveStatus)
_MODES = tuple(Mode)


class LoopLog:
    """Samples of a run; vector columns such as ``log.com`` are (n, width) views, scalars such as ``log.t`` are (n,).

    Columns: ``t`` [s]; ``com`` (3), ``dcm`` (2), ``zmp`` (2) [m] as estimated and commanded by the controller;
    ``true_com`` (3) [m], ``true_q`` (nq), ``true_v`` (nv) in Pinocchio order; ``estimate_q`` (nq), ``estimate_v``
    (nv); applied torques ``tau`` (nj) [N.m]; ``wrenches`` (12), the true ground reactions, left then right, each in the
    sole frame [N, N.m]; ``planned_wrenches`` (12), the same from the QP; ``footholds`` (4), x and y of both soles as
    planned by the gait, in the frame of the estimate [m]; ``swing``, the planned swing foot (0 left, 1 right, -1 none);
    ``residual`` [1]; ``solve_time`` [s], the only column that differs between two runs with one seed; ``status`` and
    ``mode`` as indices, see ``statuses`` and ``modes``.
    """

    def __init__(self, model: RobotModel) -> None:
        widths = {
            "t": 1,
            "com": 3,
            "dcm": 2,
            "zmp": 2,
            "true_com": 3,
            "true_q": model.nq,
            "true_v": model.nv,
            "estimate_q": model.nq,
            "estimate_v": model.nv,
            "tau": model.nj,
            "wrenches": 12,
            "planned_wrenches": 12,
            "footholds": 4,
            "swing": 1,
            "residual": 1,
            "solve_time": 1,
            "status": 1,
            "mode": 1,
        }
        edges = np.cumsum([0, *widths.values()]).tolist()
        self._columns = {name: slice(*edges[i : i + 2]) for i, name in enumerate(widths)}
        self._robot = model.name
        self._rows = np.zeros((_FIRST_ROWS, edges[-1]))
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def __getattr__(self, name: str) -> Matrix:
        columns = self.__dict__.get("_columns", {})
        if name not in columns:
            raise AttributeError(f"the log has no column '{name}'; known: {', '.join(columns)}")
        values: Matrix = self._rows[: self._count, columns[name]]
        return values[:, 0] if values.shape[1] == 1 else values

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns."""
        return tuple(self._columns)

    @property
    def statuses(self) -> list[SolveStatus]:
        """Solver status of each row's command."""
        return [_STATUS[int(i)] for i in self.status]

    @property
    def modes(self) -> list[Mode]:
        """Mode of each row."""
        return [_MODES[int(i)] for i in self.mode]

    def clear(self) -> None:
        """Drop all rows."""
        self._count = 0

    def add(
        self,
        truth: RobotState,
        true_com: Vector,
        estimate: RobotState,
        result: ControlResult,
        mode: Mode,
        gait: GaitPlanner,
    ) -> None:
        """Append a row."""
        row, at = self.add_truth(truth, true_com), self._columns
        row[at["com"]] = result.com
        row[at["dcm"]] = result.dcm
        row[at["zmp"]] = result.zmp
        row[at["estimate_q"]] = estimate.q
        row[at["estimate_v"]] = estimate.v
        row[at["planned_wrenches"]] = result.wrenches.ravel()
        row[at["footholds"]] = [place for hold in gait.footholds for place in (hold.x, hold.y)]
        row[at["swing"]] = 1 - gait.stance if gait.phase is GaitPhase.SINGLE else -1
        row[at["residual"]] = result.residual
        row[at["solve_time"]] = result.solve_time
        row[at["status"]] = _STATUS.index(result.status)
        row[at["mode"]] = _MODES.index(mode)

    def add_truth(self, truth: RobotState, true_com: Vector) -> Vector:
        """Append a row with true values only, and return it."""
        if self._count == len(self._rows):
            self._rows = np.concatenate([self._rows, np.zeros_like(self._rows)])
        row: Vector = self._rows[self._count]
        at = self._columns
        row[at["t"]] = truth.t
        row[at["true_com"]] = true_com
        row[at["true_q"]] = truth.q
        row[at["true_v"]] = truth.v
        row[at["tau"]] = truth.tau
        wrenches = row[at["wrenches"]]
        wrenches[:6], wrenches[6:] = truth.contacts[0].wrench, truth.contacts[1].wrench
        self._count += 1
        return row

    def recording(self, events: Iterable[tuple[float, str]] = ()) -> Recording:
        """The true states as a ``Recording``, for plots, pictures and the stability report."""
        t, q, v, tau = (values.copy() for values in (self.t, self.true_q, self.true_v, self.tau))
        return Recording(self._robot, t, q, v, tau, self.wrenches.reshape(-1, 2, 6).copy(), tuple(events))


class LoopBlackBox:
    """Writes the ring buffer ``box`` and the ``events`` to a new file when a fault ends an active mode."""

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
        pending = stack.log is not None and stack.log.pending  # inputs since the tick; the next note contains them
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


def make_recorder(robot: RobotModel, path: Path, *, replayable: bool) -> LoopRecorder:
    """Recorder of a loop; ``ConfigError`` unless the run can be replayed, ``PoiseError`` without messages of ROS 2."""
    if not replayable:
        raise ConfigError("mcap: a replay needs estimate='sensors' and no other controller")
    try:
        from bridge.loop.recorder import LoopRecorder
    except ImportError as error:
        raise PoiseError(f"mcap: the messages of ROS 2 cannot be imported: {error}") from error
    return LoopRecorder(robot, path)
