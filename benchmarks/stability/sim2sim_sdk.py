"""One script in real time for a robot behind Unitree's SDK in another process, and for the simulated plant.

The script ``benchmarks/graph/robot_script.py`` runs as a process; with the SDK, in a separate network.
"""

import json
from dataclasses import asdict
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from pydantic import NonNegativeInt
from pydantic.dataclasses import dataclass as schema

from benchmarks.core.benchmark import ROOT, Benchmark, Bound, at_least, at_most, by_scenario, settings
from benchmarks.core.cable import isolation, plain_environment, run_program
from benchmarks.core.harness import Case, Options, Report, chosen
from benchmarks.core.machine import Unavailable
from benchmarks.core.results import NOT_RUN
from benchmarks.stability.sim2sim import conditions
from models.config import STRICT, Count, Positive, Share
from models.errors import ConfigError, PoiseError

SCRIPT = "benchmarks.graph.robot_script"


@schema(frozen=True, slots=True, config=STRICT)
class Scenario:
    """Robot side of a case."""

    sdk: bool  #: Whether the robot is behind Unitree's SDK; otherwise the simulated plant is used
    condition: str  #: Difference of the robot from the model, a condition of ``sim2sim``
    speed: Share  #: Speed of the robot's time over real time [-]


@schema(frozen=True, slots=True, config=STRICT)
class Sim2simSdkConfig:
    """Settings of the test; the units are in ``benchmarks/config/sim2sim_sdk.yaml``."""

    first_seed: NonNegativeInt
    script: dict[str, Any]
    rate: Count
    limit: Positive
    drift_max: Positive
    distance: Positive
    odometry_max: Positive
    stop_max: Positive
    scenarios: dict[str, Scenario]


config = partial(settings, Sim2simSdkConfig, "sim2sim_sdk")


def check_sdk() -> None:
    """Raise ``Unavailable`` if this machine lacks a requirement of a robot behind Unitree's SDK."""
    if find_spec("unitree_interface") is None:
        raise Unavailable("Unitree's SDK is not installed: pip install far-unitree-sdk")
    isolation()


def run_script(run: dict[str, Any], folder: Path, timeout: float) -> dict[str, Any]:
    """Run ``robot_script`` with a ``Run``; returns its ``Measured``. Errors of ``check_sdk`` and ``run_program``."""
    command: tuple[str, ...] = ()
    if run["sdk"]:
        check_sdk()
        command = isolation()
    environment = plain_environment(ROOT.parent, folder)
    words = ["-m", SCRIPT, str(folder), json.dumps(run)]
    found: dict[str, Any] = run_program(words, folder, environment, timeout=timeout, command=command)
    return found


def run_of(robot: str, seed: int, scenario: str) -> dict[str, Any]:
    """Return the ``Run`` of a scenario."""
    test = config()
    given = test.scenarios[scenario]
    condition = conditions()[given.condition]
    deviation = {} if condition.deviation is None else asdict(condition.deviation)
    return {
        "script": test.script, "sdk": given.sdk, "robot": robot, "seed": seed, "rate": test.rate,
        "speed": given.speed, "deviation": deviation,
    }  # fmt: skip


def measure(robot: str, seed: int, scenario: str) -> Case:
    """Run the script once; ``reason`` says why the robot failed, or why the case could not be run."""
    try:
        with TemporaryDirectory(prefix="poise_sim2sim_") as folder:
            return judged(run_script(run_of(robot, seed, scenario), Path(folder), config().limit))
    except Unavailable as error:
        return {"survived": False, "reason": f"not run: {error}", NOT_RUN: True}
    except PoiseError as error:
        return {"survived": False, "reason": str(error), "phase": "process"}


def judged(found: dict[str, Any]) -> Case:
    """Return figures of a script's results, and whether the robot ``survived``: no failure, upright after each push."""
    case: Case = {"phase": found["phase"], "stalls": found["stalls"], "answer_ms": found["answer_ms"]}
    if found["drift"] is not None:
        case["drift"] = float(np.abs(found["drift"]).max())
    if found["walked"] is not None:
        walked, counted = np.array(found["walked"]), np.array(found["odometry"])
        case["walked"] = float(np.linalg.norm(walked))
        case["odometry"] = float(np.linalg.norm(counted - walked)) / case["walked"]
    case["pushes"] = sum(found["pushes"])
    reasons = [found["failure"]]
    if not all(found["pushes"]):
        reasons.append(f"{case['pushes']} of {len(found['pushes'])} pushes survived")
    if found["stop_ms"] is not None:
        case["stop"] = float(found["stop_ms"])
        if found["kp"] or not found["kd"]:
            reasons.append(f"the stop left kp {found['kp']:g}, kd {found['kd']:g}: no damping")
    elif found["phase"] == "stop" and not found["failure"]:  # with the simulated plant the script ends with the walk
        reasons.append("no damping command received")
    case["reason"] = "; ".join(filter(None, reasons))
    return case | {"survived": not case["reason"]}


class Sim2simSdk(Benchmark):
    """All scenarios, or the selected ones, once per seed; one after another because they run in real time."""

    measure = staticmethod(measure)
    alone = True

    def cases(self, options: Options) -> list[Case]:
        given = config()
        if options.robot != "g1":
            raise ConfigError(f"bench sim2sim --mode sdk: the SDK's robot is a G1, not '{options.robot}'")
        names = chosen("sim2sim --mode sdk", options.scenarios, list(given.scenarios))
        return [
            {"robot": options.robot, "seed": seed, "scenario": name}
            for seed in options.each_seed(given.first_seed)
            for name in names
        ]

    def figures(self, cases: list[Case]) -> dict[str, float]:
        """Return ``survived_`` and ``total_`` runs of each scenario, including runs that could not be run.

        Worst values of the measured runs: ``drift_`` of an axis [m], ``walked_`` distance [m], error of the
        ``odometry_`` at the end of the walk over its distance [-], ``stop_`` and ``answer_`` [ms].
        """
        figures: dict[str, float] = {}
        for name, of in by_scenario(cases).items():
            figures[f"survived_{name}"] = float(sum(case["survived"] for case in of))
            figures[f"total_{name}"] = float(len(of))
            for key, unit, worst in (
                ("walked", "_m", min), ("drift", "_m", max), ("odometry", "", max),
                ("stop", "_ms", max),
            ):  # fmt: skip
                if values := [case[key] for case in of if key in case]:
                    figures[f"{key}_{name}{unit}"] = worst(values)
            for part in ("p50", "p99", "max"):
                if values := [case["answer_ms"][part] for case in of if case.get("answer_ms")]:
                    figures[f"answer_{part}_{name}_ms"] = max(values)
        return figures

    def bounds(self, report: Report) -> dict[str, Bound]:
        given, found = config(), dict[str, Bound]()
        for name in given.scenarios:
            found |= at_least({
                f"survived_{name}": report.figures.get(f"total_{name}", 0.0), f"walked_{name}_m": given.distance,
            })  # fmt: skip
            found |= at_most({
                f"drift_{name}_m": given.drift_max, f"odometry_{name}": given.odometry_max,
                f"stop_{name}_ms": given.stop_max,
            })  # fmt: skip
        return found

    def notes(self, report: Report) -> list[str]:
        return [
            *super().notes(report),
            *(
                f"{case['scenario']}, seed {case['seed']}: {case['reason']}"
                for case in report.cases
                if not case["survived"]
            ),
        ]

    def survived(self, case: Case) -> tuple[str, bool] | None:
        return None if case.get(NOT_RUN) else (case["scenario"], bool(case["survived"]))
