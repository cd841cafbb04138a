"""The figures of a report beside what physics or the machine allows, as ratios; see docs/limits.md."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from benchmarks.harness import Case, Report
from benchmarks.push_directions import direction_name
from benchmarks.report_pushes import DOING
from benchmarks.report_style import Reports


@dataclass(frozen=True, slots=True)
class Limited:
    """A figure and its limit.

    Attributes:
        what: The figure.
        robot: Whose.
        measured: It, in the unit of the limit.
        limit: Name of the limit.
        value: Of the limit.
        unit: Of both.
        ratio: Of the figure to the limit [-].
    """

    what: str
    robot: str
    measured: float
    limit: str
    value: float
    unit: str
    ratio: float


PUSH_LIMITS = {
    "push": (("ankle bound", "bound_dv"), ("torque-limited bound", "torque_bound_dv")),
    "push_step": (("ankle bound", "ankle_dv"), ("N-step capturability", "steps_dv")),
    "push_walk": (("ankle bound", "ankle_dv"), ("N-step capturability", "steps_dv")),
}
"""Name and key [m/s] of the limits of each push benchmark."""

TIME_LIMITS = {
    "tick": (("whole-body tick, standing, median", "tick_us_p50", "bare Pinocchio calls", "pinocchio_calls_us_p50"),),
    "gait": (
        ("whole-body tick, single support, median", "tick_us_p50", "bare Pinocchio calls", "pinocchio_calls_us_p50"),
    ),
    "loop": (
        ("tick of the closed loop, walking, mean", "tick_walk_us_mean", "MuJoCo's step alone", "bare_physics_walk_us"),
    ),
    "latency": (
        ("sensors to command over ROS 2, median", "p50_us", "ping-pong of the same messages", "floor_p50_us"),
        ("sensors to command over ROS 2, p99", "p99_us", "ping-pong of the same messages", "floor_p99_us"),
    ),
}
"""What it is, its figure, its limit and that one's figure [us], of the benchmarks of time."""


def limited(reports: Reports) -> list[Limited]:
    """Every figure of some reports that has a limit."""
    return [
        row
        for (bench, robot), report in reports.items()
        for row in (_pushes(robot, report) if bench in PUSH_LIMITS else _times(robot, report))
    ]


def _pushes(robot: str, report: Report) -> Iterator[Limited]:
    """The direction that is nearest to its limit, from below or least above."""
    for limit, key in PUSH_LIMITS[report.bench]:
        found = [(case, _limit(case, key)) for case in report.cases]
        ratios = [(case["dv"] / value, case, value) for case, value in found if value > 0.0]
        if ratios:  # none where the DCM was beyond the edge already
            ratio, case, value = min(ratios, key=lambda row: row[0])
            what = f"push, {DOING[report.bench]}, weakest against it: {direction_name(case['angle'])}"
            yield Limited(what, robot, case["dv"], limit, value, "m/s", ratio)


def _limit(case: Case, key: str) -> float:
    """A limit of a push as impulse over mass [m/s]; cases keep that of the torques as a force."""
    return float(case[key] if key in case else case["bound_dv"] * case["torque_bound"] / case["bound"])


def _times(robot: str, report: Report) -> Iterator[Limited]:
    for what, name, limit, floor in TIME_LIMITS.get(report.bench, ()):
        measured, value = (report.figures.get(key, math.nan) for key in (name, floor))
        if math.isfinite(measured) and value > 0.0:
            yield Limited(what, robot, measured, limit, value, "us", measured / value)
