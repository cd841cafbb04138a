"""Rows of ``poise bench graph_faults``: acts and rows belong together, and a row that goes wrong says so."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock, patch

import pytest

from benchmarks.core.benchmark import catalogue
from benchmarks.core.harness import Case, Options, Sweep
from benchmarks.core.machine import Unavailable
from benchmarks.core.results import ResultsFile
from benchmarks.faults import graph_faults
from benchmarks.graph.graph_acts import ACTS
from benchmarks.graph.graph_kinds import GraphRow, config
from models.errors import ConfigError, PoiseError
from models.nodes import topics

pytestmark = pytest.mark.ros

Text = tuple[str, str]

NAMES = {topics.MODE: "mode", topics.DRIVER_STATE: "driver_state"}

DAMPED: list[Text] = [(topics.DRIVER_STATE, topics.DAMPED), (topics.MODE, "damp")]

BENCH = catalogue()["graph_faults"].load()


class FakeStage:
    """A robot of which the given texts are received after the act."""

    def __init__(self, texts: list[Text], *, rest: bool = True, height: float = 0.8, restarted: bool = False) -> None:
        self.messages: list[tuple[float, str, str]] = []
        self.diagnostics = {"/supervisor": "mode 'stand'"}
        self.refusals: list[str] = []
        self.silences: list[float] = []
        self.made = SimpleNamespace(lines=[])
        self.still_since: float | None = None
        self.height = 0.8
        self.graph = SimpleNamespace(mode="stand", driver_state=topics.ACTIVE, pids={"a": 1, "b": 2}, spin=time.sleep)
        self._after = texts, rest, height, restarted

    def begin(self, row: GraphRow) -> None:
        """It stands."""

    def act(self, stage: Any) -> Iterator[float]:
        """What follows happens at once."""
        texts, rest, self.height, restarted = self._after
        for topic, text in texts:
            self.messages.append((time.monotonic(), topic, text))
            if topic in NAMES:
                setattr(self.graph, NAMES[topic], text)
        self.still_since = time.monotonic() if rest else None
        self.graph.pids = {"a": 1, "b": 3 if restarted else 2}
        self.refusals.append("joint_states: 'knee' is missing")
        self.silences.append(0.041)
        self.made.lines.append("b ended with code 1: restart 1 of 5")
        yield 0.01

    def ask(self, service: str) -> tuple[bool, str]:
        return self.graph.mode != "damp", "latched faults"


def judged(stage: FakeStage, **row: Any) -> Any:
    given = GraphRow(group="g", act="fake", duration=0.02, **row)
    with patch.dict(ACTS, fake=stage.act):
        return graph_faults._Watch(stage, given).run()  # type: ignore[arg-type]


def test_every_act_is_of_a_row_and_every_row_has_its_act() -> None:
    assert {row.act for row in config().rows.values()} == set(ACTS)


def test_an_unknown_row_is_refused_with_those_there_are() -> None:
    with pytest.raises(ConfigError, match="unknown scenario 'meteor'; known: control_killed"):
        BENCH.run(Options(scenarios=("meteor",)))


@pytest.mark.parametrize(
    ("stage", "row", "ok"),
    [
        (lambda: FakeStage([]), {"expect": "rides"}, True),
        (lambda: FakeStage([(topics.MODE, "damp"), (topics.MODE, "stand")]), {"expect": "rides"}, False),
        (lambda: FakeStage([], height=0.3), {"expect": "rides"}, False),
        (lambda: FakeStage([]), {"expect": "rides", "restarted": "b"}, False),
        (lambda: FakeStage([], restarted=True), {"expect": "rides", "restarted": "b"}, True),
        (lambda: FakeStage([]), {"expect": "rides", "reason": "second publisher"}, False),
        (lambda: FakeStage([]), {"expect": "rides", "reason": "'knee' is missing"}, True),
        (lambda: FakeStage([]), {"expect": "rides", "launcher_output": "ended with code 1"}, True),
        (lambda: FakeStage([]), {"expect": "rides", "launcher_output": "ended with code 0"}, False),
        (lambda: FakeStage(DAMPED), {"expect": "damps", "silence": 0.0415}, True),
        (lambda: FakeStage(DAMPED), {"expect": "damps", "silence": 0.0405}, False),
        (lambda: FakeStage([(topics.MODE, "stand")]), {"expect": "stands", "within": 1.0}, True),
        (lambda: FakeStage([(topics.GAIT_PHASE, "settled"), (topics.MODE, "stand")]), {"expect": "stands"}, True),
        (lambda: FakeStage([(topics.GAIT_PHASE, "single left"), (topics.MODE, "stand")]), {"expect": "stands"}, False),
        (lambda: FakeStage([(topics.MODE, "walk")]), {"expect": "stands", "within": 1.0}, False),
        (lambda: FakeStage([], rest=False), {"expect": "stands", "within": 1.0}, False),
        (lambda: FakeStage(DAMPED), {"expect": "damps", "within": 1.0, "reason": "latched"}, True),
        (lambda: FakeStage(DAMPED), {"expect": "damps", "within": 1e-9, "reason": "latched"}, False),
        (lambda: FakeStage([*DAMPED, (topics.MODE, "stand")]), {"expect": "damps", "within": 1.0}, False),
        (lambda: FakeStage([]), {"expect": "damps", "within": 1.0}, False),
    ],
)
def test_rows_are_judged(stage: Callable[[], FakeStage], row: dict[str, Any], ok: bool) -> None:
    assert judged(stage(), **row)["ok"] is ok


def test_a_row_whose_graph_cannot_be_made_here_is_reported_as_not_run() -> None:
    def lacking(*arguments: object) -> Any:
        raise Unavailable("libfaketime is not installed")

    with patch.object(graph_faults, "graph_of", lacking):
        report = BENCH.run(Options(scenarios=("wall_clock_ahead", "wall_clock_back")))
    assert report.figures == {"survived": 0.0, "total": 0.0, "not_run": 2.0} and not report.passed
    assert [case["seen"] for case in report.cases] == ["not run: libfaketime is not installed"] * 2


def test_a_graph_that_does_not_come_up_fails_its_rows_one_by_one() -> None:
    def broken(*arguments: object) -> Any:
        raise PoiseError("supervisor ended with code 1 while starting")

    with patch.object(graph_faults, "graph_of", broken):
        report = BENCH.run(Options(scenarios=("planner_killed", "bridge_killed")))
    assert report.figures == {"survived": 0.0, "total": 2.0}
    assert all("ended with code 1" in case["reason"] for case in report.cases)


def test_rows_that_are_finished_are_not_done_again(tmp_path: Path) -> None:
    done: list[str] = []

    def on_graph(model: Any, kind: Any, robot: str, seed: int, left: list[str], folder: Path) -> Iterator[Case]:
        while left:
            done.append(left.pop(0))
            yield graph_faults._case(done[-1], seed) | graph_faults._without("rides")

    workers = Mock()
    with patch.object(graph_faults, "_on_graph", on_graph), ResultsFile(tmp_path / "cases.jsonl") as file:
        sweep = Sweep(workers, file)
        BENCH.run(Options(scenarios=("planner_killed",), sweep=sweep))
        report = BENCH.run(Options(scenarios=("planner_killed", "bridge_killed"), sweep=sweep))
        BENCH.run(Options(scenarios=("planner_killed", "bridge_killed"), sweep=sweep))
    assert done == ["planner_killed", "bridge_killed"]
    assert (
        workers.stop_workers.call_count == 2
    )  # nothing else runs beside a graph, and a rerun without cases ends no worker
    assert [case["row"] for case in report.cases] == done
