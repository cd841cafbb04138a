"""Faults of processes, topics and host, done to the real graph over DDS: what the robot must do, and what it does.

One graph for all rows; after each the robot is brought back by ``reset_faults`` and ``reset``. Times run from the act
to the message that tells of the reaction, on the monotonic clock: its way here, some milliseconds, counts.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections import deque
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import String

from benchmarks.fault_table import draw, report_rows
from benchmarks.graph_acts import ACTS, User
from benchmarks.graph_rows import GraphRow, config
from benchmarks.harness import Case, LoadMeter, Options, Report
from bridge.launch import Graph
from bridge.ros.environment import free_domain
from bridge.ros.observer import Observer
from models.errors import ConfigError, PoiseError
from models.nodes import topics
from models.nodes.qos import EVENT, LATCHED
from models.robot_model import RobotModel
from models.types import Vector

LOOK = 0.02
"""Between two looks at the robot [s]."""

SPEED_TIME = 0.5
"""Over which its speed is taken [s]."""

BACK_TIME = 90.0
"""Longest wait for the robot to stand or walk again [s]."""

FALLEN = 0.5
"""Part of its height that is left of a robot that has fallen [-]."""


class _Stage:
    """The robot that things are done to, and what is seen of it.

    Args:
        model: The robot.
        graph: The running graph.
    """

    def __init__(self, model: RobotModel, graph: Graph) -> None:
        self.graph, self.user = graph, User(graph)
        self.words: list[tuple[float, str, str]] = []
        self.told: dict[str, str] = {}
        self._observer = Observer(model)
        self._path: deque[tuple[float, Vector]] = deque(maxlen=round(SPEED_TIME / LOOK))
        listen = graph.node.create_subscription
        for topic in (topics.MODE, topics.DRIVER_STATE):
            listen(String, topic, partial(self._hear, topic), LATCHED)
        listen(DiagnosticArray, "/diagnostics", self._on_diagnostics, EVENT)

    @property
    def height(self) -> float:
        """Of the base [m]."""
        return float(self._observer.base_position[2])

    @property
    def speed(self) -> float:
        """Over the last ``SPEED_TIME`` [m/s]."""
        (t0, first), (t1, last) = self._path[0], self._path[-1]
        return float(np.linalg.norm((last - first)[:2]) / max(t1 - t0, LOOK))

    def look(self, duration: float) -> None:
        """Serve the graph for a time [s], the robot in sight."""
        end = time.monotonic() + duration
        while time.monotonic() < end:
            self.graph.spin(LOOK)
            self._observer.poll()
            self._path.append((time.monotonic(), self._observer.base_position))

    def begin(self, row: GraphRow) -> None:
        """Have the robot stand or walk as the row wants it."""
        given = config()
        if row.walk:
            self.graph.send("walk")
            self.graph.wait_for(lambda: self.graph.mode == "walk", BACK_TIME, "walking")
            self.user.walk(given.forward)
        self.look(given.settle + (SPEED_TIME if row.walk else 0.0))

    def bring_back(self) -> None:
        """Have it stand where it began, without faults."""
        self.user.walk(None)
        self.graph.call("reset_faults")
        self.graph.call("reset")
        self.graph.wait_standing(BACK_TIME)

    def close(self) -> None:
        """Look no more."""
        self._observer.close()

    def _hear(self, topic: str, message: String) -> None:
        self.words.append((time.monotonic(), topic, message.data))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.told |= {status.name: status.message for status in message.status}


class _Watch:
    """One row on the stage.

    Args:
        stage: The robot.
        row: What is done, and what is expected.
    """

    def __init__(self, stage: _Stage, row: GraphRow) -> None:
        self._stage, self._row = stage, row
        self._supervisor: set[str] = set()
        self._still_at = float("nan")

    def run(self) -> Case:
        """Do it, watch, judge."""
        stage, row = self._stage, self._row
        stage.begin(row)
        height, mode, pids = stage.height, stage.graph.mode, dict(stage.graph.pids)
        stage.words.clear()
        began = time.monotonic()
        for pause in ACTS[row.act](stage):
            self._look_until(time.monotonic() + pause, began)
        self._look_until(began + (row.duration or config().duration), began)
        fallen = not stage.height > FALLEN * height
        restarted = [name for name, pid in stage.graph.pids.items() if pid != pids[name]]
        ok, seen, at = {"rides": self._rides, "stands": self._stands, "damps": self._damps}[row.expect](mode, began)
        told = "; ".join(sorted(self._supervisor))
        if row.expect == "damps":
            accepted, told = stage.graph.call("mode/stand")
            ok = ok and not accepted
        else:
            ok = ok and not fallen and (not row.restarted or restarted == [row.restarted])
        return {
            "seen": ("fell, " if fallen else "") + seen,
            "reason": told[:160],
            "time": at,
            "ok": bool(ok and row.reason in told and (at is None or at <= (row.within or np.inf))),
        }

    def _look_until(self, end: float, began: float) -> None:
        while (left := end - time.monotonic()) > 0.0:
            self._stage.look(min(LOOK, left))
            self._supervisor.add(self._stage.told.get("/supervisor", ""))
            if self._stage.speed > config().still:
                self._still_at = float("nan")
            elif np.isnan(self._still_at):
                self._still_at = time.monotonic() - began

    def _heard(self, topic: str) -> list[tuple[float, str]]:
        return [(at, word) for at, of, word in self._stage.words if of == topic]

    def _rides(self, mode: str, began: float) -> tuple[bool, str, float | None]:
        modes, drivers = self._heard(topics.MODE), self._heard(topics.DRIVER_STATE)
        words = [word for _, word in (*modes, *drivers)]
        return not set(words) - {mode, topics.ACTIVE}, f"{mode}; heard: {', '.join(words) or 'nothing else'}", None

    def _stands(self, mode: str, began: float) -> tuple[bool, str, float | None]:
        damped = {word for _, word in self._heard(topics.DRIVER_STATE)} - {topics.ACTIVE}
        graph, at = self._stage.graph, self._still_at
        return not damped and graph.mode == "stand", f"{graph.mode}, {self._stage.speed:.2f} m/s", at

    def _damps(self, mode: str, began: float) -> tuple[bool, str, float | None]:
        at = next((at - began for at, word in self._heard(topics.DRIVER_STATE) if word == topics.DAMPED), float("nan"))
        told = {topics.MODE: "damp", topics.DRIVER_STATE: topics.DAMPED}
        last = {topic: (self._heard(topic) or [(0.0, "as before")])[-1][1] for topic in told}
        return last == told, f"mode {last[topics.MODE]}, drivers {last[topics.DRIVER_STATE]}", at


def run(options: Options) -> Report:
    """Do every row, or those chosen, once a seed.

    Args:
        options: Robot, seeds and rows.

    Raises:
        ConfigError: A chosen row is unknown.
        PoiseError: The graph does not come up.
    """
    known = config().rows
    unknown = [name for name in options.scenarios if name not in known]
    if unknown:
        raise ConfigError(f"bench graph_faults: unknown scenario '{unknown[0]}'; known: {', '.join(known)}")
    load, model = LoadMeter(), RobotModel.load(options.robot)
    chosen = options.scenarios or tuple(known)
    results: list[Case] = []
    with tempfile.TemporaryDirectory(prefix="poise_faults_") as folder:
        for seed in range(options.seeds):
            results += _with_seed(model, options.robot, seed, chosen, Path(folder))
    return report_rows("graph_faults", options, results, load)


def _with_seed(model: RobotModel, robot: str, seed: int, chosen: tuple[str, ...], folder: Path) -> list[Case]:
    results: list[Case] = []
    left = list(chosen)
    while left:  # a new graph where a row has left one that cannot be brought back
        os.environ["ROS_LOG_DIR"] = str(folder)
        with ExitStack() as stack:
            parameters = {"mujoco_bridge": {"seed": seed}}
            graph = Graph(robot, domain_id=free_domain(), parameters=parameters, log=folder / "log", say=lambda _: None)
            stage = _Stage(model, stack.enter_context(graph))
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
