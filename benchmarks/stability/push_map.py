"""Largest push that a robot survives with steps, standing or walking, compared with ankle and N-step bounds.

The result of a direction is the largest push that the robot survives at every tested moment (phases of the stride;
seeds if it stands), from one bisection over all moments. All controllers are judged by the true state only. A push is
survived if the robot does not fall, its legs do not touch, and at the end it stays in place, possibly with steps, or
walks on. The stride is the time between two touchdowns of the true left foot.
"""

import math
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass as schema

from benchmarks.core.benchmark import Benchmark, Bound, at_least, settings
from benchmarks.core.contender import ContenderLoop
from benchmarks.core.harness import Case, Options, Report
from benchmarks.core.loops import Search, advance, demand, largest
from benchmarks.stability.falls import FAILED, GOAL, PASSED, draw_fall, moments_since
from benchmarks.stability.legs import LegContact
from benchmarks.stability.push import PushMap, PushMode, angles, direction_name, draw_map, stance
from benchmarks.stability.push_bounds import ankle_bound, distance_with_steps
from bridge.closed_loop import ClosedLoop
from models.config import STRICT, Count, Fraction, Positive
from models.constants import GRAVITY
from models.errors import PoiseError
from models.heading import heading
from models.types import Matrix
from planners.gait.scaling import load_gait_config


@schema(frozen=True, slots=True, config=STRICT)
class Required:
    """Impulse over mass that passes, or is the goal, over all directions [m/s]."""

    smallest: Positive
    median: Positive


@schema(frozen=True, slots=True, config=STRICT)
class PushMapConfig:
    """Settings of the push test with steps; the units are in ``benchmarks/config/push_map.yaml``."""

    body: str
    directions: dict[PushMode, Count]
    phases: dict[PushMode, Count]
    first_seed: dict[PushMode, Annotated[int, Field(ge=0)]]
    duration: Positive
    stand_time: Positive
    walk_time: Positive
    walk_speed: Positive
    touchdown_load: Fraction
    air_time: Positive
    stride_max: Positive
    recover_time: Positive
    check_period: Positive
    first: Positive
    largest: Positive
    stride: Positive
    resolution: Positive
    rest_window: Positive
    rest_radius: Positive
    walk_window: Positive
    walk_share: Fraction
    bound_steps: Count
    record_period: Positive
    lead: Positive
    required: dict[PushMode, Required]
    goals: dict[PushMode, Required]


@dataclass(frozen=True, slots=True)
class Trial:
    """Push without its size."""

    mode: PushMode
    seed: int
    phase: int  #: Phase of the stride, out of ``phases``; added to the seed if the robot stands
    angle: float  #: Heading relative to the robot [rad]
    speed: float | None = None  #: Walking speed [m/s]; ``walk_speed`` when None


@dataclass(frozen=True, slots=True)
class Outcome:
    """Reason of a failure (empty if the robot survived), and simulated time of the push [s]."""

    reason: str
    pushed: float


map_config = partial(settings, PushMapConfig, "push_map")
LEFT = 0  #: Foot whose touchdowns time the push


@cache
def loop_of(robot: str, contender: str = "") -> ClosedLoop:
    """Return the closed loop for all pushes of this process; ``reset`` makes it equivalent to a new loop."""
    if contender:
        return ContenderLoop(contender, robot)
    return ClosedLoop(robot=robot, record_period_s=map_config().record_period)


legs_of = lru_cache(maxsize=2)(LegContact)


def prepare(loop: ClosedLoop, trial: Trial) -> None:
    """Bring a robot to the moment of its push; ``PoiseError`` if it falls or does not walk before it."""
    config, standing = map_config(), trial.mode is not PushMode.WALK
    loop.reset(trial.seed + (trial.phase if standing else 0))
    if trial.mode is not PushMode.CATCH:
        demand(loop, "walk")
    if standing:
        advance(loop, config.stand_time)
        return
    loop.set_velocity(config.walk_speed if trial.speed is None else trial.speed, 0.0, 0.0)
    advance(loop, config.walk_time)
    begin, end = (wait_touchdown(loop) for _ in range(2))
    advance(loop, (end - begin) * trial.phase / config.phases[trial.mode])


def wait_touchdown(loop: ClosedLoop) -> float:
    """Run until the true left foot lands; returns the time [s]. ``PoiseError`` after a fall or without a step."""
    config = map_config()
    load = config.touchdown_load * loop.robot.mass * GRAVITY
    end, lifted = loop.t + config.stride_max, loop.t
    while loop.t < end:
        if loop.plant.wrenches[LEFT, 2] > load:
            if loop.t - lifted >= config.air_time:
                return loop.t
            lifted = loop.t
        advance(loop, loop.plant.period)
    raise PoiseError(f"{loop.robot.name} does not walk before the push")


