"""Walking at commanded velocities: who falls, how fast it really goes, what it costs, and whether it stops."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.harness import Case, LoadMeter, Options, Report, chosen, run_cases
from benchmarks.walk_cases import measure
from benchmarks.walk_config import robot_walk, walk_config
from benchmarks.walk_measure import speed_error
from benchmarks.walk_plot import plot

__all__ = ["cases", "judge", "plot", "run"]


CONTESTED = ("steady", "top")
"""Kinds of cases that ask nothing of a controller but a velocity."""


def cases(robot: str, seeds: int, scenarios: Sequence[str] = (), contender: str = "") -> list[Case]:
    """Inputs of every case.

    Args:
        robot: Name of a profile.
        seeds: How many seeds.
        scenarios: Chosen ones; all of the robot's when empty.
        contender: Controller to test instead of poise's own; it has ``CONTESTED`` scenarios only.

    Raises:
        ConfigError: There are no scenarios for this robot, or one that is chosen is unknown, or not for a contender.
    """
    config, wanted = walk_config(), robot_walk(robot)
    kinds = {name: "steady" if name in wanted.scenarios else name for name in wanted.names}
    known = [name for name, kind in kinds.items() if not contender or kind in CONTESTED]
    names = chosen(f"walk --robot {robot}{' --contender' if contender else ''}", scenarios, known)
    found: list[Case] = []
    for seed in range(seeds):
        for name in names:
            case: dict[str, Any] = {"kind": kinds[name]}
            if name in wanted.scenarios:
                case |= {"command": wanted.scenarios[name], "duration": config.duration}
            case |= {"scenario": name, "robot": robot, "seed": seed}
            found.append({**case, "contender": contender} if contender else case)
    return found


def judge(robot: str, results: Sequence[Case]) -> tuple[dict[str, float], list[str]]:
    """Figures of the results, and every bound that does not hold.

    Args:
        robot: Name of a profile.
        results: Cases, measured; figures of scenarios that were left out are left out.
    """
    of: dict[str, list[Case]] = {}
    for case in results:
        of.setdefault(case["scenario"], []).append(case)
    figures, broken = _judge_falls(results)
    wanted = robot_walk(robot)
    for name in wanted.scenarios:
        if name in of:
            found, faults = _judge_speed(name, of[name], wanted.scenarios[name])
            figures, broken = figures | found, broken + faults
    steady = [case for case in results if case["kind"] == "steady"]
    if steady:
        figures["speed_error_mean"] = float(np.mean([case["speed_error"] for case in steady]))
    walked = steady + of.get("random", [])
    if walked:
        figures["tracking_error_m_s"] = float(np.nanmean([case["tracking_error"] for case in walked]))
        figures["foot_slip_max_m"] = max(case["foot_slip"] for case in walked)
    if "forward" in of:
        figures["cost_of_transport"] = figures["cost_of_transport_forward"]
    if "stop" in of:
        broken += [
            f"stop, seed {case['seed']}: {'stood' if case['stood'] else 'did not stand'} after {case['steps']} steps, "
            f"then drifted {1e3 * case['drift']:.1f} mm"
            for case in of["stop"]
            if not case["ok"] and not case["fell"]
        ]
        figures["stop_drift_max_m"] = max(case["drift"] for case in of["stop"])
        figures["stop_steps_max"] = float(max(case["steps"] for case in of["stop"]))
    if "top" in of:
        figures["top_speed"] = top = min(case["top_speed"] for case in of["top"])
        figures["top_speed_median"] = float(np.median([case["top_speed"] for case in of["top"]]))
        if top < wanted.required_top_speed:
            slow = [case for case in of["top"] if case["top_speed"] < wanted.required_top_speed]
            broken += [f"top speed, seed {case['seed']}: {case['reason']}" for case in slow]
    return figures, broken


def _judge_falls(results: Sequence[Case]) -> tuple[dict[str, float], list[str]]:
    """Every walk but those of the top speed, which may fall where it finds the limit."""
    walks = [case for case in results if case["kind"] != "top"]
    falls = [case for case in walks if case["fell"]]
    broken = [f"fell: {case['scenario']}, seed {case['seed']}: {case['reason']}" for case in falls]
    return {"falls": float(len(falls)), "walks": float(len(walks))}, broken


def _judge_speed(name: str, results: Sequence[Case], command: Any) -> tuple[dict[str, float], list[str]]:
    error = speed_error(np.mean([case["velocity"] for case in results], axis=0), command)
    figures = {
        f"falls_{name}": float(sum(case["fell"] for case in results)),
        f"speed_error_{name}": error,
        f"cost_of_transport_{name}": float(np.nanmean([case["cost_of_transport"] for case in results])),
    }
    if error < walk_config().speed_error_limit:
        return figures, []
    return figures, [f"{name}: the mean velocity is {error:.3f} of the command off"]


def run(options: Options) -> Report:
    """The chosen scenarios of the robot, once a seed.

    Args:
        options: Robot, seeds, workers and scenarios.

    Returns:
        Figures ``falls`` of ``walks``, ``speed_error_mean``; of each scenario ``falls_``, ``speed_error_`` [-] and
        ``cost_of_transport_``; ``top_speed`` that every seed holds and ``top_speed_median`` [m/s],
        ``tracking_error_m_s``, ``cost_of_transport`` (forward), ``stop_drift_max_m``, ``stop_steps_max``,
        ``foot_slip_max_m``.

    Raises:
        ConfigError: There are no scenarios for this robot, or one that is chosen is unknown.
    """
    load = LoadMeter()
    wanted = cases(options.robot, options.seeds, options.scenarios, options.contender)
    results = run_cases(measure, wanted, bench="walk", options=options)
    figures, broken = judge(options.robot, results)
    return Report(
        bench="walk",
        robot=options.robot,
        seeds=options.seeds,
        figures=figures,
        cases=results,
        passed=not broken,
        contender=options.contender,
        load=load.read(),
        notes=broken[:10],
    )
