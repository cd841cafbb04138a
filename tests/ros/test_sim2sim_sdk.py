"""The benchmark behind Unitree's SDK: cases, verdicts, and what it says where it cannot be run."""

import os
import subprocess
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from benchmarks.core import cable
from benchmarks.core.benchmark import catalogue
from benchmarks.core.harness import Options, Report
from benchmarks.core.machine import Unavailable
from benchmarks.core.results import NOT_RUN
from benchmarks.graph.robot_process import RobotProcess
from benchmarks.graph.robot_script import Measured, Run, drive, stop
from benchmarks.graph.robot_session import HardwareSession
from benchmarks.stability import sim2sim, sim2sim_sdk
from bridge.plants.deviation import Deviation
from models.config import parse_config
from models.errors import ConfigError, PoiseError
from models.nodes import realtime

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
        ({"stop_ms": None}, "survived_sdk", "no damping command received"),
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


def test_the_simulated_plant_needs_no_stop() -> None:
    assert sim2sim_sdk.judged(results(phase="walk", stop_ms=None))["survived"]


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
        expected = (
            "network namespaces are not available: unshare: Operation not permitted; .* root .* sysctl kernel.unpriv"
        )
        with pytest.raises(Unavailable, match=expected):
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
    for code, said in (("pass", "is not JSON: ''; errors: none"), ("print('hello')", "is not JSON: 'hello'")):
        with pytest.raises(PoiseError, match=said):
            cable.run_program(["-c", code], tmp_path, {}, timeout=20.0)


def test_a_cable_that_cannot_be_laid_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fake = tmp_path / "ip"
    fake.write_text("#!/bin/sh\necho 'not permitted' >&2\nexit 2\n")
    fake.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    with pytest.raises(PoiseError, match="ip -brief link show cable0: exit code 2: not permitted"):
        cable._plugged("cable0")
    fake.write_text("#!/bin/sh\necho cable0 DOWN\n")
    times = iter((0.0, 30.0))
    monkeypatch.setattr(cable.time, "monotonic", lambda: next(times))
    with pytest.raises(PoiseError, match="interface cable0 is not up after 20 s"):
        cable._plugged("cable0")


def test_a_robot_that_has_ended_is_an_error_with_its_log(tmp_path: Path) -> None:
    robot = RobotProcess("sdk", "lo", tmp_path, command=("sh", "-c", "echo broken >&2; exit 3"))
    for name in ("report", "push"):  # the second is written to a closed pipe
        with pytest.raises(PoiseError, match=f"ended during '{name}': exit code 3; robot.log: broken"):
            robot(name)
    robot.close()


def test_a_missing_figure_of_the_driver_is_an_error_by_name() -> None:
    session = HardwareSession.__new__(HardwareSession)
    session._values = {}
    with pytest.raises(
        PoiseError, match=r"'sample to command p50 \[ms\]' in the diagnostics of the driver is not a number: ''"
    ):
        stop(session, Measured())


def test_processes_that_the_operator_starts_do_not_inherit_its_priority(monkeypatch: pytest.MonkeyPatch) -> None:
    class Standing:
        def stand(self) -> None: ...

        def pass_time(self, time_s: float) -> None:
            raise PoiseError("enough")

    policies: set[int] = set()
    monkeypatch.setattr(realtime, "_done", set())
    monkeypatch.setattr(realtime.os, "sched_setscheduler", lambda thread, policy, priority: policies.add(policy))
    script = parse_config(Run, {"script": CONFIG.script, "sdk": True}, "run").script
    with pytest.raises(PoiseError, match="enough"):
        drive(Standing(), script, Measured())  # type: ignore[arg-type]
    assert policies == {os.SCHED_FIFO | os.SCHED_RESET_ON_FORK}
