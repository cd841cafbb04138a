"""The launcher replaces a process without heartbeat, and goes on without an optional one that always crashes."""

import os
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from bridge.launch.graph import RESTARTS_MAX, Graph
from bridge.ros import heartbeat
from bridge.ros.environment import free_domain
from bridge.ros.heartbeat import Heartbeat
from bridge.ros.processes import ProcessSpec

pytestmark = pytest.mark.ros

BEATING = "from bridge.ros.heartbeat import beat\nimport time\nwhile True:\n    beat()\n    time.sleep(0.02)\n"


@pytest.fixture
def said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    for name, text in (("beating", BEATING), ("crashing", "raise SystemExit(3)\n")):
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), *filter(None, sys.path)]))
    return []


@pytest.fixture
def graph(said: list[str], request: pytest.FixtureRequest) -> Iterator[Graph]:
    graph = Graph(specs=[ProcessSpec(*request.param, silence_max=2.0)], say=said.append, domain_id=free_domain())
    graph.open()
    yield graph
    graph.close()


@pytest.mark.long
@pytest.mark.parametrize("graph", [("beating", ())], indirect=True)
def test_a_process_that_is_stopped_is_killed_and_started_again(graph: Graph, said: list[str]) -> None:
    graph.spin(2.5)
    assert not any("killed" in text for text in said)
    first = graph.pids["beating"]
    os.kill(first, signal.SIGSTOP)
    graph.wait_for(lambda: graph.pids["beating"] != first, 20.0, "started again")
    assert said[-3:] == [
        "beating sent no heartbeat for 2 s: killed",
        f"beating ended with code -9: restart 1 of {RESTARTS_MAX}",
        "beating running again",
    ]
    graph.spin(2.5)
    assert said[-1] == "beating running again"


@pytest.mark.parametrize("graph", [("crashing", (), True)], indirect=True)
def test_the_graph_goes_on_without_an_optional_process_that_always_crashes(graph: Graph, said: list[str]) -> None:
    graph.wait_for(lambda: "continues without it" in said[-1], 30.0, "given up")
    graph.spin(0.1)
    assert "crashing" not in graph.pids


def test_time_in_which_the_launcher_itself_was_stopped_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    end = Heartbeat()
    monkeypatch.setenv(heartbeat.VARIABLE, str(end.writer))

    def silent(step: float) -> bool:
        now[0] += step
        return end.silent(1.0)

    assert not silent(0.5)  # it may take long to start
    heartbeat.beat()
    assert not silent(30.0) and not silent(0.4) and not silent(30.0)
    assert silent(0.5)
    heartbeat.beat()
    assert not silent(0.5)
    assert not any(silent(0.4) for _ in range(2)) and silent(0.4)
    os.close(end.writer)
    end.close()
    heartbeat.beat()  # without a launcher
