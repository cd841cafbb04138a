"""The benchmarks on uneven ground: their cases, that every bound decides, what of a fall counts for the map."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from benchmarks.core.benchmark import catalogue
from benchmarks.core.harness import Options, Report
from benchmarks.stability import falls, terrain, terrain_map
from models.errors import ConfigError
from models.robot_model import RobotModel
from models.terrain import terrains

CONFIG = terrain._config()
BENCH = catalogue()["terrain"].load()
MAP_BENCH = catalogue()["terrain_map"].load()


def report_of(results: list[dict[str, Any]]) -> Report:
    """Their report, judged by the bounds."""
    return Report("terrain", "g1", 1, BENCH.figures(results), results, True, {})


def good(seeds: int) -> list[dict[str, Any]]:
    """Results of walks that all survived."""
    outcome = {"fell": False, "reason": "", "time": 20.0, "distance": 5.9, "survived": True, "trips": 0}
    return [{**case, **outcome} for case in BENCH.cases(Options("g1", seeds))]


def test_the_issue_s_conditions_have_a_bound_and_known_grounds() -> None:
    assert set(CONFIG.conditions) == {
        "tiles", "slope_up", "slope_down", "slope_across", "friction", "payload", "delay",
    }  # fmt: skip
    assert {condition.terrain for condition in {**CONFIG.conditions, **CONFIG.goals}.values()} <= set(terrains())
    assert terrains()["tiles"].height == 0.03
    assert np.degrees(terrains()["slope_up"].pitch) == pytest.approx(8.0, abs=0.01)


def test_the_cases_are_the_bounded_conditions_or_those_chosen() -> None:
    assert {case["scenario"] for case in BENCH.cases(Options("g1", 2))} == set(CONFIG.conditions)
    assert [case["seed"] for case in BENCH.cases(Options("g1", 2, scenarios=("soft",)))] == [0, 1]
    with pytest.raises(ConfigError, match="unknown scenario 'lava'; known: tiles"):
        BENCH.cases(Options("g1", scenarios=("lava",)))


def test_walks_that_survive_pass() -> None:
    report = report_of(good(2))
    figures = report.figures
    assert BENCH.passed(report) and BENCH.notes(report) == []
    assert figures["survived_tiles"] == figures["total_tiles"] == 2.0


@pytest.mark.parametrize(("failures", "passes"), [(2, True), (3, False)])
@pytest.mark.parametrize("name", list(CONFIG.conditions))
def test_eighteen_of_twenty_decide(name: str, failures: int, passes: bool) -> None:
    results = good(20)
    for case in [case for case in results if case["scenario"] == name][:failures]:
        case.update(survived=False, reason="base tilted")
    report = report_of(results)
    notes = BENCH.notes(report)
    assert BENCH.passed(report) is passes
    assert any(f"{name}: {20 - failures} of 20" in note for note in notes) is not passes
    assert sum("base tilted" in note for note in notes) == failures


def test_each_condition_is_drawn_with_the_limits_of_its_speed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    figures: list[Figure] = []
    monkeypatch.setattr(falls, "saved", lambda figure, file: figures.append(figure) or file)
    outcome = good(1)[0]
    results = [outcome | {"scenario": name} for name in ("tiles", "steep_up_fast")]
    BENCH.plots(report_of(results), tmp_path)
    limits = {line.get_label(): line.get_segments() for line in figures[0].axes[0].collections}  # type: ignore[attr-defined]
    assert [segment[:, 1].tolist() for segment in limits["commanded"]] == [
        pytest.approx([6.0] * 2),
        pytest.approx([8.0] * 2),
    ]
    assert [segment[0, 1] for segment in limits["required"]] == pytest.approx([4.2, 5.6])
    assert [segment[:, 0].tolist() for segment in limits["required"]] == [[-0.5, 0.5], [0.5, 1.5]]
    assert figures[0].axes[0].get_ylabel() == f"distance in {CONFIG.duration:.0f} s [m]"


def test_goals_have_no_bound() -> None:
    results = [{**case, **good(1)[0], "scenario": "slippery", "survived": False} for case in BENCH.cases(Options("g1"))]
    report = report_of(results)
    assert report.figures["survived_slippery"] == 0.0 and BENCH.passed(report)


def test_a_walk_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    """A second is too short to walk the commanded distance from a standstill."""
    config = CONFIG.__class__(**{**{name: getattr(CONFIG, name) for name in CONFIG.__slots__}, "duration": 1.0})
    monkeypatch.setattr(terrain, "_config", lambda: config)
    case = terrain.walk("g1", 0, "payload")
    assert not case["fell"] and not case["survived"] and 0.0 < case["distance"] < 0.21
    assert case["time"] == pytest.approx(1.0) and case["trips"] == 0
    assert len(case["moments"]["t"]) > 100 and case["moments"]["mode"][-1] == "walk"


def map_results(**changed: Any) -> list[dict[str, Any]]:
    """Good ones, but for the second case."""
    outcome = {"fell": False, "time": 12.0, "squares": 1e-5, "mean": 0.0, "known": 1.0, "points": 100}
    outcome |= {"delay": 0.06, "updates": [0.002, 0.003], "patches": 0.08, "depth": 0.003, "lidar": 0.02}
    cases = [{**case, **outcome} for case in MAP_BENCH.cases(Options("g1", 2))]
    cases[1] |= changed
    return cases


def map_report_of(cases: list[dict[str, Any]]) -> Report:
    return Report("terrain_map", "g1", 2, MAP_BENCH.figures(cases), cases, True, {})


@pytest.mark.parametrize(("changed", "passes"), [({}, True), ({"squares": np.nan}, False), ({"squares": 4e-4}, False)])
def test_the_worst_walk_decides(changed: dict[str, float], passes: bool) -> None:
    assert MAP_BENCH.passed(map_report_of(map_results(**changed))) is passes


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
    notes = MAP_BENCH.notes(map_report_of(map_results(**{name: case[name] for name in ("fell", "time")})))
    assert any("compared up to 0.5 s before" in note for note in notes)
