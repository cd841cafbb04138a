"""The tables of a report, as Markdown: verdicts, limits, figures, shares."""

from __future__ import annotations

import math
from collections.abc import Sequence

from benchmarks.harness import Report
from benchmarks.report_bounds import bounds_of
from benchmarks.report_limits import limited
from benchmarks.report_style import Reports, robots_of
from benchmarks.saved_reports import Failure, SavedReport
from benchmarks.suite import suite_config
from benchmarks.suite_plan import Progress
from benchmarks.survival import shares

MOST_NOTES = 12
"""Lines that the report says of a benchmark that has not passed."""

GOOD_NOTES = ("ok", "holds", "wall-clock", "problems", "dv:", "idle: holds", "advice", "this machine keeps")
"""How notes begin that say nothing of what is broken."""


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
    told = (f"- {failed.bench}, {failed.robot}: {failed.error}{_traced(failed)}" for failed in failures)
    return [*lines, *told] + [""] * bool(failures)


def _traced(failed: Failure) -> str:
    return f" (`{failed.trace}`)" if failed.trace else ""


def missing(progress: Progress) -> list[str]:
    """What an unfinished suite lacks; nothing where all is there."""
    if not progress.missing:
        return []
    told = str(progress)
    rows = [[part.bench, part.robot, part.state] for part in progress.missing if part.total or part.earlier]
    untouched = [f"{part.bench} {part.robot}" for part in progress.missing if not (part.total or part.earlier)]
    again = f"`poise bench all --{progress.suite}` with the same `--out` goes on."
    return [
        f"**{told[0].upper()}{told[1:]}.** {again}",
        "",
        *(table(["unfinished", "robot", "cases"], rows) if rows else []),
        *([f"Not begun: {', '.join(untouched)}.", ""] if untouched else []),
    ]


def _keys(report: Report) -> str:
    """The figures that tell most about a benchmark, and every one whose bound does not hold."""
    words = suite_config().keys.get(report.bench, {})
    broken = [
        name
        for name, bound in bounds_of(report).items()
        if name in report.figures and name not in words and not bound.holds(report.figures[name])
    ]
    told = [(words[name], name) for name in words if name in report.figures] + [(f"`{name}`", name) for name in broken]
    return "; ".join(f"{text}: {bounded(report, name)}" for text, name in told) or "-"


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
    """The figures that the suite's configuration names with their bounds, one column a robot."""
    robots, rows = robots_of(reports), []
    for bench, names in suite_config().figures.items():
        measured = {robot: reports[bench, robot] for robot in robots if (bench, robot) in reports}
        for name in names if measured else ():
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
