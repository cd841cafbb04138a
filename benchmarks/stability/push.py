"""Largest push that a standing robot takes without a step, beside the bound of the ankle strategy.

The bound is ``push_bounds.ankle_bound`` with the distance from the centre of pressure at rest to the edge of the
support polygon in the direction of the push. What exceeds it comes from moving arms, hips and torso. Beside it stands
the bound that the joints' torques leave of it (``torque_bound.py``).
"""

from __future__ import annotations

import math
from functools import cache, partial
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass as schema

from benchmarks.core.benchmark import Benchmark, Bound, Positive, at_least, settings
from benchmarks.core.contender_loop import AnyLoop, ContenderLoop
from benchmarks.core.harness import Case, Options, Report
from benchmarks.core.loops import Search, largest
from benchmarks.stability.fall_plot import FAILED, PASSED
from benchmarks.stability.push_bounds import ankle_bound
from benchmarks.stability.push_plot import PushMap, angles, direction_name, draw_map
from benchmarks.stability.torque_bound import torque_bound
from bridge.closed_loop import ClosedLoop
from bridge.stability import Balance, balance, distance_along
from controllers.balance.controller import BalanceController
from models.config import STRICT
from models.robot_model import RobotModel
from models.types import RobotState, Vector


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
    if contender:
        return ContenderLoop(contender, robot)
    loop = ClosedLoop(robot=robot, record=False)
    if isinstance(loop.controller, BalanceController):
        loop.controller.no_step = True
    return loop


_config = partial(settings, PushConfig, "push")


def stance(model: RobotModel, truth: RobotState) -> Balance:
    """Balance of a robot's true state, contact wrenches included."""
    return balance(model, model.data(), truth.q, truth.v, [contact.wrench for contact in truth.contacts])


def survives(robot: str, seed: int, force: Vector, config: PushConfig, contender: str = "") -> bool:
    """Push a standing robot once with a force in W (3,) [N].

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
    """Let a standing robot rest for ``rest_time`` and compute its ankle bound along a unit vector in W (3,).

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
    """Bisect the push in one direction, a heading in W [rad].

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


class Push(Benchmark):
    """Bisect the push in every direction, or in those chosen, for every seed."""

    measure = staticmethod(measure)

    def cases(self, options: Options) -> list[Case]:
        """Every direction of every seed."""
        return [
            {"robot": options.robot, "seed": seed, "angle": angle, "contender": options.contender}
            for seed in range(options.seeds)
            for angle in angles(self.name, _config().directions, options.scenarios)
        ]

    def figures(self, cases: list[Case]) -> dict[str, float]:
        """Impulse over mass [m/s] and its ratio to the bounds of ankles and torques [-]: weakest and median."""
        columns = {
            "dv": "dv",
            "ratio_to_ankle_bound": "ratio",
            "ratio_to_torque_bound": "torque_ratio",
            "bound_dv": "bound_dv",
        }
        figures: dict[str, float] = {}
        for name, key in columns.items():
            values = np.array([case[key] for case in cases])
            figures |= {f"{name}_min": float(values.min()), f"{name}_median": float(np.median(values))}
        return figures

    def bounds(self, report: Report) -> dict[str, Bound]:
        """The least part of the ankle bound."""
        return at_least({"ratio_to_ankle_bound_min": _config().required_ratio})

    def notes(self, report: Report) -> list[str]:
        """The weakest direction."""
        config, worst = _config(), min(report.cases, key=lambda case: case["ratio"])
        return [
            f"weakest direction {math.degrees(worst['angle']):.0f} deg: {worst['ratio']:.2f} of the ankle bound "
            f"(required {config.required_ratio:.2f}), {worst['force']:.0f} N for {config.duration} s"
        ]

    def plots(self, report: Report, folder: Path) -> list[Path]:
        """Draw the push map."""
        remarks = [f"{'pushed':<14}{'seed':>5}{'m/s':>7}{'N.s':>6}{'of the ankle bound':>20}"] + [
            f"{direction_name(case['angle']):<14}{case['seed']:>5}{case['dv']:7.2f}{case['dv'] * case['mass']:6.1f}"
            f"{case['ratio']:20.2f}"
            for case in report.cases
        ]
        return [draw_map(report, push_map(report), remarks, folder / f"push-{report.robot}.png")]
