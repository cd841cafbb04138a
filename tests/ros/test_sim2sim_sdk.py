"""The benchmark behind Unitree's SDK: cases, verdicts, and what it says where it cannot be run."""

import subprocess
from dataclasses import asdict
from typing import Any

import pytest

from benchmarks.core import cable
from benchmarks.core.benchmark import catalogue
from benchmarks.core.harness import Options, Report
from benchmarks.core.machine import Unavailable
from benchmarks.core.results import NOT_RUN
from benchmarks.graph.robot_script import Measured, Run
from benchmarks.stability import sim2sim, sim2sim_sdk
from bridge.plants.deviation import Deviation
from models.config import parse_config
from models.errors import ConfigError, PoiseError

pytestmark = pytest.mark.ros

CONFIG = sim2sim_sdk.config()
BENCH = catalogue()["sim2sim_sdk"].load()


def results(**changes: Any) -> dict[str, Any]:
    """Results of a script that everything went well in, or with changes."""
    good = Measured(
        phase="stop", drift=[0.001, -0.002, 0.0], stood=60.0, pushes=[True] * 4, walked=[12.0, 0.0],
        odometry=[12.06, 0.08], stop_ms=3, stopped="mode_machine changed to 4", kp=0.0, kd=5.0,
        answer_ms={"p50": 1.5, "p99": 3.0, "max": 10.0},
    )  # fmt: skip
    return asdict(good) | changes


def report_of(cases: list[dict[str, Any]]) -> Report:
    return Report("sim2sim_sdk", "g1", 1, BENCH.figures(cases), cases, True, {})


def test_the_cases_are_the_sides_or_those_chosen() -> None:
    cases = BENCH.cases(Options("g1", 2))
    assert {case["scenario"] for case in cases} == set(CONFIG.scenarios) and len(cases) == 2 * len(CONFIG.scenarios)
    assert {scenario.sdk for scenario in CONFIG.scenarios.values()} == {True, False}
    assert {scenario.condition for scenario in CONFIG.scenarios.values()} <= set(sim2sim.conditions())
    with pytest.raises(ConfigError, match="unknown scenario 'lava'; known: sdk"):
        BENCH.cases(Options("g1", scenarios=("lava",)))
    with pytest.raises(ConfigError, match="the SDK's robot is a G1, not 'talos'"):
        BENCH.cases(Options("talos"))


def test_a_run_is_passed_on_as_the_process_reads_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """The robot behind the SDK is the G1 as Unitree models it."""
    runs: list[dict[str, Any]] = []
    monkeypatch.setattr(sim2sim_sdk, "run_script", lambda run, folder, timeout: runs.append(run) or results())
    case = sim2sim_sdk.measure("g1", 3, "sdk")
    run = parse_config(Run, runs[0], "run")
    assert case["survived"] and run.sdk and run.seed == 3 and run.script.walk_time * run.script.speed > CONFIG.distance
    deviation = parse_config(Deviation, run.deviation, "deviation")
    assert deviation == sim2sim.conditions()["unitree"].deviation and deviation.torso_mass == 1.8


@pytest.mark.parametrize(
    ("changes", "figure", "reason"),
    [
        ({}, "", ""),
        ({"drift": [0.0, 0.011, 0.0]}, "drift_sdk_m", ""),
        ({"walked": [9.9, 0.0], "odometry": [9.9, 0.0]}, "walked_sdk_m", ""),
        ({"odometry": [12.2, 0.0]}, "odometry_sdk", ""),
        ({"odometry": [12.0, 0.2]}, "odometry_sdk", ""),
        ({"stop_ms": 11}, "stop_sdk_ms", ""),
        ({"pushes": [True, False, False, False]}, "survived_sdk", "1 of 4 pushes survived"),
        ({"kp": 10.0}, "survived_sdk", "no damping"),
        ({"failure": "no new state", "walked": None, "odometry": None}, "survived_sdk", "no new state"),
    ],
)
def test_each_demand_decides(changes: dict[str, Any], figure: str, reason: str) -> None:
    case = {"scenario": "sdk", "seed": 0, **sim2sim_sdk.judged(results(**changes))}
    report = report_of([case])
    failed = [text for ok, text in BENCH.judged(report) if not ok]
    assert BENCH.passed(report) is not bool(changes)
    assert [text.split()[0] for text in failed] == ([figure] if figure else [])
    assert reason in case["reason"] and any(reason in note for note in BENCH.notes(report))


def test_without_the_sdk_or_namespaces_it_says_so_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sim2sim_sdk, "find_spec", lambda name: None)
    case = {"scenario": "sdk", "seed": 0, **sim2sim_sdk.measure("g1", 0, "sdk")}
    assert case[NOT_RUN] and "pip install far-unitree-sdk" in case["reason"]
    report = report_of([case])
    assert not BENCH.passed(report) and any("far-unitree-sdk" in note for note in BENCH.notes(report))
    monkeypatch.setattr(sim2sim_sdk, "find_spec", lambda name: object())

    def refused(*arguments: Any, **options: Any) -> subprocess.CompletedProcess[str]:
        return subprocess.CompletedProcess([], 1, "", "unshare: Operation not permitted\n")

    cable.isolation.cache_clear()
    monkeypatch.setattr(cable.subprocess, "run", refused)
    try:
        with pytest.raises(Unavailable, match="no network namespaces here: unshare: Operation not permitted"):
            sim2sim_sdk.check_sdk()
    finally:
        cable.isolation.cache_clear()


def test_a_program_that_fails_is_reported_with_its_errors(tmp_path: Any) -> None:
    good = cable.run_program(["-c", "print(); print('[1, 2]')"], tmp_path, {}, timeout=20.0)
    assert good == [1, 2]
    with pytest.raises(PoiseError, match="exit code 3: broken"):
        words = ["-c", "import sys; sys.stderr.write('broken'); sys.exit(3)"]
        cable.run_program(words, tmp_path, {}, timeout=20.0)
    with pytest.raises(PoiseError, match=r"has not ended after 0\.1 s"):
        cable.run_program(["-c", "import time; time.sleep(9)"], tmp_path, {}, timeout=0.1)
