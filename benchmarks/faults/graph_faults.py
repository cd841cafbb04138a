"""Faults of processes, topics and host in a real graph over DDS; all rows of one kind share a graph.

Times are on the monotonic clock, from the act to the message with the reaction, including transport.
"""

import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from benchmarks.core.executors import Clock, Done
from benchmarks.core.fault_rows import FaultBenchmark
from benchmarks.core.harness import Case, LoadMeter, Options, Report, chosen, collect
from benchmarks.core.machine import Unavailable
from benchmarks.core.results import NOT_RUN
from benchmarks.graph.graph_acts import ACTS
from benchmarks.graph.graph_kinds import BACK_TIME, LOOK, GraphRow, GraphStage, Kind, config, graph_of
from controllers.safety.supervisor import ACTIVE_MODES
from models.errors import PoiseError
from models.nodes import topics
from models.robot_model import RobotModel

REASON_MAX = 300  # maximum length of a reason in the report [characters]
FALLEN = 0.5  # fraction of the height below which a robot counts as fallen [-]


class _Watch:
    def __init__(self, stage: GraphStage, row: GraphRow) -> None:
        self._stage, self._row = stage, row
        self._supervisor: set[str] = set()
        self._before = 0, 0, 0

    def run(self) -> Case:
        """Perform the act, observe and judge."""
        stage, row = self._stage, self._row
        stage.begin(row)
        height, mode, pids = stage.height, stage.graph.mode, dict(stage.graph.pids)
        stage.messages.clear()
        self._before = len(stage.refusals), len(stage.silences), len(stage.made.lines)
        began = time.monotonic()
        for pause in ACTS[row.act](stage):
            self._watch_until(time.monotonic() + pause)
        self._watch_until(began + (row.duration or config().duration))
        fallen = not stage.height > FALLEN * height
        restarted = [name for name, pid in stage.graph.pids.items() if pid != pids[name]]
        ok, seen, at = {"rides": self._rides, "stands": self._stands, "damps": self._damps}[row.expect](mode, began)
        reasons = "; ".join([*sorted(self._supervisor), *dict.fromkeys(stage.refusals[self._before[0] :])])
        if row.expect == "damps":
            accepted, answer = stage.ask("mode/stand")
            ok, reasons = ok and not accepted, f"{answer}; {reasons}"
        else:
            ok = ok and not fallen
        ok = ok and (not row.restarted or restarted == [row.restarted])
        ok = ok and any(row.launcher_output in line for line in (*stage.made.lines[self._before[2] :], ""))
        silence = next(iter(stage.silences[self._before[1] :]), None)
        return {
            "silence": silence,
            "seen": ("fell, " if fallen and row.expect != "damps" else "") + seen,
            "reason": reasons[:REASON_MAX],
            "time": at,
            "ok": bool(
                ok
                and row.reason in reasons
                and (at is None or at <= (row.within or np.inf))
                and (row.silence is None or (silence is not None and silence <= row.silence))
            ),
        }

    def _watch_until(self, end: float) -> None:
        while (left := end - time.monotonic()) > 0.0:
            self._stage.graph.spin(min(LOOK, left))
            self._supervisor.add(self._stage.diagnostics.get("/supervisor", ""))

    def _received(self, topic: str) -> list[tuple[float, str]]:
        return [(at, text) for at, of, text in self._stage.messages if of == topic]

    def _rides(self, mode: str, began: float) -> tuple[bool, str, float | None]:
        modes, drivers = self._received(topics.MODE), self._received(topics.DRIVER_STATE)
        texts = [text for _, text in (*modes, *drivers)]
        return not set(texts) - {mode, topics.ACTIVE}, f"{mode}; received: {', '.join(texts) or 'nothing else'}", None

    def _stands(self, mode: str, began: float) -> tuple[bool, str, float | None]:
        stage = self._stage
        damped = {text for _, text in self._received(topics.DRIVER_STATE)} - {topics.ACTIVE}
        at = float("nan") if stage.still_since is None else max(stage.still_since - began, 0.0)
        seen = f"at rest in {stage.graph.mode}"
        if foot := self._foot_in_the_air():
            return False, f"{seen}; left mode walk in '{foot}'", at
        return not damped and stage.graph.mode == (self._row.mode or "stand"), seen, at

    def _foot_in_the_air(self) -> str:
        """Return the gait phase at the end of mode walk if a foot was in the air; otherwise empty."""
        phase = ""
        for _, topic, text in self._stage.messages:
            if topic == topics.GAIT_PHASE:
                phase = text
            elif topic == topics.MODE and text == "stand" and phase.startswith("single"):
                return phase
        return ""

    def _damps(self, mode: str, began: float) -> tuple[bool, str, float | None]:
        damped = {topics.MODE: "damp", topics.DRIVER_STATE: topics.DAMPED}
        at = next((at - began for at, of, text in self._stage.messages if damped.get(of) == text), float("nan"))
        graph = self._stage.graph
        rests = graph.driver_state != topics.ACTIVE and graph.mode not in {active.value for active in ACTIVE_MODES}
        return rests, f"mode {graph.mode}, drivers {graph.driver_state}", at


