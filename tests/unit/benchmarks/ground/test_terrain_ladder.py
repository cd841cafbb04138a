"""The ladders: where one ends, what is held, whose seeds judge, and one level that is walked."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.core.benchmark import catalogue
from benchmarks.core.harness import Options, Report
from benchmarks.report.report_survival import draw_ladder_curves
from benchmarks.stability import terrain, terrain_ladder
from benchmarks.stability.stairs import Flight
from benchmarks.stability.terrain import Condition
from benchmarks.stability.terrain_ladder import TerrainLadder, ascend
from models.errors import ConfigError
from models.terrain import Terrain

CONFIG = terrain_ladder._config()
BENCH = catalogue()["terrain_ladder"].load()


def measured(fails: dict[float, set[int]], asked: list[int]) -> Any:
    """Measures by a table of the seeds that fail at a level; keeps how many each call asked for."""

    def measure(level: float, seeds: Sequence[int]) -> list[dict[str, Any]]:
        asked.append(len(seeds))
        return [{"level": level, "seed": seed, "survived": seed not in fails.get(level, ())} for seed in seeds]

    return measure


@pytest.mark.parametrize(("failed", "walked"), [({3, 19}, 20), ({3, 7, 19}, 20), ({0, 1, 2}, 3), ({0, 1, 9, 15}, 10)])
def test_a_ladder_ends_as_soon_as_a_level_is_certainly_not_held(failed: set[int], walked: int) -> None:
    asked: list[int] = []
    cases = ascend([1.0, 2.0, 3.0], range(20), 0.9, measured({2.0: failed}, asked))
    assert [case["seed"] for case in cases[20:][:walked]] == list(range(walked))
    assert len(cases) == (60 if len(failed) <= 2 else 20 + walked)
    assert max(asked) == 3  # more than two failures decide


def test_a_few_seeds_may_not_fail_at_all() -> None:
    assert len(ascend([1.0, 2.0], range(5), 0.9, measured({1.0: {2}}, []))) == 3


def walks(robot: str = "g1", fails: dict[tuple[str, float], int] | None = None, **options: Any) -> Report:
    """Report of walks of which so many fail by ladder and level, without a walk."""

    def walk(robot: str, seed: int, scenario: str, level: float, contender: str) -> dict[str, Any]:
        first = options.get("first_seed", CONFIG.judging_seed)
        return {"survived": seed - first >= (fails or {}).get((scenario, level), 0), "reason": ""}

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(TerrainLadder, "measure", staticmethod(walk))
        return catalogue()["terrain_ladder"].load().run(Options(robot, **{"seeds": 20, **options}))


@pytest.mark.long
def test_the_hardest_level_with_eighteen_of_twenty_is_held_and_judged() -> None:
    report = walks(fails={("tiles", 0.05): 2, ("tiles", 0.06): 3, ("friction", 0.5): 3, ("friction", 0.4): 0})
    figures = report.figures
    assert figures["held_tiles"] == 0.05 and math.isnan(figures["held_friction"])
    assert (figures["survived_tiles_0.05"], figures["total_tiles_0.05"]) == (18.0, 20.0)
    assert (figures["survived_tiles_0.06"], figures["total_tiles_0.06"]) == (0.0, 3.0)
    assert "total_tiles_0.07" not in figures and figures["held_slope_down"] == 15.0
    assert not report.passed  # friction
    assert any("0.05: 18 of 20, 0.06: 0 of 3" in note for note in report.notes)
    assert walks().passed


def test_seeds_for_tuning_are_named_and_apart_from_those_that_judge() -> None:
    judged, tuned = walks(scenarios=("tiles",)), walks(scenarios=("tiles",), first_seed=0)
    assert {case["seed"] for case in judged.cases} == set(range(CONFIG.judging_seed, CONFIG.judging_seed + 20))
    assert any("for tuning only" in note for note in tuned.notes)
    assert not any("for tuning only" in note for note in judged.notes)


def test_seen_ground_is_walked_where_the_robot_has_range_sensors(tmp_path: Path) -> None:
    seen = {name for name, ladder in CONFIG.ladders.items() if isinstance(ladder.walk, Flight)}
    assert seen == {name for name in CONFIG.ladders if name.endswith("_seen")}
    report = walks(seeds=1)
    assert {case["scenario"] for case in report.cases} == set(CONFIG.ladders)
    assert BENCH.plots(report, tmp_path)[0].stat().st_size > 10_000
    other = walks(seeds=1, contender="some:Law")
    assert {case["scenario"] for case in other.cases} == set(CONFIG.ladders) - seen
    with pytest.raises(ConfigError, match="'stairs_seen' needs a robot with range sensors and is not for contenders"):
        walks(scenarios=("stairs_seen",), contender="some:Law")
    with pytest.raises(ConfigError, match="unknown scenario 'lava'; known: tiles"):
        walks(scenarios=("lava",))


def test_curves_show_blind_and_seen_together_and_how_many_of_a_level_that_ended_early() -> None:
    chose = ("tiles", "tiles_seen", "friction")
    report = walks(scenarios=chose, fails={("tiles", 0.03): 3, ("tiles_seen", 0.08): 1, ("friction", 0.3): 3})
    figure = draw_ladder_curves({("terrain_ladder", "g1"): report})
    assert figure is not None and draw_ladder_curves({}) is None
    tiles, friction = figure.axes
    shares = [np.asarray(line.get_ydata()).tolist() for line in tiles.lines[:2]]
    assert shares == [[1.0, 1.0, 0.0], [1.0, 1.0, 0.95, 1.0]]
    assert [text.get_text() for text in tiles.texts] == ["0/3", "19/20"]
    assert friction.xaxis_inverted() and not tiles.xaxis_inverted()


@pytest.mark.parametrize("name", list(CONFIG.ladders))
def test_levels_make_what_they_say(name: str) -> None:
    ladder = CONFIG.ladders[name]
    found = [ladder.at(level) for level in ladder.levels]
    assert len(set(map(str, found))) == len(found)
    steps = np.diff(ladder.levels)
    assert (steps > 0.0).all() or (steps < 0.0).all()


def test_a_slope_down_in_degrees_goes_down() -> None:
    walk = CONFIG.ladders["slope_down"].at(12.0)
    assert isinstance(walk, Condition) and isinstance(walk.terrain, Terrain)
    assert walk.terrain.pitch == pytest.approx(np.radians(-12.0))


def test_a_level_is_walked(monkeypatch: pytest.MonkeyPatch) -> None:
    config = replace(terrain._config(), duration=1.0)
    monkeypatch.setattr(terrain, "_config", lambda: config)
    case = terrain_ladder.walk_level("g1", CONFIG.judging_seed, "tiles", 0.01)
    assert not case["fell"] and 0.0 < case["distance"] < 0.21
