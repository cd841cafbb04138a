"""Largest push that a standing robot survives without a step, compared with the bounds of ``push_bounds``."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cache, partial
from pathlib import Path
from typing import Any, cast

import numpy as np
from matplotlib.projections.polar import PolarAxes
from pydantic.dataclasses import dataclass as schema

from benchmarks.core.benchmark import Benchmark, Bound, at_least, saved, settings
from benchmarks.core.contender import ContenderLoop
from benchmarks.core.harness import Case, Options, Report
from benchmarks.core.loops import Search, largest
from benchmarks.stability.falls import FAILED, PASSED
from benchmarks.stability.push_bounds import ankle_bound, torque_bound
from bridge.analysis.plots import new_figure
from bridge.analysis.stability import Balance, balance, distance_along
from bridge.closed_loop import ClosedLoop
from controllers.balance.controller import BalanceController
from models.config import STRICT, Count, Positive
from models.errors import ConfigError
from models.robot_model import RobotModel
from models.types import RobotState, Vector


class PushMode(StrEnum):
    """Task of the robot during the push."""

    STAND = "stand"  #: Stands without a step
    CATCH = "catch"  #: Stands in mode 'stand' and may step
    STEP = "step"  #: Stands in mode 'walk' and may step
    WALK = "walk"  #: Walks


#: Headings of 0, 45, ... 315 deg, counter-clockwise
_NAMES = ("forward", "forward-left", "left", "back-left", "backward", "back-right", "right", "forward-right")


def direction_name(angle: float) -> str:
    """Return the name of a heading relative to the robot [rad]: a word for multiples of 45 deg, else degrees."""
    eighth = angle / (0.25 * math.pi)
    if abs(eighth - round(eighth)) < 1e-6:  # 1e-6: rounding
        return _NAMES[round(eighth) % len(_NAMES)]
    return f"{math.degrees(angle):.4g} deg"


def angles(usual: int, options: Options) -> list[float]:
    """Return headings [rad] in [0, 2 pi), ascending: the selected ones (words or degrees), or a grid.

    A grid is a number of evenly spread headings, and optionally the offset of the first from forward [deg]: ``16``, or
    ``8+22.5``. ``usual`` is the number without the option. Raises ``ConfigError`` for any other text.
    """
    number, _, offset = (options.directions or str(usual)).partition("+")
    count, first = _number(number), _number(offset or "0")
    if not (count >= 1.0 and count.is_integer() and math.isfinite(first)):
        raise ConfigError(
            f"--directions '{options.directions}': a grid is COUNT or COUNT+DEGREES, such as 16 or 8+22.5"
        )
    degrees = [first + 360.0 * k / count for k in range(int(count))]
    if options.scenarios:
        degrees = [
            45.0 * _NAMES.index(name) if name in _NAMES else _number(name.removesuffix("deg"))
            for name in options.scenarios
        ]
    for name, heading in zip(options.scenarios, degrees, strict=False):
        if not math.isfinite(heading):
            raise ConfigError(f"unknown direction '{name}'; known: {', '.join(_NAMES)}, or degrees to the left")
    return sorted({math.radians(heading % 360.0) for heading in degrees})


def _number(text: str) -> float:
    """Parse a number; NaN for any other text."""
    try:
        return float(text)
    except ValueError:
        return math.nan


RINGS = (0.25, 0.5)  #: Spacing of the rings of the map; the second if the first gives too many rings [m/s]
MOST_RINGS = 4  #: Maximum number of rings of a readable map
Line = tuple[str, str, dict[str, Any]]  #: Key of a case [m/s], label, and style of a closed line of the map
Circle = tuple[str, float, dict[str, Any]]  #: Label, value [m/s] and style of a limit that is equal in all directions


@dataclass(frozen=True, slots=True)
class PushMap:
    """Content of a push map."""

    #: Have ``angle`` [rad], ``mass`` [kg] and the keys of the lines; the smallest value of each angle is drawn
    cases: Sequence[Case]
    lines: Sequence[Line]  #: The last line is the survived push; its area is filled
    circles: Sequence[Circle]  #: Limits that are equal in all directions
    title: str  #: Task of the robot during the push


def draw_rings(axes: PolarAxes, shown: PushMap) -> None:
    """Draw impulse over mass [m/s] by direction, forward up; ring labels include the impulse [N.s]."""
    angles = sorted({case["angle"] for case in shown.cases})
    axes.set_theta_zero_location("N")  # forward is up
    for key, label, style in shown.lines:
        values = [min(case[key] for case in shown.cases if case["angle"] == angle) for angle in angles]
        ring = [*angles, angles[0]], [*values, values[0]]
        axes.plot(*ring, label=label, **style)
    axes.fill(*ring, color=style["color"], alpha=0.15)
    around = [2.0 * math.pi * k / 180 for k in range(181)]
    for label, value, style in shown.circles:
        axes.plot(around, [value] * len(around), linewidth=1.2, label=f"{label}: {value:g} m/s", **style)
    reach = 1.05 * max(axes.dataLim.y1, *(value for _, value, _ in shown.circles), RINGS[-1])
    step = next((ring for ring in RINGS if reach / ring <= MOST_RINGS), RINGS[-1])
    mass = shown.cases[0]["mass"]
    ticks = [step * (k + 1) for k in range(int(0.97 * reach / step))]  # none on the rim
    axes.set_ylim(0.0, reach)
    axes.set_yticks(ticks, [f"{tick:.2g} m/s\n{tick * mass:.0f} N.s" for tick in ticks], fontsize=7)
    for text in axes.get_yticklabels():
        text.set_bbox({"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 0.5})
    axes.set_rlabel_position(180.0 / len(angles))  # between two directions
    axes.set_xticks(angles, [direction_name(angle) for angle in angles], fontsize=9)


def draw_map(report: Report, shown: PushMap, remarks: Sequence[str], file: Path) -> Path:
    """Plot a map with remarks below; returns the file."""
    figure = new_figure(9.5, 7.0 + 0.14 * len(remarks))
    grid = figure.add_gridspec(2, 2, height_ratios=[7.0, 0.14 * len(remarks)], width_ratios=[7.0, 2.5])
    axes = cast(PolarAxes, figure.add_subplot(grid[0, 0], projection="polar"))
    draw_rings(axes, shown)
    axes.tick_params(axis="x", pad=12)
    figure.suptitle(
        f"{report.who}, {shown.title}, seeds: {report.seeds}. "
        f"Impulse of a push at the pelvis over mass ({shown.cases[0]['mass']:.1f} kg), by direction",
        fontsize=10,
    )
    figure.legend(*axes.get_legend_handles_labels(), loc="upper right", bbox_to_anchor=(0.995, 0.94), fontsize=8)
    below = figure.add_subplot(grid[1, :])
    below.axis("off")
    below.text(0.0, 1.0, "\n".join(remarks), family="monospace", fontsize=7, va="top", transform=below.transAxes)
    return saved(figure, file)


@schema(frozen=True, slots=True, config=STRICT)
class PushConfig:
    """Settings of the push test; the units are in ``benchmarks/config/push.yaml``."""

    body: str
    directions: Count
    duration: Positive
    settle_time: Positive
    rest_time: Positive
    rest_samples: Count
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
def _loop(robot: str, contender: str = "") -> ClosedLoop:
    if contender:
        return ContenderLoop(contender, robot)
    loop = ClosedLoop(robot=robot, record=False)
    if isinstance(loop.controller, BalanceController):
        loop.controller.no_step = True
    return loop


_config = partial(settings, PushConfig, "push")


def stance(model: RobotModel, truth: RobotState) -> Balance:
    """Return the balance of a robot's true state, including contact wrenches."""
    return balance(model, model.data(), truth.q, truth.v, [contact.wrench for contact in truth.contacts])


