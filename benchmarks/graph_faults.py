"""Faults of processes, topics and host, done to the real graph over DDS: what the robot must do, and what it does.

One graph for all rows; after each the robot is brought back by ``reset_faults`` and ``reset``. Times run from the act
to the message that tells of the reaction, on the monotonic clock: its way here, some milliseconds, counts.
"""

from __future__ import annotations

import os
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from benchmarks.fault_table import draw, report_rows
from benchmarks.graph_rows import GraphRow, config
from benchmarks.harness import Case, LoadMeter, Options, Report, chosen
from benchmarks.nodes.graph_acts import ACTS
from benchmarks.nodes.graph_stage import BACK_TIME, LOOK, GraphStage
from bridge.launch import Graph
from bridge.ros.environment import free_domain
from controllers.supervisor import ACTIVE_MODES
from models.errors import PoiseError
from models.nodes import topics
from models.robot_model import RobotModel

FALLEN = 0.5
"""Part of its height that is left of a robot that has fallen [-]."""


class _Watch:
    """One row on the stage.

    Args:
        stage: The robot.
        row: What is done, and what is expected.
    """

    def __init__(self, stage: GraphStage, row: GraphRow) -> None:
        self._stage, self._row = stage, row
        self._supervisor: set[str] = set()

    def run(self) -> Case:
        """Do it, watch, judge."""
        stage, row = self._stage, self._row
        stage.begin(row)
        height, mode, pids = stage.height, stage.graph.mode, dict(stage.graph.pids)
        stage.words.clear()
        began = time.monotonic()
        for pause in ACTS[row.act](stage):
            self._watch_until(time.monotonic() + pause)
        self._watch_until(began + (row.duration or config().duration))
        fallen = not stage.height > FALLEN * height
        restarted = [name for name, pid in stage.graph.pids.items() if pid != pids[name]]
        ok, seen, at = {"rides": self._rides, "stands": self._stands, "damps": self._damps}[row.expect](mode, began)
        told = "; ".join(sorted(self._supervisor))
        if row.expect == "damps":
            accepted, told = stage.graph.call("mode/stand")
            ok = ok and not accepted
        else:
            ok = ok and not fallen
        ok = ok and (not row.restarted or restarted == [row.restarted])
        return {
            "seen": ("fell, " if fallen and row.expect != "damps" else "") + seen,
            "reason": told[:160],
            "time": at,
            "ok": bool(ok and row.reason in told and (at is None or at <= (row.within or np.inf))),
        }

    def _watch_until(self, end: float) -> None:
        while (left := end - time.monotonic()) > 0.0:
            self._stage.graph.spin(min(LOOK, left))
            self._supervisor.add(self._stage.told.get("/supervisor", ""))

    def _heard(self, topic: str) -> list[tuple[float, str]]:
        return [(at, word) for at, of, word in self._stage.words if of == topic]

    def _rides(self, mode: str, began: float) -> tuple[bool, str, float | None]:
        modes, drivers = self._heard(topics.MODE), self._heard(topics.DRIVER_STATE)
        words = [word for _, word in (*modes, *drivers)]
        return not set(words) - {mode, topics.ACTIVE}, f"{mode}; heard: {', '.join(words) or 'nothing else'}", None

    def _stands(self, mode: str, began: float) -> tuple[bool, str, float | None]:
        stage = self._stage
        damped = {word for _, word in self._heard(topics.DRIVER_STATE)} - {topics.ACTIVE}
        at = float("nan") if stage.still_since is None else stage.still_since - began
        return not damped and stage.graph.mode == (self._row.mode or "stand"), f"at rest in {stage.graph.mode}", at

    def _damps(self, mode: str, began: float) -> tuple[bool, str, float | None]:
        told = {topics.MODE: "damp", topics.DRIVER_STATE: topics.DAMPED}
        at = next((at - began for at, of, word in self._stage.words if told.get(of) == word), float("nan"))
        graph = self._stage.graph
        rests = graph.driver_state != topics.ACTIVE and graph.mode not in {active.value for active in ACTIVE_MODES}
        return rests, f"mode {graph.mode}, drivers {graph.driver_state}", at


def run(options: Options) -> Report:
    """Do every row, or those chosen, once a seed.

    Args:
        options: Robot, seeds and rows.

    Raises:
        ConfigError: A chosen row is unknown.
        PoiseError: The graph does not come up.
    """
    rows = chosen("graph_faults", options.scenarios, list(config().rows))
    load, model = LoadMeter(), RobotModel.load(options.robot)
    results: list[Case] = []
    with tempfile.TemporaryDirectory(prefix="poise_faults_") as folder:
        for seed in range(options.seeds):
            results += _with_seed(model, options.robot, seed, rows, Path(folder))
    return report_rows("graph_faults", options, results, load)


def _with_seed(model: RobotModel, robot: str, seed: int, rows: list[str], folder: Path) -> list[Case]:
    results: list[Case] = []
    left = list(rows)
    while left:  # a new graph where a row has left one that cannot be brought back
        os.environ["ROS_LOG_DIR"] = str(folder)
        with ExitStack() as stack:
            parameters = {"mujoco_bridge": {"seed": seed}}
            graph = Graph(robot, domain_id=free_domain(), parameters=parameters, log=folder / "log", say=lambda _: None)
            stage = GraphStage(model, stack.enter_context(graph))
            stack.callback(stage.close)
            graph.wait_standing(BACK_TIME)
            try:
                while left:
                    name = left.pop(0)
                    row = config().rows[name]
                    case = {"row": name, "seed": seed, "group": row.group, "expected": row.expect, "within": row.within}
                    results.append(case | _Watch(stage, row).run())
                    stage.bring_back()
            except PoiseError as error:
                if not results or results[-1]["row"] != name:
                    results.append(case | {"seen": "lost", "reason": str(error)[:160], "time": None, "ok": False})
    return results


def plot(report: Report, folder: Path) -> list[Path]:
    """Draw the time that each reaction took, beside its limit; see ``fault_table.draw``."""
    return draw(report, folder)
