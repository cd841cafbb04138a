"""The tables of a suite's report, as Markdown: verdicts, limits as ratios (docs/limits.md), figures, shares."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from benchmarks.core.benchmark import bounds_of, catalogue
from benchmarks.core.harness import Case, Report
from benchmarks.report.report_style import Reports, robots_of
from benchmarks.report.report_survival import DOING, shares
from benchmarks.report.saved_reports import Failure, Progress, SavedReport
from benchmarks.stability.push_plot import direction_name


@dataclass(frozen=True, slots=True)
class Limited:
    """A measured figure of a robot, its limit by name and value in the same unit, and their ratio [-]."""

    what: str
    robot: str
    measured: float
    limit: str
    value: float
    unit: str
    ratio: float


#: Name and key [m/s] of the limits of each push benchmark
PUSH_LIMITS = {
    "push": (("ankle bound", "bound_dv"), ("torque-limited bound", "torque_bound_dv")),
    "push_catch": (("ankle bound", "ankle_dv"), ("N-step capturability", "steps_dv")),
    "push_step": (("ankle bound", "ankle_dv"), ("N-step capturability", "steps_dv")),
    "push_walk": (("ankle bound", "ankle_dv"), ("N-step capturability", "steps_dv")),
}
#: What it is, its figure, its limit and that one's figure [us], of the benchmarks of time
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


MOST_NOTES = 12  # lines in the report about a benchmark that has not passed

#: Prefixes of notes that describe no failure
GOOD_NOTES = ("ok", "holds", "wall-clock", "problems", "dv:", "idle: holds", "advice", "this machine keeps")


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a Markdown table, and an empty one."""
    cells = [head, ["---"] * len(head), *rows]
    return [f"| {' | '.join(cell.replace('|', '/') for cell in row)} |" for row in cells] + [""]


def number(value: float) -> str:
    """Three digits, or a dash where nothing was measured."""
    if not math.isfinite(value):
        return "-"
    return f"{value:.3g}" if abs(value) < 1e3 else f"{value:.0f}"  # 1e3: three digits would become an exponent


def bounded(report: Report | None, name: str) -> str:
    """A figure of a report with its bound; bold where that does not hold, a dash where it was not measured."""
    value = math.nan if report is None else report.figures.get(name, math.nan)
    if report is None or not math.isfinite(value):
        return "-"
    bound = bounds_of(report).get(name)
    if bound is None:
        return number(value)
    return f"{number(value)} ({bound})" if bound.holds(value) else f"**{number(value)}** (not {bound})"


def summary(saved: Sequence[SavedReport], failures: Sequence[Failure]) -> list[str]:
    """What every benchmark found, whether its bounds hold, and the command; then what is broken, in its own words."""
    rows = [
        [
            entry.report.bench.replace("_", " "),
            entry.report.who,
            "passed" if entry.report.passed else "**failed**",
            _keys(entry.report),
            f"`{entry.command}`",
        ]
        for entry in saved
    ]
    rows += [[failed.bench, failed.robot, "**could not be run**", "-", "-"] for failed in failures]
    lines = ["## Summary", "", *table(["benchmark", "robot", "bounds", "key figures (bound)", "command"], rows)]
    for entry in saved:
        if not entry.report.passed:
            notes = [note for note in entry.report.notes if not note.startswith(GOOD_NOTES)]
            lines += [f"Failed: {entry.report.bench.replace('_', ' ')}, {entry.report.who}", ""]
            lines += [*(f"    {note}" for note in notes[:MOST_NOTES]), ""]
    lost = (f"- {failed.bench}, {failed.robot}: {failed.error}{_traced(failed)}" for failed in failures)
    return [*lines, *lost] + [""] * bool(failures)


def _traced(failed: Failure) -> str:
    return f" (`{failed.trace}`)" if failed.trace else ""


def missing(progress: Progress) -> list[str]:
    """What an unfinished suite lacks; nothing where all is there."""
    if not progress.missing:
        return []
    state = str(progress)
    rows = [[part.bench, part.robot, part.state] for part in progress.missing if part.total or part.earlier]
    untouched = [f"{part.bench} {part.robot}" for part in progress.missing if not (part.total or part.earlier)]
    again = f"`poise bench all --{progress.suite}` with the same `--out` goes on."
    return [
        f"**{state[0].upper()}{state[1:]}.** {again}",
        "",
        *(table(["unfinished", "robot", "cases"], rows) if rows else []),
        *([f"Not begun: {', '.join(untouched)}.", ""] if untouched else []),
    ]


def _keys(report: Report) -> str:
    """The key figures of a benchmark, and every one whose bound does not hold."""
    listed = catalogue().get(report.bench)
    words = listed.info.keys if listed else {}
    broken = [
        name
        for name, bound in bounds_of(report).items()
        if name in report.figures and name not in words and not bound.holds(report.figures[name])
    ]
    shown = [(words[name], name) for name in words if name in report.figures] + [(f"`{name}`", name) for name in broken]
    return "; ".join(f"{text}: {bounded(report, name)}" for text, name in shown) or "-"


def limits(reports: Reports) -> list[str]:
    """What physics or the machine allows, and how near each figure comes."""
    rows = [
        [row.what, row.robot, f"{number(row.measured)} {row.unit}", row.limit, f"{number(row.value)} {row.unit}",
         f"{row.ratio:.2f}"]
        for row in limited(reports)
    ]  # fmt: skip
    if not rows:
        return []
    text = (
        "Each limit is computed in the same run. Of a push, more is better, and a ratio above 1 is what arms and torso "
        "add to the pendulum; directions whose limit is 0, the DCM being beyond the soles already, are left out. Of a "
        "time, less is better, and 1 would be the limit itself."
    )
    return ["## Limits", "", text, "", *table(["figure", "robot", "measured", "limit", "its value", "ratio"], rows)]


def figures(reports: Reports) -> list[str]:
    """The figures that each benchmark's description names, with their bounds, one column a robot."""
    robots, rows = robots_of(reports), []
    for bench, listed in catalogue().items():
        measured = {robot: reports[bench, robot] for robot in robots if (bench, robot) in reports}
        for name in listed.info.figures if measured else ():
            rows.append([bench, f"`{name}`", *(bounded(measured.get(robot), name) for robot in robots)])
    return ["## Figures", "", *table(["bench", "figure", *robots], rows), "All figures are in `reports.jsonl`.", ""]


def survival(reports: Reports) -> list[str]:
    """Shares survived, with their intervals."""
    rows = [
        [share.name, share.robot, f"{share.survived} of {share.total}", "{:.2f} to {:.2f}".format(*share.interval)]
        for share in shares(reports.values())
    ]
    if not rows:
        return []
    return ["## Survived", "", *table(["what", "robot", "survived", "interval of the share"], rows)]


def conditions(saved: Sequence[SavedReport]) -> list[str]:
    """Under what each benchmark was measured."""
    rows = [
        [
            entry.report.bench,
            entry.report.who,
            str(entry.report.seeds),
            str(len(entry.report.cases)),
            f"{entry.seconds:.0f}",
            f"{entry.report.load['before'][0]:.1f}, {entry.report.load['after'][0]:.1f}",
        ]
        for entry in saved
    ]
    head = ["bench", "robot", "seeds", "cases", "time of the cases [s]", "load before, after"]
    return ["## How it was measured", "", *table(head, rows)]
