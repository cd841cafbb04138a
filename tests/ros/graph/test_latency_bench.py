"""A short run of the real graph: every stage of a tick is noted, in order, and the stages add up."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.core.benchmark import catalogue
from benchmarks.core.harness import Case, Options, Sweep, read_json, write_json
from benchmarks.core.machine import Use, read_machine
from benchmarks.core.results import ResultsFile
from benchmarks.core.timed_run import spread
from benchmarks.graph.graph_run import Run, Scenario, active_within, latency_config
from benchmarks.speed import latency
from benchmarks.speed.latency import STAGES, judge, split, summarise, tails, verdict
from bridge.driver.probes import LEFT, RIGHT, LatencyProbe
from models.errors import PoiseError

pytestmark = pytest.mark.ros

CONFIG = replace(latency_config(), duration=2.0, warm_up=0.5)

BENCH = catalogue()["latency"].load()


@pytest.mark.slow
def test_the_stages_of_a_real_run_add_up_beside_companions() -> None:
    from benchmarks.graph.graph_run import run_graphs

    (run,) = run_graphs("g1", 0, Scenario(rate=500.0, subscribers=1, stress=1), CONFIG)
    ticks = split(run.bridge, run.laws, 100, 1_000_000)
    assert len(ticks.total) > 500  # 2.5 s at 500 Hz, some of them missed on a busy machine
    assert (ticks.stages >= 0.0).all()
    np.testing.assert_allclose(ticks.stages.sum(axis=1), ticks.total, atol=1e-6)
    assert (ticks.contacts == LEFT | RIGHT).all()
    names = dict(zip(STAGES, np.median(ticks.stages, axis=0), strict=True))
    assert all(names[stage] > 0.0 for stage in STAGES if stage not in ("sensor_transport", "command_transport"))
    assert (np.diff(np.flatnonzero(run.bridge["published"])) == 2).all()
    assert {"robot_driver", "timed_control", "stress_0", "subscriber_0"} <= set(run.use)
    assert all(use.memory > 5.0 for use in run.use.values())


def made_up() -> Case:
    """What is measured of a scenario."""
    samples = {
        "latency": np.linspace(500.0, 1500.0, 1001),
        "late": np.zeros(10),
        "floor": np.full(100, 300.0),
        **{f"stage_{stage}": np.full(4, 10.0) for stage in STAGES},
        "single": np.array([70.0, 80.0]),
        "double": np.array([90.0, 100.0]),
    }
    return {
        "spreads": {name: spread(values) for name, values in samples.items()},
        "missed_fraction": 0.0,
        "floor_missed_fraction": 0.0,
        "over_a_tick_fraction": 0.5,
        "cpu": {"a": 0.5},
        "memory": {"a": 100.0},
        "others": [{"missed_fraction": 0.5, **spread(np.full(3, 2000.0))}],
    }


def test_a_run_becomes_a_case_that_keeps_no_tick() -> None:
    ticks = np.arange(2002)
    begin = ticks * 1_000_000 + 1
    bridge = {
        "published": begin,
        "sent": begin + 10_000,
        "arrived": begin + 70_000,
        "received": begin + np.where(ticks % 2, 500_000, 1_500_000),
        "late": np.zeros(2002),
        "skipped": np.zeros(2002, dtype=np.int64),
        "active": np.ones(2002, dtype=bool),
    }
    stages = np.column_stack([ticks * 1_000_000, *(begin + k * 10_000 for k in range(2, 7))])
    laws = {"stages": stages, "contacts": np.where(ticks % 2, LEFT, LEFT | RIGHT).astype(np.uint8)}
    case = latency._case(Run(bridge, laws, {"a": Use(0.5, 100.0)}), 1, 0.001)
    assert case["over_a_tick_fraction"] == pytest.approx(0.5) and case["missed_fraction"] == 0.0
    names = {"latency", "late", "single", "double", "single_stage_qp", "double_stage_qp"}
    assert set(case["spreads"]) == names | {f"stage_{stage}" for stage in STAGES}
    figures = tails([case["spreads"]["single"]], "") | tails([case["spreads"]["double"]], "double_")
    assert (figures["p50_us"], figures["double_p50_us"]) == (500.0, 1500.0)
    assert case["spreads"]["latency"]["count"] == 2000
    assert len(json.dumps(case)) < 40_000  # however long it was measured


@pytest.mark.parametrize("failure", ["not standing after 180 s", "the drivers were active for 3.0 s of 20 s"])
def test_a_graph_that_does_not_come_up_or_does_not_last_is_a_result(
    monkeypatch: pytest.MonkeyPatch, failure: str
) -> None:
    ticks = np.arange(20_001)

    def fail(*arguments: object) -> list[Run]:
        if failure.startswith("not standing"):
            raise PoiseError(failure)
        rows = {"published": 1 + ticks * 1_000_000, "active": ticks >= 0}
        return [Run(active_within(rows, 0, end), {}, {}) for end in (1 << 62, 1 << 62, 3_000_000_001, 1 << 62)]

    monkeypatch.setattr(latency, "run_graphs", fail)
    monkeypatch.setattr(latency, "free_domain", lambda: 0)
    monkeypatch.setattr(latency.pingpong, "measure", lambda *arguments: LatencyProbe())
    monkeypatch.setattr(latency, "cost", lambda: 1e-6)
    report = BENCH.run(Options(scenarios=("robots_4",)))
    assert not report.passed
    assert report.figures["robots_4_stood_fraction"] == 0.0 and "robots_4_p50_us" not in report.figures
    assert f"robots_4: seed 0: {failure}" in report.notes
    assert any(note.endswith("does NOT keep real time: robots_4 at 0.25 of real time") for note in report.notes)


def test_ticks_before_and_after_the_measurement_do_not_count() -> None:
    published = np.array([0, 10, 20, 30, 40])
    rows = {"published": published, "active": np.array([False, True, True, False, True]), "late": published * 0.1}
    found = active_within(rows, 15, 35)
    assert found["active"].tolist() == [False, False, True, False, False] and found["late"] is rows["late"]
    assert rows["active"].sum() == 3 and active_within({}, 15, 35) == {}


def test_a_scenario_becomes_figures_and_a_verdict() -> None:
    figures = summarise([made_up()], 0.001)
    assert figures["p50_us"] == pytest.approx(1000.0) and figures["ratio_to_floor_p50"] == pytest.approx(10 / 3)
    assert figures["p50_bound_us"] == pytest.approx(1450.0) and figures["p99_bound_us"] == pytest.approx(1750.0)
    assert figures["over_a_tick_fraction"] == pytest.approx(0.5, abs=1e-3)
    assert (figures["single_p50_us"], figures["double_p50_us"]) == (75.0, 95.0)
    assert figures["stood_fraction"] == 1.0
    assert figures["stage_qp_p99_us"] == 10.0 and figures["cpu_a_cores"] == 0.5
    assert figures["others_missed_fraction"] == 0.5 and figures["others_p50_us"] == 2000.0
    assert judge(figures)[0]
    held, lines = judge(figures | {"missed_fraction": 0.002})
    assert not held and lines[3].startswith("FAILS: missed_fraction")
    said = verdict({"idle": True, "load": False}, read_machine())
    assert said[0].endswith("real time: idle") and said[1].endswith("real time: load")


def test_a_rerun_makes_the_same_figures_and_plots_of_the_lines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    measured: list[str] = []

    def measure(robot: str, seed: int, scenario: str) -> Case:
        measured.append(scenario)
        case: Case = made_up() | {"scenario": scenario, "seed": seed}
        if scenario != "idle":  # nothing was noted
            kept = {name: case["spreads"][name] for name in ("latency", "late", "floor")}
            case |= {"spreads": kept, "cpu": {}, "memory": {}}
        return case

    monkeypatch.setattr(latency.Latency, "measure", staticmethod(measure))
    monkeypatch.setattr(latency, "cost", lambda: 1e-6)
    reports = []
    for scenarios in (("idle",), ("idle", "plain"), ("idle", "plain")):
        with ResultsFile(tmp_path / "cases.jsonl") as file:
            reports.append(BENCH.run(Options(scenarios=scenarios, sweep=Sweep(None, file))))
    assert measured == ["idle", "plain"]
    _, first, again = reports
    assert again.figures == first.figures and again.cases == first.cases and again.passed
    assert {"stage_qp_p99_us", "single_p50_us", "plain_p50_us"} <= set(again.figures)
    assert max(len(line) for line in (tmp_path / "cases.jsonl").read_text().splitlines()) < 100_000
    write_json(again, tmp_path / "latency.json")
    for report in (again, read_json(tmp_path / "latency.json")):
        assert [file.name for file in BENCH.plots(report, tmp_path)] == [
            "latency-g1.png",
            "latency-stages-g1.png",
        ]