def survives(loop: ClosedLoop, trial: Trial, dv: float) -> Outcome:
    """Push a robot from ``prepare`` once with an impulse over mass ``dv`` [m/s]."""
    config, legs, pushed = map_config(), legs_of(loop.robot), loop.t
    angle = heading(*loop.truth.q[3:7]) + trial.angle
    force = loop.robot.mass * dv / config.duration
    loop.apply_push((force * math.cos(angle), force * math.sin(angle), 0.0), config.duration, config.body)
    end, places = pushed + config.duration + config.recover_time, [loop.truth.q[:2].copy()]
    while loop.t < end - 1e-9:  # 1e-9: rounding of the simulated time
        loop.run(config.check_period)
        if loop.fallen:
            return Outcome(loop.fall_reason, pushed)
        q = loop.truth.q
        if touching := legs.find(q):
            return Outcome(f"{LEGS_TOUCH}: {touching}", pushed)
        places.append(q[:2].copy())
    return Outcome(_ending(trial, np.array(places)), pushed)


LEGS_TOUCH = "legs touch"  #: Beginning of the reason


def _ending(trial: Trial, places: Matrix) -> str:
    """Return why a robot with these base positions (n, 2) [m] has not recovered; empty if it has."""
    config, walks = map_config(), trial.mode is PushMode.WALK
    window = config.walk_window if walks else config.rest_window
    ways = np.linalg.norm(places[-1] - places[-1 - round(window / config.check_period) :], axis=1)
    if walks:
        speed = config.walk_speed if trial.speed is None else trial.speed
        return "" if ways[0] > config.walk_share * speed * window else "does not continue to walk"
    return "" if ways.max() < config.rest_radius else f"moves {ways.max():.2f} m in the last {window:g} s"


def moments(loop: ClosedLoop, outcome: Outcome) -> Case:
    """Return ``moments_since`` shortly before the push; empty for a contender."""
    return {} if isinstance(loop, ContenderLoop) else moments_since(loop, outcome.pushed - map_config().lead)


#: Explanation of the figures below the table
MEANING = (
    "dv: impulse over mass [m/s] that is taken in every phase, impulse in [N.s]; ankle and steps: impulse over mass "
    "that a linear pendulum takes without and with steps"
)


def bounds(loop: ClosedLoop, trial: Trial) -> dict[str, float]:
    """Return the pendulum bounds ``ankle_dv`` and ``steps_dv``, impulse over mass [m/s]; 0 if the DCM is past the edge.

    The robot is from ``prepare``. Reach and step time are those of poise's gait, for every controller.
    """
    config = map_config()
    angle = heading(*loop.truth.q[3:7]) + trial.angle
    direction = np.array([math.cos(angle), math.sin(angle)])
    now = stance(loop.robot, loop.truth)
    loaded = [foot for foot in range(2) if loop.truth.contacts[foot].active] or [0, 1]
    height = float(now.com[2] - now.soles[loaded, 2].mean())
    omega = math.sqrt(GRAVITY / height)
    dcm = now.com[:2] + now.com_velocity[:2] / omega
    edges = np.full(2, -math.inf)
    edges[loaded] = (now.corners[loaded, :, :2] @ direction).max(axis=1) - dcm @ direction
    frame = np.array([math.cos(trial.angle), math.sin(trial.angle)])
    far = distance_with_steps(load_gait_config(loop.robot), omega, config.bound_steps, frame, (edges[0], edges[1]))
    mass = loop.robot.mass
    return {
        name: max(ankle_bound(mass, height, distance, config.duration), 0.0) * config.duration / mass
        for name, distance in (("ankle_dv", float(edges.max())), ("steps_dv", far))
    }


def measure(robot: str, mode: str, seed: int, angle: float, contender: str = "", size: float = 0.0) -> Case:
    """Bisect the push along a heading relative to the robot [rad]; ``reason`` belongs to ``failed_dv``.

    With ``size`` [m/s] only this push is tried, at every moment; ``dv`` is the size if all are survived, else 0.
    The result is 0 if the robot is not ready for the push at some moment.
    """
    config, loop = map_config(), loop_of(robot, contender)
    trials = [Trial(PushMode(mode), seed, phase, angle) for phase in range(config.phases[PushMode(mode)])]
    failed: dict[str, Any] = {"failed_dv": math.nan, "failed_phase": 0, "reason": "", "moments": {}}
    limits: list[dict[str, float]] = []

    def takes(trial: Trial, dv: float) -> bool:
        prepare(loop, trial)
        outcome = survives(loop, trial, dv)
        if outcome.reason:
            failed.update(failed_dv=dv, failed_phase=trial.phase, reason=outcome.reason)
            failed["moments"] = moments(loop, outcome)
        return not outcome.reason

    def holds(dv: float) -> bool:
        # Start with the moment that failed last, because it is the most likely to fail again.
        return all(takes(trial, dv) for trial in sorted(trials, key=lambda each: each.phase != failed["failed_phase"]))

    for trial in trials:
        try:
            prepare(loop, trial)
        except PoiseError as error:
            failed.update(failed_dv=0.0, failed_phase=trial.phase, reason=str(error))
            limits = [{"ankle_dv": 0.0, "steps_dv": 0.0}]
            break
        limits.append(bounds(loop, trial))
    dv, pushes, taken = 0.0, 0, 0
    if not failed["reason"] and size:
        pushes, taken = len(trials), sum(takes(trial, size) for trial in trials)
        dv = size if taken == pushes else 0.0
    elif not failed["reason"]:
        dv, pushes = largest(holds, Search(config.first, config.largest, config.stride, config.resolution))
    mass = loop.robot.mass
    return {
        "dv": dv,
        "impulse": dv * mass,
        "mass": mass,
        **{name: min(limit[name] for limit in limits) for name in limits[0]},
        "pushes": pushes,
        **({"taken": taken} if size else {}),
        **failed,
    }


