"""Largest push that a robot takes with steps, standing or walking, beside the bounds of ankles and of N steps.

``poise bench push --mode catch`` pushes a robot that stands in mode 'stand', ``--mode step`` one that stands in mode
'walk', ``--mode walk`` one that walks. The figure of a direction is the largest push that it takes at every moment
tried (phases of the stride; standing, seeds): a bisection on all of them at once. A push is taken when the robot does
not fall, its legs do not intersect, and some seconds later it stands still, or walks on.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.core.benchmark import Benchmark, Bound, at_least
from benchmarks.core.harness import Case, Options, Report
from benchmarks.core.loops import Search, largest
from benchmarks.stability.fall_plot import FAILED, GOAL, PASSED, draw_fall
from benchmarks.stability.push import stance
from benchmarks.stability.push_bounds import ankle_bound, step_distance
from benchmarks.stability.push_plot import PushMap, PushMode, angles, direction_name, draw_map
from benchmarks.stability.push_trial import Trial, map_config, moments, prepare, survives
from models.constants import GRAVITY
from models.errors import ConfigError
from models.heading import heading

#: What the figures are, for the reader of the table
MEANING = (
    "dv: impulse over mass [m/s] that is taken in every phase, impulse in [N.s]; ankle and steps: what a linear "
    "pendulum takes without and with steps"
)


def bounds(trial: Trial) -> dict[str, float]:
    """Impulse over mass that the linear pendulum takes at the moment of a push [m/s]: ``ankle_dv`` and ``steps_dv``.

    The edge is that of the loaded soles, in the direction of the push; 0 where the DCM is already beyond it.
    """
    config, loop = map_config(), prepare(trial)
    angle = heading(*loop.truth.q[3:7]) + trial.angle
    direction = np.array([math.cos(angle), math.sin(angle)])
    now = stance(loop.robot, loop.truth)
    loaded = [foot for foot in range(2) if loop.truth.contacts[foot].active] or [0, 1]
    height = float(now.com[2] - now.soles[loaded, 2].mean())
    omega = math.sqrt(GRAVITY / height)
    dcm = now.com[:2] + now.com_velocity[:2] / omega
    ahead = float((now.polygon @ direction).max() - dcm @ direction)
    frame = np.array([math.cos(trial.angle), math.sin(trial.angle)])
    further = step_distance(loop.gait.config, omega, config.bound_steps, frame)
    mass = loop.robot.mass
    return {
        name: max(ankle_bound(mass, height, distance, config.duration), 0.0) * config.duration / mass
        for name, distance in (("ankle_dv", ahead), ("steps_dv", ahead + further))
    }


def measure(robot: str, mode: str, seed: int, angle: float) -> Case:
    """Bisect the push in one direction, a heading relative to the robot's [rad], over all phases.

    Returns:
        ``dv`` [m/s], ``impulse`` [N.s], ``mass`` [kg], ``ankle_dv`` and ``steps_dv`` [m/s], ``pushes`` [-]; of the
        smallest push that was not taken, ``failed_dv`` [m/s], ``failed_phase``, ``reason`` and ``moments``.
    """
    config = map_config()
    trials = [Trial(robot, PushMode(mode), seed, phase, angle) for phase in range(config.phases[PushMode(mode)])]
    failed: dict[str, Any] = {"failed_dv": math.nan, "failed_phase": 0, "reason": "", "moments": {}}

    def holds(dv: float) -> bool:
        # The moment that failed last is the likeliest to fail again.
        for trial in sorted(trials, key=lambda trial: trial.phase != failed["failed_phase"]):
            loop = prepare(trial)
            outcome = survives(loop, trial, dv)
            if outcome.reason:
                failed.update(failed_dv=dv, failed_phase=trial.phase, reason=outcome.reason)
                failed["moments"] = moments(loop, outcome)
                return False
        return True

    search = Search(config.first, config.largest, config.stride, config.resolution)
    dv, pushes = largest(holds, search)
    limits = [bounds(trial) for trial in trials]
    mass = prepare(trials[0]).robot.mass
    return {
        "dv": dv,
        "impulse": dv * mass,
        "mass": mass,
        **{name: min(limit[name] for limit in limits) for name in limits[0]},
        "pushes": pushes,
        **failed,
    }


def summarise(results: list[Case]) -> dict[str, float]:
    """Figures over the directions, each the smallest of its seeds and phases.

    Returns:
        ``dv_min`` and ``dv_median`` [m/s], ``impulse_min`` [N.s], the bounds ``ankle_dv_min`` and ``steps_dv_min``
        [m/s], ``ratio_to_ankle_bound_min``, ``..._median`` and likewise ``ratio_to_steps_bound_``, and
        ``legs_touched``: the number of directions limited by intersecting legs.
    """
    angles = sorted({case["angle"] for case in results})
    dv = np.array([min(case["dv"] for case in results if case["angle"] == angle) for angle in angles])
    figures = {
        "dv_min": float(dv.min()),
        "dv_median": float(np.median(dv)),
        "impulse_min": min(float(case["impulse"]) for case in results),
        "ankle_dv_min": min(case["ankle_dv"] for case in results),
        "steps_dv_min": min(case["steps_dv"] for case in results),
        "legs_touched": float(sum("legs" in case["reason"] for case in results)),
    }
    for bound in ("ankle", "steps"):
        limits = np.array([min(case[f"{bound}_dv"] for case in results if case["angle"] == angle) for angle in angles])
        of_bound = dv[limits > 0.0] / limits[limits > 0.0]  # none where the DCM was beyond the edge already
        figures[f"ratio_to_{bound}_bound_min"] = float(of_bound.min()) if len(of_bound) else math.nan
        figures[f"ratio_to_{bound}_bound_median"] = float(np.median(of_bound)) if len(of_bound) else math.nan
    return figures


def case_lines(results: list[Case]) -> list[str]:
    """One line a direction and seed: what it takes, and how the next larger push that was tried failed."""
    head = f"{'pushed':<14}{'seed':>5}{'m/s':>7}{'N.s':>6}   not taken"
    return [head] + [
        f"{direction_name(case['angle']):<14}{case['seed']:>5}{case['dv']:7.2f}{case['impulse']:6.1f}   "
        + (f"{case['failed_dv']:.2f} m/s, phase {case['failed_phase']}: {case['reason']}" if case["reason"] else "-")
        for case in results
    ]


def weakest(report: Report) -> Case:
    """The case of the smallest push that was not taken."""
    return min(report.cases, key=lambda case: (case["dv"], case["angle"]))


def push_map(report: Report) -> PushMap:
    """The map of what ``run`` found."""
    mode, config = PushMode(report.bench.removeprefix("push_")), map_config()
    lines = (
        ("steps_dv", f"{config.bound_steps}-step capturability bound", {"color": "0.35", "linestyle": ":"}),
        ("ankle_dv", "ankle bound", {"color": "0.35", "linestyle": "--"}),
        ("dv", "taken in every phase", {"color": PASSED, "marker": "o"}),
    )
    circles = (
        ("required of the weakest", config.required[mode].smallest, {"color": FAILED}),
        ("goal for the weakest", config.goals[mode].smallest, {"color": GOAL, "linestyle": "-."}),
    )
    title = {
        PushMode.CATCH: "pushed in mode 'stand', steps allowed",
        PushMode.STEP: "pushed while standing in mode 'walk'",
        PushMode.WALK: f"pushed while walking at {config.walk_speed:g} m/s",
    }[mode]
    return PushMap(report.cases, lines, circles, title)


class PushWithSteps(Benchmark):
    """Bisect the push in every direction, or in those chosen, for every seed; one mode a report."""

    measure = staticmethod(measure)

    @property
    def mode(self) -> PushMode:
        """Whether the robot stands or walks."""
        return PushMode(self.name.removeprefix("push_"))

    def cases(self, options: Options) -> list[Case]:
        """Every direction of every seed."""
        if options.contender:
            raise ConfigError("a contender is pushed in mode 'stand' only: the others look into poise's gait")
        config, first = map_config(), map_config().first_seed[self.mode]
        return [
            {"robot": options.robot, "mode": self.mode.value, "seed": seed, "angle": angle}
            for seed in range(first, first + options.seeds)
            for angle in angles(self.name, config.directions[self.mode], options.scenarios)
        ]

    def figures(self, cases: list[Case]) -> dict[str, float]:
        """See ``summarise``."""
        return summarise(cases)

    def bounds(self, report: Report) -> dict[str, Bound]:
        """Least push of the weakest direction and of the median one."""
        required = map_config().required[self.mode]
        return at_least({"dv_min": required.smallest, "dv_median": required.median})

    def notes(self, report: Report) -> list[str]:
        """A line a direction and seed, then the bounds."""
        return [MEANING, *case_lines(report.cases), *super().notes(report)]

    def plots(self, report: Report, folder: Path) -> list[Path]:
        """Draw the push map, and the smallest push that was not taken."""
        mode, case = PushMode(report.bench.removeprefix("push_")), weakest(report)
        name = f"{mode.value}-{report.robot}"
        files = [draw_map(report, push_map(report), case_lines(report.cases), folder / f"push-map-{name}.png")]
        if case["moments"]:
            title = (
                f"push, {mode.value}, {report.robot}, seed {case['seed']}, phase {case['failed_phase']}: "
                f"{case['failed_dv']:.2f} m/s {direction_name(case['angle'])}: {case['reason']}"
            )
            files.append(draw_fall(case["moments"], title, folder / f"push-failure-{name}.png"))
        return files
