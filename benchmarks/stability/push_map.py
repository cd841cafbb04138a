"""Largest push that a robot takes with steps, standing or walking, beside the bounds of ankles and of N steps.

The figure of a direction is the largest push that it takes at every moment tried (phases of the stride; standing,
seeds): a bisection on all of them at once. A push is taken when the robot does not fall, its legs do not intersect, and
some seconds later it stands still, or walks on.
"""

import math
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Any

import coal
import numpy as np
import pinocchio as pin
from pydantic import Field
from pydantic.dataclasses import dataclass as schema

from benchmarks.core.benchmark import Benchmark, Bound, at_least, settings
from benchmarks.core.harness import Case, Options, Report
from benchmarks.core.loops import Search, demand, largest
from benchmarks.stability.falls import FAILED, GOAL, PASSED, draw_fall, moments_since
from benchmarks.stability.push import PushMap, PushMode, angles, direction_name, draw_map, stance
from benchmarks.stability.push_bounds import ankle_bound, distance_with_steps
from bridge.closed_loop import ClosedLoop
from models.config import STRICT, Count, Fraction, NonNegative, Positive, default_config
from models.constants import GRAVITY
from models.errors import ConfigError, PoiseError
from models.heading import heading
from models.robot_model import RobotModel
from models.types import Mode, Vector
from planners.collision import SelfCollision
from planners.motion_config import MotionConfig


class LegClearance:
    """Least distance between the legs: convex hulls of their bodies, and boxes of ``thickness`` [m] on the soles."""

    def __init__(self, robot: RobotModel, thickness: float) -> None:
        self._robot = robot
        self._hulls = SelfCollision(robot, default_config(MotionConfig, "planners", "motion").collision)
        legs = [
            set(robot.pin.supports[robot.pin.frames[foot.frame_id].parentJoint].tolist()[2:]) for foot in robot.feet
        ]
        joints = [body.parentJoint for body in self._hulls.geometry.geometryObjects]
        between = []
        for k in range(self._hulls.count):
            first, second = (joints[i] for i in self._hulls.bodies(k))
            between.append((first in legs[0] and second in legs[1]) or (first in legs[1] and second in legs[0]))
        self._between = np.array(between)
        self._data = robot.data()
        self._boxes, self._places = [], []
        for foot in robot.feet:
            back, front, right, left = foot.rectangle
            self._boxes.append(coal.Box(front - back, left - right, thickness))
            middle = np.array([0.5 * (back + front), 0.5 * (left + right), 0.5 * thickness])
            self._places.append(pin.SE3(np.eye(3), middle))

    def distance(self, q: Vector) -> float:
        """Least distance at a configuration (nq,) [m]: negative when legs overlap, infinite when far apart."""
        hulls = self._hulls.distances(q, 0.0)[self._between]
        pin.framesForwardKinematics(self._robot.pin, self._data, q)
        poses = [
            self._data.oMf[foot.frame_id] * place for foot, place in zip(self._robot.feet, self._places, strict=True)
        ]
        transforms = [coal.Transform3s(pose.rotation, pose.translation) for pose in poses]
        result = coal.DistanceResult()
        soles = coal.distance(
            self._boxes[0], transforms[0], self._boxes[1], transforms[1], coal.DistanceRequest(), result
        )
        return min(float(soles), float(hulls.min(initial=np.inf)))


@schema(frozen=True, slots=True, config=STRICT)
class Required:
    """Impulse over mass that passes, or is the goal, of all directions [m/s]."""

    smallest: Positive
    median: Positive


@schema(frozen=True, slots=True, config=STRICT)
class PushMapConfig:
    """The push test with steps; the unit of every value stands in ``benchmarks/config/push_map.yaml``."""

    body: str
    directions: dict[PushMode, Count]
    phases: dict[PushMode, Count]
    first_seed: dict[PushMode, Annotated[int, Field(ge=0)]]
    duration: Positive
    stand_time: Positive
    walk_time: Positive
    walk_speed: Positive
    recover_time: Positive
    check_period: Positive
    first: Positive
    largest: Positive
    stride: Positive
    resolution: Positive
    speed_tolerance: Positive
    overlap_tolerance: NonNegative
    sole_thickness: Positive
    walk_window: Positive
    walk_share: Fraction
    bound_steps: Count
    record_period: Positive
    lead: Positive
    required: dict[PushMode, Required]
    goals: dict[PushMode, Required]


@dataclass(frozen=True, slots=True)
class Trial:
    """One push without its size: phase of the stride (standing: added to the seed), heading from the robot [rad]."""

    robot: str
    mode: PushMode
    seed: int
    phase: int
    angle: float


@dataclass(frozen=True, slots=True)
class Outcome:
    """Why a push was not taken (empty when it was), and the simulated time of the push [s]."""

    reason: str
    pushed: float


map_config = partial(settings, PushMapConfig, "push_map")


@cache
def loop_of(robot: str) -> ClosedLoop:
    """One closed loop for every push of this process; ``reset`` starts it over as a new one would."""
    return ClosedLoop(robot=robot, record_period_s=map_config().record_period)


@cache
def legs_of(robot: str) -> LegClearance:
    """The clearance of a robot's legs, for every push of this process."""
    return LegClearance(loop_of(robot).robot, map_config().sole_thickness)


