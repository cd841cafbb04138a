"""One fault in lockstep, from the start of the robot to the verdict.

``within`` counts from the injection to the mode that is expected. The torque steps are those of the drivers, before a
motor that is at fault makes something else of them.
"""

from __future__ import annotations

import tempfile
from contextlib import suppress
from pathlib import Path

import numpy as np

from benchmarks.commands import demand
from benchmarks.fault_acts import ACTS
from benchmarks.fault_doing import Doing
from benchmarks.fault_robots import robot_of
from benchmarks.fault_rows import Row, config, with_knee
from benchmarks.harness import Case
from benchmarks.torque_steps import TorqueSteps
from bridge.closed_loop import ClosedLoop
from bridge.fault_plan import Fault
from bridge.sensor_errors import SensorErrors
from models.errors import PoiseError
from models.types import Mode

BOX_TIME = 1.0
"""Watched longer where a black box must be left, which is written a little after the fault [s]."""


class _Trial:
    """One row on one robot.

    Args:
        robot: Name of its profile.
        seed: Of the sensor noise.
        row: What is done, and what is expected.
        folder: For the black box, and for files that are changed.
    """

    def __init__(self, robot: str, seed: int, row: Row, folder: Path) -> None:
        self._model, self._row = robot_of(robot, row.loop, folder), row
        model = self._model
        self.knee = model.joint_names[model.feet[0].joint_ids_v[3] - 6]
        errors = None if row.loop.misalignment is None else SensorErrors(misalignment=row.loop.misalignment)
        self._loop = ClosedLoop(
            model,
            seed=seed,
            friction=row.loop.friction,
            payload_kg=row.loop.payload_kg,
            terrain=row.loop.terrain,
            sensor_errors=errors,
            obstacle_stop=row.loop.obstacle_stop,
            record=False,
            black_box=folder if row.box else None,
        )
        self._steps, self._answer = TorqueSteps(self._loop), ""
        self._modes: list[tuple[float, Mode]] = []

    def run(self) -> Case:
        """Settle, inject, watch."""
        given, loop, row = config(), self._loop, self._row
        if row.walk:
            demand(loop, "walk")
            loop.set_velocity(given.forward, 0.0, 0.0)
        loop.run(given.settle)
        before = loop.mode
        doing: Doing = iter(())
        start = loop.t
        with self._steps.watch():
            if row.faults:
                loop.inject([Fault(**item) for item in with_knee(row.faults, self.knee)])
            if row.act:
                doing = ACTS[row.act](loop)
            for _ in range(round((row.duration or given.duration) / loop.plant.period)):
                with suppress(StopIteration):
                    reply = next(doing)
                    if reply is not None and not reply.accepted:
                        self._answer = reply.reason
                loop.step()
                if not self._modes or loop.mode is not self._modes[-1][1]:
                    self._modes.append((loop.t - start, loop.mode))
        if row.box:
            loop.run(BOX_TIME)
        return self._outcome(before)

    def _outcome(self, before: Mode) -> Case:
        loop, row = self._loop, self._row
        told = "; ".join((*loop.faults, *filter(None, [self._answer])))
        wanted = Mode(row.mode) if row.mode else {"damps": Mode.DAMP, "stands": Mode.STAND}.get(row.expect, before)
        time = next((t for t, mode in self._modes if mode is wanted), float("nan"))
        as_wanted = loop.mode is wanted and with_knee(row.reason, self.knee) in told
        if row.expect == "damps":
            ok = as_wanted and bool(loop.faults) and time <= (row.within or np.inf)
        elif row.expect == "stands":
            ok = as_wanted and not told and not loop.fallen and time <= (row.within or np.inf)
        else:
            ok = as_wanted and not loop.faults and not loop.fallen and bool(self._answer) == (row.expect == "refuses")
        left = not row.box or bool(loop.black_box and loop.black_box.files)
        fine = self._steps.within(config().torque_step_limit)
        return {
            "seen": ("fell, " if loop.fallen and row.expect == "rides" else "") + f"mode '{loop.mode.value}'",
            "reason": told[:160],
            "time": time if row.expect in ("damps", "stands") else None,
            "torque_step": self._steps.largest,
            "ok": bool(ok and left and fine),
        }


def trial(robot: str, seed: int, given: Row) -> Case:
    """Do one row.

    Args:
        robot: Name of a profile.
        seed: Of the sensor noise.
        given: The row.

    Returns:
        ``seen``, the ``reason`` told, ``time`` until the expected mode [s], ``torque_step`` in parts of the drivers'
        rate limit [-], and ``ok``.
    """
    with tempfile.TemporaryDirectory(prefix="poise_faults_") as folder:
        try:
            outcome = _Trial(robot, seed, given, Path(folder)).run()
        except PoiseError as error:
            refused = given.expect == "refuses" and given.reason in str(error)
            outcome = {"seen": "refused", "reason": str(error)[:160], "time": None, "torque_step": 0.0, "ok": refused}
    return {"group": given.group, "expected": given.expect, "within": given.within, **outcome}
