"""One minute of quiet standing, including the start, and motions while pushed; every seed must hold every bound."""

import math
from functools import cache, partial
from typing import Any

import numpy as np
from pydantic.dataclasses import dataclass as schema

from benchmarks.core.benchmark import Benchmark, Bound, at_least, at_most, settings
from benchmarks.core.harness import Case, Options, Report
from benchmarks.stability.push import PushConfig, bound_at_rest, stance
from bridge.closed_loop import ClosedLoop
from models.config import STRICT, Positive, Proportion
from models.types import Mode


@schema(frozen=True, slots=True, config=STRICT)
class StandConfig:
    """Settings of the standing test; the units are in ``benchmarks/config/stand.yaml``."""

    duration: Positive
    start_time: Positive
    chunk: Positive
    com_drift_limit: Positive
    foot_slide_limit: Positive
    joint_speed_limit: Positive
    base_drop_limit: Positive
    torque_step_limit: Positive
    motions: tuple[str, ...]
    push_ratio: Positive
    push_window: tuple[Proportion, Proportion]
    recover_time: Positive


_config = partial(settings, StandConfig, "stand")

#: Figure of the worst seed, by quantity of a case
FIGURES = {
    "com_drift": "com_drift_max_m",
    "foot_slide": "foot_slide_max_m",
    "joint_speed": "joint_speed_mean_max_rad_s",
    "base_drop": "base_drop_max_m",
    "torque_step": "torque_step_max",
}


def _limits() -> dict[str, float]:
    return {name: getattr(_config(), f"{name}_limit") for name in FIGURES}


_push_config = partial(settings, PushConfig, "push")


@cache
def _loop(robot: str, record: bool) -> ClosedLoop:
    return ClosedLoop(robot=robot, record=record, record_period_s=0.001)


def stand(robot: str, seed: int) -> Case:
    """Release a robot and let it stand; ``ok`` if it does not fall and all bounds hold."""
    config, loop = _config(), _loop(robot, True)
    loop.reset(seed)
    model, log = loop.robot, loop.log
    released = next(t for t, text in loop.events if text == "released")
    at_release = loop.truth
    com = stance(model, at_release).com
    drift = drop = step = speed_sum = 0.0
    samples, tau = 0, log.tau[:1].copy()
    while loop.t < released + config.duration - 1e-9 and not loop.fallen:  # 1e-9: rounding of the simulated time
        loop.run(config.chunk)
        after = log.t >= released
        drift = max(drift, float(np.linalg.norm(log.true_com[after, :2] - com[:2], axis=1).max()))
        speed = np.abs(log.true_v[after, 6:])
        speed_sum, samples = speed_sum + float(speed.sum()), samples + speed.size
        if log.t[0] <= released + config.start_time:
            drop = max(drop, float(at_release.q[2] - log.true_q[after, 2].min()))
            steps = np.abs(np.diff(np.vstack([tau, log.tau]), axis=0))
            step = max(step, float((steps / (model.tau_rate_max * loop.plant.period)).max()))
        tau = log.tau[-1:].copy()
        log.clear()
    found = {
        "com_drift": drift,
        "foot_slide": float(loop.foot_slip.max()),
        "base_drop": drop,
        "joint_speed": speed_sum / samples,
        "torque_step": step,
    }
    ok = not loop.fallen and all(found[name] < limit for name, limit in _limits().items())
    return {"stood": not loop.fallen, **found, "ok": ok}


def motion(robot: str, seed: int, motion: str, angle: float) -> Case:
    """Push a robot in a motion, at a time drawn by the seed, along ``angle`` in W [rad]; ``ok`` without ``reason``."""
    config, push, loop = _config(), _push_config(), _loop(robot, False)
    direction = np.array([math.cos(angle), math.sin(angle), 0.0])
    loop.reset(seed)
    loop.run(push.settle_time - push.rest_time)
    force = config.push_ratio * bound_at_rest(loop, direction, push)[0] * direction
    before = stance(loop.robot, loop.truth)

    push_at = float(np.random.default_rng(seed).uniform(*config.push_window)) * _motion_duration(robot, motion)
    reply = loop.command(motion)
    loop.run(push_at)
    pushed_in_motion = loop.mode is Mode.MOTION
    loop.apply_push(force, push.duration, push.body)
    ended = reply.accepted and loop.wait_motion()
    loop.run(push.duration + config.recover_time)
    now = stance(loop.robot, loop.truth)
    foot = float(np.linalg.norm(now.soles - before.soles, axis=1).max())
    error = float(np.linalg.norm(now.com[:2] - before.com[:2]))
    reasons = [
        (not reply.accepted, reply.reason),
        (loop.fallen, loop.fall_reason),
        (not ended, f"the motion did not end: mode {loop.mode.value} {'; '.join(loop.faults)}"),
        (not pushed_in_motion, "the push was not during the motion"),
        (foot > push.foot_tolerance, f"a foot moved {foot:.3f} m"),
        (error > push.com_tolerance, f"the CoM remained {error:.3f} m from its start"),
        (float(np.linalg.norm(now.com_velocity)) > push.speed_tolerance, "not at rest at the end"),
    ]
    reason = next((text for failed, text in reasons if failed), "")
    return {
        "force": float(np.linalg.norm(force)),
        "push_at": push_at,
        "foot_moved": foot,
        "com_error": error,
        "reason": reason,
        "ok": not reason,
    }


@cache
def _motion_duration(robot: str, name: str) -> float:
    """Return the duration of a motion from the standing posture [s]."""
    from planners.motion import MotionPlanner

    model = _loop(robot, False).robot
    return float(MotionPlanner(model).plan(name, start_q=model.posture("stand")).times[-1])


def _measure(kind: str, **inputs: Any) -> Case:
    return stand(**inputs) if kind == "stand" else motion(**inputs)


class Stand(Benchmark):
    """Stand for a minute, and run each motion with a push, once per seed; the seed selects the push direction."""

    measure = staticmethod(_measure)

    def cases(self, options: Options) -> list[Case]:
        turn, seeds = 2.0 * math.pi / _push_config().directions, options.each_seed()
        cases: list[Case] = [{"kind": "stand", "robot": options.robot, "seed": seed} for seed in seeds]
        for name in _config().motions:
            for seed in seeds:
                angle = turn * (seed % _push_config().directions)
                cases.append({"kind": "motion", "robot": options.robot, "seed": seed, "motion": name, "angle": angle})
        return cases

    def figures(self, cases: list[Case]) -> dict[str, float]:
        """Return ``stood`` and ``motions_survived`` with their totals, and the worst value of each bounded quantity."""
        stood = [case for case in cases if case["kind"] == "stand"]
        moved = [case for case in cases if case["kind"] == "motion"]
        return {
            "stood": float(sum(case["ok"] for case in stood)),
            "stand_total": float(len(stood)),
            "motions_survived": float(sum(case["ok"] for case in moved)),
            "motions_total": float(len(moved)),
            **{figure: max(case[name] for case in stood) for name, figure in FIGURES.items()},
            "motion_com_error_max_m": max(case["com_error"] for case in moved),
        }

    def bounds(self, report: Report) -> dict[str, Bound]:
        totals = {"stood": "stand_total", "motions_survived": "motions_total"}
        return at_least({name: report.figures[total] for name, total in totals.items()}) | at_most(
            {FIGURES[name]: limit for name, limit in _limits().items()}
        )

    def notes(self, report: Report) -> list[str]:
        return [f"failed: {case}" for case in report.cases if not case["ok"]][:10]

    def survived(self, case: Case) -> tuple[str, bool]:
        return case.get("motion", "quiet"), bool(case["ok"])
