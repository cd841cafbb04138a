"""The stairs benchmark: its cases, what decides, and a walk that is measured."""

from typing import Any

import pytest

from benchmarks.core.benchmark import catalogue
from benchmarks.core.harness import Options, Report
from benchmarks.stability import stairs
from models.errors import ConfigError

CONFIG = stairs._config()
BENCH = catalogue()["stairs"].load()


def results(failures: int, chosen: str = "") -> list[dict[str, Any]]:
    """Twenty seeds of every rise, or of a chosen scenario; so many of the highest, or of that, fall."""
    outcome = {"fell": False, "reason": "", "time": 27.0, "distance": 6.9, "steps": 46, "survived": True, "trips": 0}
    cases = [{**case, **outcome} for case in BENCH.cases(Options("g1", 20, scenarios=(chosen,) if chosen else ()))]
    for case in [case for case in cases if case["scenario"] in ("rise_15", chosen)][:failures]:
        case |= {"fell": True, "survived": False, "reason": "base tilted", "trips": 2}
    return cases


def report_of(cases: list[dict[str, Any]]) -> Report:
    """Their report, judged by the bounds."""
    return Report("stairs", "g1", 20, BENCH.figures(cases), cases, True, {})


@pytest.mark.parametrize(("failures", "passes"), [(0, True), (2, True), (3, False)])
def test_eighteen_of_twenty_decide(failures: int, passes: bool) -> None:
    report = report_of(results(failures))
    assert BENCH.passed(report) is passes
    assert report.figures["survived_rise_15"] == 20 - failures and report.figures["trips_rise_15"] == 2 * failures
    assert sum("base tilted after 46 steps" in note for note in BENCH.notes(report)) == failures


@pytest.mark.parametrize(("chosen", "passes"), [("seen_15_ten", False), ("seen_blind", False), ("rise_18", True)])
def test_a_chosen_scenario_has_the_bound_too_unless_it_is_a_goal(chosen: str, passes: bool) -> None:
    assert BENCH.passed(report_of(results(3, chosen))) is passes
    assert BENCH.passed(report_of(results(2, chosen)))


def test_the_cases_are_the_bounded_rises_or_those_chosen() -> None:
    assert {case["scenario"] for case in BENCH.cases(Options("g1"))} == set(CONFIG.rises)
    assert [case["seed"] for case in BENCH.cases(Options("g1", 2, scenarios=("rise_18",)))] == [0, 1]
    with pytest.raises(ConfigError, match="unknown scenario 'ladder'; known: rise_5"):
        BENCH.cases(Options("g1", scenarios=("ladder",)))


@pytest.mark.long
def test_a_walk_over_a_kerb_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    fields = {name: getattr(CONFIG, name) for name in CONFIG.__slots__}
    config = stairs.StairsConfig(**{**fields, "count": 1, "landing": 0.5})
    monkeypatch.setattr(stairs, "_config", lambda: config)
    case = stairs.climb("g1", 0, "rise_5")
    assert case["survived"] and case["reason"] == "" and case["trips"] == 0 and "moments" not in case
    assert 0.4 + 0.5 < case["distance"] < 1.4 and 0.1 < case["torque"] <= 1.0
