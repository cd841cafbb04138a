"""Largest push that a standing robot takes without a step, beside the bound of the ankle strategy.

The bound is that of the linear inverted pendulum whose centre of pressure sits on the edge of the support from the
first instant on: a force F for a time T leaves the DCM on that edge when

    ``F = m w^2 d / (1 - exp(-w T))``,  ``w = sqrt(g / z)``,

with mass m [kg], CoM height z above the soles [m] and distance d [m] from the centre of pressure at rest to the edge of
the support polygon in the direction of the push. What exceeds it comes from moving arms, hips and torso. Beside it
stands the bound that the joints' torques leave of it (``torque_bound.py``).
"""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass as schema

from benchmarks.contender_loop import AnyLoop, ContenderLoop
from benchmarks.fall_plot import FAILED, PASSED
from benchmarks.harness import Case, LoadMeter, Options, Report, run_cases
from benchmarks.push_bounds import ankle_bound
from benchmarks.push_directions import angles, direction_name
from benchmarks.push_plot import PushMap, draw_map
from benchmarks.push_search import Search, largest
from benchmarks.torque_bound import torque_bound
from bridge.closed_loop import ClosedLoop
from bridge.stability import Balance, balance
from bridge.support_polygon import distance_along
from models.config import STRICT, default_config
from models.robot_model import RobotModel
from models.types import RobotState, Vector

Positive = Annotated[float, Field(gt=0.0)]


@schema(frozen=True, slots=True, config=STRICT)
class PushConfig:
    """The push test; the unit of every value stands in ``benchmarks/config/push.yaml``."""

    body: str
    directions: Annotated[int, Field(ge=1)]
    duration: Positive
    settle_time: Positive
    rest_time: Positive
    rest_samples: Annotated[int, Field(ge=1)]
    recover_time: Positive
    check_period: Positive
    first_ratio: Positive
    largest_ratio: Positive
    stride: Positive
    resolution: Positive
    com_tolerance: Positive
    speed_tolerance: Positive
    foot_tolerance: Positive
    required_ratio: Positive


@cache
def _loop(robot: str, contender: str = "") -> AnyLoop:
    """One loop for every push of this process; ``reset`` starts it over as a new one would."""
    return ContenderLoop(contender, robot) if contender else ClosedLoop(robot=robot, record=False)


@cache
def _config() -> PushConfig:
    return default_config(PushConfig, "benchmarks", "push")


def stance(model: RobotModel, truth: RobotState) -> Balance:
    """The balance of a robot's true state.

    Args:
        model: The robot.
        truth: Its exact state, contact wrenches included.
    """
    return balance(model, model.data(), truth.q, truth.v, [contact.wrench for contact in truth.contacts])


def survives(robot: str, seed: int, force: Vector, config: PushConfig, contender: str = "") -> bool:
    """Push a standing robot once.

    Args:
        robot: Name of the profile.
        seed: Seed of the sensor noise.
        force: Force in W (3,) [N].
        config: The push test.
        contender: Controller to test instead of poise's own.

    Returns:
        Whether it stays up, keeps both feet where they were and comes back to rest.
    """
    loop = _loop(robot, contender)
    loop.reset(seed)
    loop.run(config.settle_time)
    before = stance(loop.robot, loop.truth)
    loop.apply_push(tuple(force.tolist()), duration=config.duration, body=config.body)
    end = loop.t + config.duration + config.recover_time
    while loop.t < end - 1e-9:  # 1e-9: rounding of the simulated time
        loop.run(min(config.check_period, end - loop.t))
        now = stance(loop.robot, loop.truth)
        moved = float(np.linalg.norm(now.soles - before.soles, axis=1).max())
        if loop.fallen or moved > config.foot_tolerance:
            return False
    back = float(np.linalg.norm(now.com[:2] - before.com[:2])) < config.com_tolerance
    return back and float(np.linalg.norm(now.com_velocity)) < config.speed_tolerance


def bound_at_rest(loop: AnyLoop, direction: Vector, config: PushConfig) -> tuple[float, float]:
    """Let a standing robot stand for ``rest_time`` and compute its ankle bound.

    Args:
        loop: The robot, at rest.
        direction: Heading of the force in W (3,), a unit vector.
        config: The push test.

    Returns:
        The bound [N], and the distance from the mean centre of pressure to the edge in that direction [m].
    """
    cops = []
    for _ in range(config.rest_samples):
        loop.run(config.rest_time / config.rest_samples)
        rest = stance(loop.robot, loop.truth)
        cops.append(rest.cop)
    distance = distance_along(rest.polygon, np.mean(cops, axis=0), direction)
    height = float(rest.com[2] - rest.soles[:, 2].mean())
    return ankle_bound(loop.robot.mass, height, distance, config.duration), distance


