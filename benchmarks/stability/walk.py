"""Walking at commanded velocities: falls, velocity errors, cost of transport, stops and top speed."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from benchmarks.core.benchmark import Benchmark, Bound, at_least, at_most, by_scenario, saved
from benchmarks.core.harness import Case, Options, Report, chosen
from benchmarks.stability.falls import FAILED, PASSED, draw_failures
from benchmarks.stability.walk_cases import measure, robot_walk, speed_error, walk_config
from bridge.analysis.plots import new_figure

CONTESTED = ("steady", "top")  # kinds of cases that need only velocity commands


def cases(robot: str, seeds: range, scenarios: Sequence[str] = (), contender: str = "") -> list[Case]:
    """Return the inputs of all cases of the selected scenarios, or of all; for a contender only ``CONTESTED`` ones."""
    config, expected = walk_config(), robot_walk(robot)
    kinds = {name: "steady" if name in expected.scenarios else name for name in expected.names}
    known = [name for name, kind in kinds.items() if not contender or kind in CONTESTED]
    names = chosen(f"walk --robot {robot}{' --contender' if contender else ''}", scenarios, known)
    found: list[Case] = []
    for seed in seeds:
        for name in names:
            case: dict[str, Any] = {"kind": kinds[name]}
            if name in expected.scenarios:
                case |= {"command": expected.scenarios[name], "duration": config.duration}
            case |= {"scenario": name, "robot": robot, "seed": seed}
            found.append({**case, "contender": contender} if contender else case)
    return found


def judge(robot: str, results: Sequence[Case]) -> tuple[dict[str, float], list[str]]:
    """Compute the figures, and a text for every bound that does not hold."""
    of = by_scenario(results)
    walks = [case for case in results if case["kind"] != "top"]  # the search for the top speed may fall
    falls = [case for case in walks if case["fell"]]
    figures = {"falls": float(len(falls)), "walks": float(len(walks))}
    broken = [f"fell: {case['scenario']}, seed {case['seed']}: {case['reason']}" for case in falls]
    expected = robot_walk(robot)
    for name in expected.scenarios:
        if name in of:
            found, faults = _judge_speed(name, of[name], expected.scenarios[name])
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
        if top < expected.required_top_speed:
            slow = [case for case in of["top"] if case["top_speed"] < expected.required_top_speed]
            broken += [f"top speed, seed {case['seed']}: {case['reason']}" for case in slow]
    return figures, broken


def _judge_speed(name: str, results: Sequence[Case], command: Any) -> tuple[dict[str, float], list[str]]:
    error = speed_error(np.mean([case["velocity"] for case in results], axis=0), command)
    figures = {
        f"falls_{name}": float(sum(case["fell"] for case in results)),
        f"speed_error_{name}": error,
        f"cost_of_transport_{name}": float(np.nanmean([case["cost_of_transport"] for case in results])),
    }
    if error < walk_config().speed_error_limit:
        return figures, []
    return figures, [f"{name}: error of the mean velocity {error:.3f} of the command"]


class Walk(Benchmark):
    """Selected scenarios of the robot, once per seed."""

    measure = staticmethod(measure)

    def cases(self, options: Options) -> list[Case]:
        return cases(options.robot, options.each_seed(), options.scenarios, options.contender)

    def figures(self, cases: list[Case]) -> dict[str, float]:
        return judge(cases[0]["robot"], cases)[0]

    def bounds(self, report: Report) -> dict[str, Bound]:
        given, robot = walk_config(), robot_walk(report.robot)
        speeds = {f"speed_error_{name}": given.speed_error_limit for name in robot.scenarios}
        stop = {"stop_drift_max_m": given.stand_drift_limit, "stop_steps_max": float(given.stop_steps)}
        return at_most({"falls": 0.0, **speeds, **stop}) | at_least({"top_speed": robot.required_top_speed})

    def passed(self, report: Report) -> bool:
        """Whether every bound holds and every stop ends in mode stand."""
        return not judge(report.robot, report.cases)[1]

    def notes(self, report: Report) -> list[str]:
        return judge(report.robot, report.cases)[1][:10]

    def plots(self, report: Report, folder: Path) -> list[Path]:
        files = []
        walked = [case for case in report.cases if case["kind"] == "steady"]
        top = [case for case in report.cases if case["kind"] == "top"]
        panels = 2 * bool(walked) + bool(top)
        if panels:
            figure = new_figure(1.0 + 4.0 * panels, 4.0)
            axes = [figure.add_subplot(1, panels, i + 1) for i in range(panels)]
            if walked:
                _draw_scenarios(axes[0], walked, "speed_error", "|mean velocity - command| / |command| [-]")
                _draw_limit(axes[0], walk_config().speed_error_limit, "allowed of the mean")
                _draw_scenarios(axes[1], walked, "cost_of_transport", "cost of transport [-]")
            if top:
                axes[-1].plot([case["seed"] for case in top], [case["top_speed"] for case in top], "o", color=PASSED)
                _draw_limit(axes[-1], robot_walk(report.robot).required_top_speed, "required")
                axes[-1].set_xticks(sorted({case["seed"] for case in top}))
                axes[-1].set(xlabel="seed", ylabel="top speed held [m/s]")
            for one in axes:
                one.set_ylim(0.0, 1.25 * one.dataLim.y1 or 1.0)  # space for the legend above the data
                one.legend(loc="upper right", fontsize=8, ncols=3)
            figure.suptitle(f"walk, {report.who}, seeds: {report.seeds}", fontsize=10)
            files.append(saved(figure, folder / f"walk-{report.stem}.png"))
        return files + draw_failures(report, folder)

    def survived(self, case: Case) -> tuple[str, bool] | None:
        """Return the outcome by scenario; None for the search of the top speed, which may fall."""
        return None if case["kind"] == "top" else (case["scenario"], not case["fell"])


def _draw_limit(axes: Axes, value: float, name: str) -> None:
    axes.axhline(value, color="k", linewidth=0.8, linestyle="--", label=name)


def _draw_scenarios(axes: Axes, cases: list[Case], score: str, label: str) -> None:
    names = list(by_scenario(cases))
    for fell, colour in ((False, PASSED), (True, FAILED)):
        chosen = [case for case in cases if case["fell"] == fell]
        places = [names.index(case["scenario"]) for case in chosen]
        if chosen:
            axes.plot(places, [case[score] for case in chosen], "o", color=colour, label="fell" if fell else "walked")
    axes.set_xticks(range(len(names)), names, fontsize=8)
    axes.set_xlim(-0.5, len(names) - 0.5)
    axes.set_ylabel(label)
