"""Log of a closed loop: one row of numbers a sample, in an array that grows."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from bridge.record.recording import Recording
from models.robot_model import RobotModel
from models.types import ControlResult, Matrix, Mode, RobotState, SolveStatus, Vector
from planners.gait.planner import GaitPlanner
from planners.gait.state import GaitPhase

_FIRST_ROWS = 1024
_STATUS = tuple(SolveStatus)
_MODES = tuple(Mode)


class LoopLog:
    """Samples of a run; ``log.com`` and the like are (n, width) views, ``log.t`` and other scalars (n,).

    Columns: ``t`` [s]; ``com`` (3), ``dcm`` (2), ``zmp`` (2) [m] as estimated and commanded by the controller;
    ``true_com`` (3) [m], ``true_q`` (nq), ``true_v`` (nv) in Pinocchio's order; ``estimate_q`` (nq), ``estimate_v``
    (nv); ``tau`` (nj) [N.m] as applied; ``wrenches`` (12) true ground reactions, left then right, each in its sole
    frame [N, N.m]; ``planned_wrenches`` (12) those of the QP; ``footholds`` (4), x and y of both soles as planned by
    the gait, in the frame of the estimate [m]; ``swing``, the planned swing foot (0 left, 1 right, -1 none);
    ``residual`` [1]; ``solve_time`` [s], the one column that differs between two runs of the same seed; ``status`` and
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
        self._columns = {name: slice(edges[i], edges[i + 1]) for i, name in enumerate(widths)}
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
        if self._count == len(self._rows):
            self._rows = np.concatenate([self._rows, np.zeros_like(self._rows)])
        row, at = self._rows[self._count], self._columns
        row[at["t"]] = truth.t
        row[at["com"]] = result.com
        row[at["dcm"]] = result.dcm
        row[at["zmp"]] = result.zmp
        row[at["true_com"]] = true_com
        row[at["true_q"]] = truth.q
        row[at["true_v"]] = truth.v
        row[at["estimate_q"]] = estimate.q
        row[at["estimate_v"]] = estimate.v
        row[at["tau"]] = truth.tau
        wrenches = row[at["wrenches"]]
        wrenches[:6], wrenches[6:] = truth.contacts[0].wrench, truth.contacts[1].wrench
        row[at["planned_wrenches"]] = result.wrenches.ravel()
        row[at["footholds"]] = [place for hold in gait.footholds for place in (hold.x, hold.y)]
        row[at["swing"]] = 1 - gait.stance if gait.phase is GaitPhase.SINGLE else -1
        row[at["residual"]] = result.residual
        row[at["solve_time"]] = result.solve_time
        row[at["status"]] = _STATUS.index(result.status)
        row[at["mode"]] = _MODES.index(mode)
        self._count += 1

    def recording(self, events: Iterable[tuple[float, str]] = ()) -> Recording:
        """The true states as a ``Recording``, for plots, pictures and the stability report."""
        return Recording(
            robot=self._robot,
            t=self.t.copy(),
            q=self.true_q.copy(),
            v=self.true_v.copy(),
            tau=self.tau.copy(),
            wrenches=self.wrenches.reshape(-1, 2, 6).copy(),
            events=tuple(events),
        )
