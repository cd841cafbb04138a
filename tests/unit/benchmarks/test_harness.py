import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from benchmarks.core.harness import (
    LoadMeter,
    Options,
    Report,
    percentiles,
    print_report,
    read_json,
    run_cases,
    write_json,
)
from models.errors import ConfigError

SCHEMA = {"bench", "robot", "contender", "seeds", "figures", "cases", "versions", "revision", "load", "passed"}


def _square(seed: int) -> dict[str, Any]:
    return {"square": seed * seed, "pid": os.getpid(), "threads": os.environ["OMP_NUM_THREADS"]}


def test_percentiles_name_every_figure() -> None:
    figures = percentiles(np.arange(10001.0), "tick_us")
    expected = {"tick_us_p50": 5000.0, "tick_us_p99": 9900.0, "tick_us_p999": 9990.0, "tick_us_max": 10000.0}
    assert figures == pytest.approx(expected, rel=1e-12)
    with pytest.raises(ValueError, match="tick_us"):
        percentiles([], "tick_us")


def test_json_has_the_schema_and_only_json_values(tmp_path: Path) -> None:
    figures = {"a_us": np.float64(1.5), "b": float("nan")}
    cases = [{"seed": np.int64(3), "ok": np.bool_(True), "xs": np.zeros(2)}]
    report = Report("push", "g1", 1, figures, cases, passed=True, load=LoadMeter().read())
    write_json(report, tmp_path / "new" / "report.json")
    data = json.loads((tmp_path / "new" / "report.json").read_text(), parse_constant=pytest.fail)
    assert set(data) == SCHEMA
    assert data["figures"] == {"a_us": 1.5, "b": None}
    assert data["cases"] == [{"seed": 3, "ok": True, "xs": [0.0, 0.0]}]
    assert data["versions"]["mujoco"] and len(data["load"]["before"]) == 3


def test_a_report_is_read_again_and_nothing_else_is(tmp_path: Path) -> None:
    file = tmp_path / "report.json"
    cases = [{"seed": 3, "places": [1.5, float("nan")], "reason": "fell"}]
    report = Report("walk", "g1", 1, {"a": 1.5}, cases, passed=False, load=LoadMeter().read())
    write_json(report, file)
    again = read_json(file)
    assert (again.bench, again.robot, again.seeds, again.figures, again.passed) == ("walk", "g1", 1, {"a": 1.5}, False)
    assert again.cases[0]["reason"] == "fell" and np.isnan(again.cases[0]["places"][1])
    for text in ("not json", "[1]", '{"bench": "walk"}'):
        file.write_text(text)
        with pytest.raises(ConfigError, match="not a report"):
            read_json(file)


def test_the_contender_is_named_at_the_top_and_in_titles(tmp_path: Path) -> None:
    file = tmp_path / "report.json"
    report = Report("walk", "g1", 1, {}, [], True, LoadMeter().read(), contender="mine:Walker")
    write_json(report, file)
    assert json.loads(file.read_text())["contender"] == "mine:Walker"
    assert read_json(file).who == "g1, contender mine:Walker"
    found = json.loads(file.read_text())
    del found["contender"]  # of a file from before there were any
    file.write_text(json.dumps(found))
    assert read_json(file).who == "g1"
    console = Console(record=True, width=100)
    print_report(report, console)
    assert "walk: g1, contender mine:Walker" in " ".join(console.export_text().split())


def test_cases_come_back_in_order_from_one_process() -> None:
    results = run_cases(_square, [{"seed": seed} for seed in (3, 1, 2)], bench="squares", options=Options())
    assert [(case["seed"], case["square"]) for case in results] == [(3, 9), (1, 1), (2, 4)]
    assert {case["pid"] for case in results} == {os.getpid()}


def test_a_failing_case_is_not_swallowed() -> None:
    with pytest.raises(KeyError):
        run_cases(_fail, [{"seed": 0}], bench="fails", options=Options())


def _fail(seed: int) -> dict[str, Any]:
    raise KeyError(seed)