def survives(robot: str, seed: int, force: Vector, config: PushConfig, contender: str = "") -> bool:
    """Whether a standing robot, pushed with a force in W (3,) [N], stays up, does not move its feet and rests again."""
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
    returned = float(np.linalg.norm(now.com[:2] - before.com[:2])) < config.com_tolerance
    return returned and float(np.linalg.norm(now.com_velocity)) < config.speed_tolerance


def bound_at_rest(loop: ClosedLoop, direction: Vector, config: PushConfig) -> tuple[float, float]:
    """Return ankle bound [N] and distance from CoP to edge [m] along a unit vector in W (3,), after ``rest_time``."""
    cops = []
    for _ in range(config.rest_samples):
        loop.run(config.rest_time / config.rest_samples)
        rest = stance(loop.robot, loop.truth)
        cops.append(rest.cop)
    distance = distance_along(rest.polygon, np.mean(cops, axis=0), direction)
    height = float(rest.com[2] - rest.soles[:, 2].mean())
    return ankle_bound(loop.robot.mass, height, distance, config.duration), distance


def measure(robot: str, seed: int, angle: float, contender: str = "") -> Case:
    """Bisect the push along a heading in W [rad]: forces and bounds [N], as ``dv`` [m/s], and ratios."""
    config, loop = _config(), _loop(robot, contender)
    direction = np.array([math.cos(angle), math.sin(angle), 0.0])
    loop.reset(seed)
    loop.run(config.settle_time - config.rest_time)
    bound, distance = bound_at_rest(loop, direction, config)
    limit = torque_bound(loop.robot, loop.truth.q, direction, config.duration)
    search = Search(config.first_ratio, config.largest_ratio, config.stride, config.resolution)
    ratio, pushes = largest(lambda part: survives(robot, seed, part * bound * direction, config, contender), search)
    to_dv = config.duration / loop.robot.mass
    return {
        "force": ratio * bound,
        "bound": bound,
        "ratio": ratio,
        "torque_bound": limit,
        "torque_ratio": ratio * bound / limit,
        "dv": ratio * bound * to_dv,
        "bound_dv": bound * to_dv,
        "mass": loop.robot.mass,
        "distance": distance,
        "pushes": pushes,
    }