def prepare(trial: Trial) -> ClosedLoop:
    """Bring a robot to the moment of its push; ``PoiseError`` when it falls, or does not walk, without one."""
    config, loop = map_config(), loop_of(trial.robot)
    standing = trial.mode is not PushMode.WALK
    loop.reset(trial.seed + (trial.phase if standing else 0))
    if trial.mode is not PushMode.CATCH:
        demand(loop, "walk")
    if standing:
        loop.run(config.stand_time)
        return loop
    loop.set_velocity(config.walk_speed, 0.0, 0.0)
    loop.run(config.walk_time)
    stride = 2.0 * loop.gait.state.pace.period
    end, was = loop.t + 2.0 * stride, True
    while True:  # until the left foot lifts
        lift_off = loop.gait.view.swinging and loop.gait.stance == 1
        if lift_off and not was:
            break
        was = lift_off
        if loop.t > end or loop.fallen:
            raise PoiseError(f"{trial.robot} does not walk at {config.walk_speed} m/s before it is pushed")
        loop.step()
    loop.run(stride * trial.phase / config.phases[trial.mode])
    return loop


def survives(loop: ClosedLoop, trial: Trial, dv: float) -> Outcome:
    """Push once, by an impulse over mass ``dv`` [m/s], a robot from ``prepare``."""
    config, legs, pushed = map_config(), legs_of(trial.robot), loop.t
    angle = heading(*loop.truth.q[3:7]) + trial.angle
    force = loop.robot.mass * dv / config.duration
    loop.apply_push((force * math.cos(angle), force * math.sin(angle), 0.0), config.duration, config.body)
    end, places = pushed + config.duration + config.recover_time, [loop.truth.q[:2].copy()]
    while loop.t < end - 1e-9:  # 1e-9: rounding of the simulated time
        loop.run(config.check_period)
        if loop.fallen:
            return Outcome(loop.fall_reason, pushed)
        if legs.distance(loop.truth.q) < -config.overlap_tolerance:
            return Outcome("the legs run through each other", pushed)
        places.append(loop.truth.q[:2].copy())
    return Outcome(_ending(trial, loop, places), pushed)


def moments(loop: ClosedLoop, outcome: Outcome) -> Case:
    """What explains how a push ended, from shortly before it on; see ``moments_since``."""
    return moments_since(loop, outcome.pushed - map_config().lead)


def _ending(trial: Trial, loop: ClosedLoop, places: list[Vector]) -> str:
    """Why the end of a trial is not what it has to be; empty when it is."""
    config = map_config()
    if trial.mode is PushMode.WALK:
        window = min(round(config.walk_window / config.check_period), len(places) - 1)
        moved = float(np.linalg.norm(places[-1] - places[-1 - window]))
        return "" if moved > config.walk_share * config.walk_speed * config.walk_window else "does not walk on"
    speed = float(np.linalg.norm(stance(loop.robot, loop.truth).com_velocity))
    if loop.gait.walking:
        return "still steps"
    if trial.mode is PushMode.CATCH and loop.mode is not Mode.STAND:
        return f"ends in mode '{loop.mode.value}'"
    return "" if speed < config.speed_tolerance else f"CoM still moves at {speed:.2f} m/s"


#: What the figures are, for the reader of the table
MEANING = (
    "dv: impulse over mass [m/s] that is taken in every phase, impulse in [N.s]; ankle and steps: what a linear "
    "pendulum takes without and with steps"
)


def bounds(trial: Trial) -> dict[str, float]:
    """Impulses over mass ``ankle_dv`` and ``steps_dv`` that the pendulum takes [m/s]; 0 with the DCM past the edge."""
    config, loop = map_config(), prepare(trial)
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
    far = distance_with_steps(loop.gait.config, omega, config.bound_steps, frame, (edges[0], edges[1]))
    mass = loop.robot.mass
    return {
        name: max(ankle_bound(mass, height, distance, config.duration), 0.0) * config.duration / mass
        for name, distance in (("ankle_dv", float(edges.max())), ("steps_dv", far))
    }


def measure(robot: str, mode: str, seed: int, angle: float) -> Case:
    """Bisect the push in one direction, from the robot's heading [rad]; ``reason`` is that of ``failed_dv``."""
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
    """Figures over the directions, each the smallest of its seeds and phases; ``legs_touched`` counts directions."""
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
        if options.contender:
            raise ConfigError("a contender is pushed in mode 'stand' only: the others look into poise's gait")
        config, first = map_config(), map_config().first_seed[self.mode]
        return [
            {"robot": options.robot, "mode": self.mode.value, "seed": seed, "angle": angle}
            for seed in range(first, first + options.seeds)
            for angle in angles(self.name, config.directions[self.mode], options.scenarios)
        ]

    def figures(self, cases: list[Case]) -> dict[str, float]:
        return summarise(cases)

    def bounds(self, report: Report) -> dict[str, Bound]:
        required = map_config().required[self.mode]
        return at_least({"dv_min": required.smallest, "dv_median": required.median})

    def notes(self, report: Report) -> list[str]:
        return [MEANING, *case_lines(report.cases), *super().notes(report)]

    def plots(self, report: Report, folder: Path) -> list[Path]:
        case = min(report.cases, key=lambda case: (case["dv"], case["angle"]))  # the smallest push not taken
        name = f"{self.mode.value}-{report.robot}"
        files = [draw_map(report, push_map(report), case_lines(report.cases), folder / f"push-map-{name}.png")]
        if case["moments"]:
            title = (
                f"push, {self.mode.value}, {report.robot}, seed {case['seed']}, phase {case['failed_phase']}: "
                f"{case['failed_dv']:.2f} m/s {direction_name(case['angle'])}: {case['reason']}"
            )
            files.append(draw_fall(case["moments"], title, folder / f"push-failure-{name}.png"))
        return files
