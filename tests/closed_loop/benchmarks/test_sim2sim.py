"""The benchmark of a robot that differs from its model: cases, verdicts, starts, and one tiny run."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.core.benchmark import catalogue
from benchmarks.core.harness import Options, Report
from benchmarks.stability import sim2sim
from bridge.driver.start_commands import StartState
from bridge.hardware_loop import HardwareLoop
from bridge.plants.deviation import Deviation
from models.errors import ConfigError

CONFIG = sim2sim._config()
BENCH = catalogue()["sim2sim"].load()


def report_of(results: list[dict[str, Any]]) -> Report:
    """Their report, judged by the bounds."""
    return Report("sim2sim", "g1", 1, BENCH.figures(results), results, True, {})


def good(seeds: int) -> list[dict[str, Any]]:
    """Results of runs that all survived."""
    outcome = {"distance": 5.0, "drift": 0.001, "odometry": 0.01, "aside": 0.1, "phase": "stop", "survived": True}
    return [{**case, **outcome, "reason": "", "time": 38.0} for case in BENCH.cases(Options("g1", seeds))]


def test_the_cases_are_the_conditions_or_those_chosen() -> None:
    cases = BENCH.cases(Options("g1", 2))
    assert {case["scenario"] for case in cases} == set(CONFIG.conditions)
    assert {case["seed"] for case in cases} == {CONFIG.first_seed, CONFIG.first_seed + 1}
    with pytest.raises(ConfigError, match="unknown scenario 'lava'; known: nominal"):
        BENCH.cases(Options("g1", scenarios=("lava",)))
    with pytest.raises(ConfigError, match="no laws for robot 'talos'; known: g1"):
        sim2sim.measure("talos", 0, "nominal")


@pytest.mark.parametrize(("failures", "passes"), [(1, True), (2, False)])
@pytest.mark.parametrize("name", list(CONFIG.conditions))
def test_nineteen_of_twenty_decide(name: str, failures: int, passes: bool) -> None:
    results = good(20)
    for case in [case for case in results if case["scenario"] == name][:failures]:
        case.update(survived=False, reason="base tilted", phase="walk", drift=float("nan"))
    report = report_of(results)
    assert BENCH.passed(report) is passes
    assert report.figures[f"drift_{name}_m"] == 0.001
    assert sum("walk, 38.0 s: base tilted" in note for note in BENCH.notes(report)) == failures


@pytest.mark.long
def test_a_run_that_is_too_slow_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """Through the whole start; half a second of walking cannot cover the distance."""
    short = replace(CONFIG, stand_time=0.5, motion_time=0.1, distance=0.1)
    monkeypatch.setattr(sim2sim, "_config", lambda: short)
    case = sim2sim.measure("g1", 100, "unitree")
    assert not case["survived"] and case["phase"] == "motion" and "mode 'motion' after 0.1 s" in case["reason"]
    assert case["drift"] < 0.01 and case["moments"]["mode"][-1] == "motion"


@pytest.mark.long
@pytest.mark.parametrize("forward", [0.02, pytest.param(-0.02, marks=pytest.mark.slow)])
def test_a_robot_with_another_com_starts_without_a_step(tmp_path: Path, forward: float) -> None:
    """Its feet stay where they touched down: the stiff hold does not lean it onto its toes or heels."""
    loop = HardwareLoop(tmp_path / "marker", seed=100, deviation=Deviation(com=(forward, 0.0, 0.0)))
    loop.reach(StartState.GANTRY)
    loop.startup.confirm_gantry()
    loop.reach(StartState.HANGING)
    loop.startup.lower()
    loop.side.rope_speed = loop.side.config.lowering_speed
    loop.reach(StartState.LOADED)
    soles = loop.side.plant.data.site_xpos[list(loop.side.plant.mujoco.sole_sites)].copy()
    loop.reach(StartState.STAND)
    loop.unhook()
    loop.run(3.0)
    assert not loop.failure
    assert np.abs(loop.side.plant.data.site_xpos[list(loop.side.plant.mujoco.sole_sites)] - soles).max() < 0.01
