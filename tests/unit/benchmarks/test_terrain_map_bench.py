"""The benchmark of the map: what of a walk that falls is compared, and that a walk without a comparison fails."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.core.benchmark import catalogue
from benchmarks.core.harness import Options, Report
from benchmarks.stability import terrain_map
from models.robot_model import RobotModel

BENCH = catalogue()["terrain_map"].load()


def results(**changed: Any) -> list[dict[str, Any]]:
    """Good ones, but for the second case."""
    outcome = {"fell": False, "time": 12.0, "squares": 1e-5, "mean": 0.0, "known": 1.0, "points": 100}
    outcome |= {"delay": 0.06, "updates": [0.002, 0.003], "patches": 0.08, "depth": 0.003, "lidar": 0.02}
    cases = [{**case, **outcome} for case in BENCH.cases(Options("g1", 2))]
    cases[1] |= changed
    return cases


def report_of(cases: list[dict[str, Any]]) -> Report:
    return Report("terrain_map", "g1", 2, BENCH.figures(cases), cases, True, {})


@pytest.mark.parametrize(("changed", "passes"), [({}, True), ({"squares": np.nan}, False), ({"squares": 4e-4}, False)])
def test_the_worst_walk_decides(changed: dict[str, float], passes: bool) -> None:
    assert BENCH.passed(report_of(results(**changed))) is passes


def test_a_walk_that_falls_is_compared_until_shortly_before(g1: RobotModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """It falls after 4 s; every comparison has the time as its error."""
    mapper = SimpleNamespace(patches=lambda: [])
    loop = SimpleNamespace(t=0.0, fallen=False, robot=g1, truth=SimpleNamespace(q=None))
    loop.ground_view = SimpleNamespace(mapper=mapper, delays=[0.06], costs={"lidar": [0.001]})

    def run(duration: float) -> None:
        loop.t += duration
        loop.fallen = loop.t > 4.0

    loop.run = run
    monkeypatch.setattr(terrain_map, "ClosedLoop", lambda *_, **__: loop)
    monkeypatch.setattr(terrain_map, "start_walk", lambda *_: None)
    monkeypatch.setattr(terrain_map, "score", lambda *_: np.array([loop.t]))
    monkeypatch.setattr(terrain_map, "cast_costs", lambda *_: {})
    case = terrain_map.measure("g1", 0, "tiles")
    config = terrain_map._config()
    times = np.arange(config.settle, loop.t - config.before_fall, config.period)
    assert case["fell"] and case["points"] == pytest.approx(len(times), abs=1)
    assert case["mean"] == pytest.approx(0.5 * (config.settle + 4.1 - config.before_fall), abs=0.1)
    notes = BENCH.notes(report_of(results(**{name: case[name] for name in ("fell", "time")})))
    assert any("compared up to 0.5 s before" in note for note in notes)