def push_map(report: Report) -> PushMap:
    """Return the map of a report: impulse over mass by direction, with the ankle bound."""
    required = _config().required_ratio
    lines = (
        ("bound_dv", "ankle bound", {"color": "0.35", "linestyle": "--"}),
        ("required_dv", f"required: {required:g} of it", {"color": FAILED, "linewidth": 1.0}),
        ("dv", "taken without a step", {"color": PASSED, "marker": "o"}),
    )
    cases = [{**case, "required_dv": required * case["bound_dv"]} for case in report.cases]
    return PushMap(cases, lines, (), "pushed while standing, no step")


class Push(Benchmark):
    """Bisect the push in every direction, or in the selected ones, for every seed."""

    measure = staticmethod(measure)

    def cases(self, options: Options) -> list[Case]:
        if options.size:
            raise ConfigError(
                "bench push --mode stand has no --size: it searches relative to the ankle bound; use another --mode"
            )
        return [
            {"robot": options.robot, "seed": seed, "angle": angle, "contender": options.contender}
            for seed in options.each_seed()
            for angle in angles(_config().directions, options)
        ]

    def figures(self, cases: list[Case]) -> dict[str, float]:
        """Return weakest and median impulse over mass [m/s], and its ratios to ankle and torque bounds [-]."""
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
        return at_least({"ratio_to_ankle_bound_min": _config().required_ratio})

    def notes(self, report: Report) -> list[str]:
        config, worst = _config(), min(report.cases, key=lambda case: case["ratio"])
        return [
            f"weakest direction {math.degrees(worst['angle']):.0f} deg: {worst['ratio']:.2f} of the ankle bound "
            f"(required {config.required_ratio:.2f}), {worst['force']:.0f} N for {config.duration} s"
        ]

    def plots(self, report: Report, folder: Path) -> list[Path]:
        remarks = [f"{'pushed':<14}{'seed':>5}{'m/s':>7}{'N.s':>6}{'of the ankle bound':>20}"] + [
            f"{direction_name(case['angle']):<14}{case['seed']:>5}{case['dv']:7.2f}{case['dv'] * case['mass']:6.1f}"
            f"{case['ratio']:20.2f}"
            for case in report.cases
        ]
        return [draw_map(report, push_map(report), remarks, folder / f"push-{report.stem}.png")]