def measure(robot: str, seed: int, angle: float, contender: str = "") -> Case:
    """Bisect the push in one direction.

    Args:
        robot: Name of the profile.
        seed: Seed of the sensor noise.
        angle: Heading of the force in W [rad].
        contender: Controller to test instead of poise's own.

    Returns:
        ``force``, ``bound`` and ``torque_bound`` [N], ``ratio`` and ``torque_ratio`` [-], ``dv`` and ``bound_dv``
        [m/s], ``mass`` [kg], ``distance`` [m], ``pushes`` [-].
    """
    config, loop = _config(), _loop(robot, contender)
    direction = np.array([math.cos(angle), math.sin(angle), 0.0])
    loop.reset(seed)
    loop.run(config.settle_time - config.rest_time)
    bound, distance = bound_at_rest(loop, direction, config)
    torques = torque_bound(loop.robot, loop.truth.q, direction, config.duration)
    search = Search(config.first_ratio, config.largest_ratio, config.stride, config.resolution)
    ratio, pushes = largest(lambda part: survives(robot, seed, part * bound * direction, config, contender), search)
    to_dv = config.duration / loop.robot.mass
    return {
        "force": ratio * bound,
        "bound": bound,
        "ratio": ratio,
        "torque_bound": torques,
        "torque_ratio": ratio * bound / torques,
        "dv": ratio * bound * to_dv,
        "bound_dv": bound * to_dv,
        "mass": loop.robot.mass,
        "distance": distance,
        "pushes": pushes,
    }


def run(options: Options) -> Report:
    """Bisect the push in every direction, or in those chosen, for every seed.

    Args:
        options: Robot, seeds, workers, contender, and directions by name.

    Returns:
        Figures ``dv_min``, ``dv_median`` (impulse over mass [m/s]), ``ratio_to_ankle_bound_min`` and
        ``..._median``, ``ratio_to_torque_bound_min`` and ``..._median`` [-], ``bound_dv_min`` and
        ``bound_dv_median`` [m/s].

    Raises:
        ConfigError: A chosen direction is unknown.
    """
    config, load = _config(), LoadMeter()
    cases: list[dict[str, Any]] = [
        {"robot": options.robot, "seed": seed, "angle": angle, "contender": options.contender}
        for seed in range(options.seeds)
        for angle in angles("push", config.directions, options.scenarios)
    ]
    results = run_cases(measure, cases, bench="push", options=options)
    dv, bound_dv, ratio = (np.array([case[key] for case in results]) for key in ("dv", "bound_dv", "ratio"))
    of_torques = np.array([case["torque_ratio"] for case in results])
    worst = int(np.argmin(ratio))
    heading = math.degrees(results[worst]["angle"])
    return Report(
        bench="push",
        robot=options.robot,
        seeds=options.seeds,
        figures={
            "dv_min": float(dv.min()),
            "dv_median": float(np.median(dv)),
            "ratio_to_ankle_bound_min": float(ratio.min()),
            "ratio_to_ankle_bound_median": float(np.median(ratio)),
            "ratio_to_torque_bound_min": float(of_torques.min()),
            "ratio_to_torque_bound_median": float(np.median(of_torques)),
            "bound_dv_min": float(bound_dv.min()),
            "bound_dv_median": float(np.median(bound_dv)),
        },
        cases=results,
        passed=bool(ratio.min() >= config.required_ratio),
        contender=options.contender,
        load=load.read(),
        notes=[
            f"weakest direction {heading:.0f} deg: {ratio[worst]:.2f} of the ankle bound "
            f"(required {config.required_ratio:.2f}), {results[worst]['force']:.0f} N for {config.duration} s"
        ],
    )


def push_map(report: Report) -> PushMap:
    """The map of what ``run`` found: impulse over mass against the direction of the push, with the ankle bound."""
    required = _config().required_ratio
    lines = (
        ("bound_dv", "ankle bound", {"color": "0.35", "linestyle": "--"}),
        ("required_dv", f"required: {required:g} of it", {"color": FAILED, "linewidth": 1.0}),
        ("dv", "taken without a step", {"color": PASSED, "marker": "o"}),
    )
    cases = [{**case, "required_dv": required * case["bound_dv"]} for case in report.cases]
    return PushMap(cases, lines, (), "pushed while standing, no step")


def plot(report: Report, folder: Path) -> list[Path]:
    """Draw the push map.

    Args:
        report: What ``run`` found.
        folder: Where the picture goes.

    Returns:
        The file written.
    """
    remarks = [f"{'pushed':<14}{'seed':>5}{'m/s':>7}{'N.s':>6}{'of the ankle bound':>20}"] + [
        f"{direction_name(case['angle']):<14}{case['seed']:>5}{case['dv']:7.2f}{case['dv'] * case['mass']:6.1f}"
        f"{case['ratio']:20.2f}"
        for case in report.cases
    ]
    return [draw_map(report, push_map(report), remarks, folder / f"push-{report.robot}.png")]