def _with_seed(model: RobotModel, robot: str, seed: int, rows: list[str], folder: Path) -> Iterator[Case]:
    for kind in dict.fromkeys(config().rows[name].graph for name in rows):
        left = [name for name in rows if config().rows[name].graph == kind]
        while left:  # new graph after a row whose graph could not be restored
            yield from _on_graph(model, kind, robot, seed, left, folder)


def _on_graph(model: RobotModel, kind: Kind, robot: str, seed: int, left: list[str], folder: Path) -> Iterator[Case]:
    """Run rows on one graph and remove them from ``left``, as long as the graph can be restored."""
    name, done = "", ""
    try:
        with ExitStack() as stack:
            made = stack.enter_context(graph_of(kind, robot, seed, folder))
            stage = GraphStage(model, made)
            stack.callback(stage.observer.close)
            made.graph.wait_standing(BACK_TIME)
            while left:
                name = left.pop(0)
                case = _case(name, seed) | _Watch(stage, config().rows[name]).run()
                done = name
                yield case
                stage.bring_back()
    except Unavailable as error:
        yield from (_case(other, seed) | _without(f"not run: {error}") | {NOT_RUN: True} for other in left)
        left.clear()
    except PoiseError as error:
        name = name or left.pop(0)
        if done != name:
            yield _case(name, seed) | _without("lost") | {"reason": str(error)[:REASON_MAX]}


def _case(name: str, seed: int) -> Case:
    row = config().rows[name]
    given = {"row": name, "seed": seed, "group": row.group, "graph": row.graph}
    return given | {"expected": row.expect, "within": row.within}


def _without(seen: str) -> Case:
    return {"seen": seen, "reason": "", "time": None, "ok": False}


class GraphFaults(FaultBenchmark):
    """All rows, or the selected ones, once per seed; rows of one kind share a graph."""

    def cases(self, options: Options) -> list[Case]:
        rows = chosen("graph_faults", options.scenarios, list(config().rows))
        return [{"robot": options.robot, "row": row, "seed": seed} for seed in options.each_seed() for row in rows]

    def run(self, options: Options) -> Report:
        inputs = self.cases(options)
        load, model = LoadMeter(), RobotModel.load(options.robot)
        with tempfile.TemporaryDirectory(prefix="poise_faults_") as folder:

            def produce(left: Sequence[Case]) -> Iterator[tuple[int, Done]]:
                if left:
                    options.sweep.stop_workers()
                places = {(case["seed"], case["row"]): index for index, case in enumerate(left)}
                for seed in options.each_seed():
                    rows = [case["row"] for case in left if case["seed"] == seed]
                    clock = Clock()
                    for case in _with_seed(model, options.robot, seed, rows, Path(folder)):
                        yield places[seed, case["row"]], clock.done(case)
                        clock = Clock()

            results = collect(produce, inputs, bench=self.name, options=options, alone=True)
        return self.report(options, results, self.figures(results), load)