def summarise(results: list[Case]) -> dict[str, float]:
    """Compute figures over directions from the smallest values of seeds and phases; ``legs_touched``: directions."""
    angles = sorted({case["angle"] for case in results})
    dv = np.array([min(case["dv"] for case in results if case["angle"] == angle) for angle in angles])
    figures = {
        "dv_min": float(dv.min()),
        "dv_median": float(np.median(dv)),
        "impulse_min": min(float(case["impulse"]) for case in results),
        "ankle_dv_min": min(case["ankle_dv"] for case in results),
        "steps_dv_min": min(case["steps_dv"] for case in results),
        "legs_touched": float(len({case["angle"] for case in results if LEGS_TOUCH in case["reason"]})),
    }
    if "taken" in results[0]:
        figures |= {name: float(sum(case[name] for case in results)) for name in ("taken", "pushes")}
        figures["directions_taken"] = float((dv > 0.0).sum())
    for bound in ("ankle", "steps"):
        limits = np.array([min(case[f"{bound}_dv"] for case in results if case["angle"] == angle) for angle in angles])
        # Excluded if the DCM was beyond the edge; the ratio is 0 if no push was survived.
        shown = (limits > 0.0) | (dv == 0.0)
        of_bound = dv[shown] / np.where(limits > 0.0, limits, 1.0)[shown]
        figures[f"ratio_to_{bound}_bound_min"] = float(of_bound.min()) if len(of_bound) else math.nan
        figures[f"ratio_to_{bound}_bound_median"] = float(np.median(of_bound)) if len(of_bound) else math.nan
    return figures


def case_lines(results: list[Case]) -> list[str]:
    """Return a line per direction and seed: survived push, and failure of the next larger push that was tried."""
    head = f"{'pushed':<14}{'seed':>5}{'m/s':>7}{'N.s':>6}   not taken"
    return [head] + [
        f"{direction_name(case['angle']):<14}{case['seed']:>5}{case['dv']:7.2f}{case['impulse']:6.1f}   "
        + (f"{case['failed_dv']:.2f} m/s, phase {case['failed_phase']}: {case['reason']}" if case["reason"] else "-")
        for case in results
    ]


def push_map(report: Report) -> PushMap:
    """Return the map of a report."""
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
    """Bisect the push in every direction, or in the selected ones, for every seed; one mode per report."""

    measure = staticmethod(measure)

    @property
    def mode(self) -> PushMode:
        """Task of the robot, from the name of the report."""
        return PushMode(self.name.removeprefix("push_"))

    def cases(self, options: Options) -> list[Case]:
        config, mode = map_config(), self.mode.value
        return [
            {"robot": options.robot, "mode": mode, "seed": seed, "angle": angle, "contender": options.contender}
            | ({"size": options.size} if options.size else {})
            for seed in options.each_seed(config.first_seed[self.mode])
            for angle in angles(config.directions[self.mode], options)
        ]

    def figures(self, cases: list[Case]) -> dict[str, float]:
        return summarise(cases)

    def bounds(self, report: Report) -> dict[str, Bound]:
        required = map_config().required[self.mode]
        if report.cases and (size := report.cases[0].get("size")):
            return at_least({"dv_min": size})
        return at_least({"dv_min": required.smallest, "dv_median": required.median})

    def notes(self, report: Report) -> list[str]:
        return [MEANING, *case_lines(report.cases), *super().notes(report)]

    def plots(self, report: Report, folder: Path) -> list[Path]:
        case = min(report.cases, key=lambda case: (case["dv"], case["angle"]))  # the smallest failed push
        name = f"{self.mode.value}-{report.stem}"
        files = [draw_map(report, push_map(report), case_lines(report.cases), folder / f"push-map-{name}.png")]
        if case["moments"]:
            title = (
                f"push, {self.mode.value}, {report.robot}, seed {case['seed']}, phase {case['failed_phase']}: "
                f"{case['failed_dv']:.2f} m/s {direction_name(case['angle'])}: {case['reason']}"
            )
            files.append(draw_fall(case["moments"], title, folder / f"push-failure-{name}.png"))
        return files
