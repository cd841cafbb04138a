"""Report of a suite: ``report.md`` with tables and plots, and ``report.html``, which includes them in one file."""

import base64
import math
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from benchmarks.core.benchmark import bounds_of, catalogue
from benchmarks.core.harness import Case, Report
from benchmarks.core.provenance import ROOT
from benchmarks.core.results import line_text
from benchmarks.report import report_plots
from benchmarks.report.report_plots import Reports, robots_of, save
from benchmarks.report.report_survival import (
    DOING,
    draw_curves,
    draw_ladder_curves,
    draw_push_maps,
    draw_shares,
    draw_terrain,
    shares,
)
from benchmarks.report.suite import REPORTS, Failure, Progress, SavedReport, latest_lines, read_progress, read_reports
from benchmarks.stability.push import direction_name
from models.errors import ConfigError, PoiseError


@dataclass(frozen=True, slots=True)
class Limited:
    """Measured figure of a robot, name and value of its limit in the same unit, and their ratio [-]."""

    what: str
    robot: str
    measured: float
    limit: str
    value: float
    unit: str
    ratio: float


#: Name and case key [m/s] of the limits of each push benchmark
PUSH_LIMITS = {
    "push": (("ankle bound", "bound_dv"), ("torque-limited bound", "torque_bound_dv")),
    "push_catch": (("ankle bound", "ankle_dv"), ("N-step capturability", "steps_dv")),
    "push_step": (("ankle bound", "ankle_dv"), ("N-step capturability", "steps_dv")),
    "push_walk": (("ankle bound", "ankle_dv"), ("N-step capturability", "steps_dv")),
}
#: Description, figure, name of the limit, and figure of the limit [us] for the timing benchmarks
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
    """Return all figures that have a limit."""
    return [
        row
        for (bench, robot), report in reports.items()
        for row in (_pushes(robot, report) if bench in PUSH_LIMITS else _times(robot, report))
    ]


def _pushes(robot: str, report: Report) -> Iterator[Limited]:
    """Yield the direction with the smallest ratio to each limit."""
    for limit, key in PUSH_LIMITS[report.bench]:
        found = [(case, _limit(case, key)) for case in report.cases]
        shown = [(case, value) for case, value in found if value > 0.0 or not case["dv"]]
        ratios = [(case["dv"] / value if value > 0.0 else 0.0, case, value) for case, value in shown]
        if ratios:  # empty if the DCM was already outside of the soles
            ratio, case, value = min(ratios, key=lambda row: row[0])
            what = f"push, {DOING[report.bench]}, direction of the smallest ratio: {direction_name(case['angle'])}"
            yield Limited(what, robot, case["dv"], limit, value, "m/s", ratio)


def _limit(case: Case, key: str) -> float:
    """Return a limit of a push as impulse over mass [m/s]; cases store the torque bound as a force."""
    return float(case[key] if key in case else case["bound_dv"] * case["torque_bound"] / case["bound"])


def _times(robot: str, report: Report) -> Iterator[Limited]:
    for what, name, limit, floor in TIME_LIMITS.get(report.bench, ()):
        measured, value = (report.figures.get(key, math.nan) for key in (name, floor))
        if math.isfinite(measured) and value > 0.0:
            yield Limited(what, robot, measured, limit, value, "us", measured / value)


MOST_NOTES = 12  # maximum number of lines about a benchmark that has not passed

#: Prefixes of notes that do not describe a failure
GOOD_NOTES = ("ok", "holds", "wall-clock", "problems", "dv:", "idle: holds", "advice", "this machine keeps")


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a Markdown table, and an empty line."""
    cells = [head, ["---"] * len(head), *rows]
    return [f"| {' | '.join(cell.replace('|', '/') for cell in row)} |" for row in cells] + [""]


def number(value: float) -> str:
    """Format with three digits; a dash for no value."""
    if not math.isfinite(value):
        return "-"
    return f"{value:.3g}" if abs(value) < 1e3 else f"{value:.0f}"  # 1e3: three digits would become an exponent


def bounded(report: Report | None, name: str) -> str:
    """Format a figure with its bound: bold if the bound does not hold, a dash if not measured."""
    value = math.nan if report is None else report.figures.get(name, math.nan)
    if report is None or not math.isfinite(value):
        return "-"
    bound = bounds_of(report).get(name)
    if bound is None:
        return number(value)
    return f"{number(value)} ({bound})" if bound.holds(value) else f"**{number(value)}** (not {bound})"


def summary(saved: Sequence[SavedReport], failures: Sequence[Failure]) -> list[str]:
    """Return a table of benchmarks with verdict, key figures and command, and the notes of those that failed."""
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
    lost = (
        f"- {failed.bench}, {failed.robot}: {failed.error}{failed.trace and f' (`{failed.trace}`)'}"
        for failed in failures
    )
    return [*lines, *lost] + [""] * bool(failures)


def missing(progress: Progress) -> list[str]:
    """Return a list of the missing parts of an unfinished suite; empty if complete."""
    if not progress.missing:
        return []
    state = str(progress)
    rows = [[part.bench, part.robot, part.state] for part in progress.missing if part.total or part.earlier]
    untouched = [f"{part.bench} {part.robot}" for part in progress.missing if not (part.total or part.earlier)]
    again = f"`poise bench all --{progress.suite}` with the same `--out` resumes it."
    return [
        f"**{state[0].upper()}{state[1:]}.** {again}",
        "",
        *(table(["unfinished", "robot", "cases"], rows) if rows else []),
        *([f"Not begun: {', '.join(untouched)}.", ""] if untouched else []),
    ]


def _keys(report: Report) -> str:
    """Return the key figures of a benchmark, and all figures whose bound does not hold."""
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
    """Return the table of figures with their physical or machine limits."""
    rows = [
        [row.what, row.robot, f"{number(row.measured)} {row.unit}", row.limit, f"{number(row.value)} {row.unit}",
         f"{row.ratio:.2f}"]
        for row in limited(reports)
    ]  # fmt: skip
    if not rows:
        return []
    text = (
        "Each limit is computed in the same run. For pushes a larger ratio is better; a ratio above 1 is the "
        "contribution of arms and torso, which the pendulum lacks. Directions with a limit of 0 (the DCM is already "
        "outside of the soles) are omitted if a push is taken; otherwise their ratio is 0. For times a smaller ratio "
        "is better, and 1 is the limit."
    )
    return [
        "## Limits",
        "",
        text,
        "",
        *table(["figure", "robot", "measured", "limit", "value of the limit", "ratio"], rows),
    ]


def figures(reports: Reports) -> list[str]:
    """Return the table of the ``figures`` of each benchmark, with bounds, one column per robot."""
    robots, rows = robots_of(reports), []
    for bench, listed in catalogue().items():
        measured = {robot: reports[bench, robot] for robot in robots if (bench, robot) in reports}
        for name in listed.info.figures if measured else ():
            rows.append([bench, f"`{name}`", *(bounded(measured.get(robot), name) for robot in robots)])
    return ["## Figures", "", *table(["bench", "figure", *robots], rows), "All figures are in `reports.jsonl`.", ""]


def survival(reports: Reports) -> list[str]:
    """Return the table of survival shares with intervals."""
    rows = [
        [share.name, share.robot, f"{share.survived} of {share.total}", "{:.2f} to {:.2f}".format(*share.interval)]
        for share in shares(reports.values())
    ]
    if not rows:
        return []
    return ["## Survived", "", *table(["what", "robot", "survived", "interval of the share"], rows)]


def conditions(saved: Sequence[SavedReport]) -> list[str]:
    """Return the table of measurement conditions."""
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


PLOTS = "plots"  # folder of the plots, in the folder of the report

#: Heading, file name and plot function, in the order of the report
PICTURES: tuple[tuple[str, str, Callable[[Reports], Figure | None]], ...] = (
    ("Survival", "survival", draw_shares),
    ("Survival over time and size of push", "survival-curves", draw_curves),
    ("Push maps", "push-maps", draw_push_maps),
    ("Uneven ground", "terrain", draw_terrain),
    ("Ladders of ground", "ladders", draw_ladder_curves),
    ("Speed tracking", "speeds", report_plots.draw_speeds),
    ("Cost of transport", "cost-of-transport", report_plots.draw_cost),
    ("Time", "times", report_plots.draw_times),
    ("Time of the closed loop", "loop", report_plots.draw_loop),
    ("State estimation", "estimator", report_plots.draw_estimator),
    ("Delay margin", "delay-margin", report_plots.draw_delays),
)
GUIDE = """Simulated in MuJoCo with sensor noise and delay; the laws use sensors only. The summary has a row for each
benchmark and robot: whether all bounds hold, the key figures with their bounds in parentheses (bold where a bound does
not hold), and the command that repeats the measurement. Below it are the notes of benchmarks that failed. Then follow
the ratios to the limits set by physics or by the machine, plots, and the other figures. Times are from one shared
machine and depend on its load, which is in the last table; ratios within one run, and results in simulated time, vary
less. Intervals are 95 % Wilson intervals: they are wide for a share that was measured with few seeds."""

STYLE = """body{font:15px/1.5 sans-serif;max-width:70em;margin:2em auto;padding:0 1em;color:#222}
table{border-collapse:collapse;margin:1em 0}td,th{border:1px solid #ccc;padding:.2em .6em;text-align:left}
td{vertical-align:top}img{max-width:100%}code{background:#f3f3f3}"""


def write_report(folder: Path) -> list[Path]:
    """Build ``report.md``, ``report.html`` and plots from the JSON lines of a suite; ``ConfigError`` without any."""
    page, *pictures = _write_page(folder, folder)
    whole = folder / "report.html"
    whole.write_text(_html(page), encoding="utf-8")
    return [page, whole, *pictures]


def publish_report(folder: Path, docs: Path) -> list[Path]:
    """Write page, plots, and ``reports.jsonl`` (one line per benchmark and robot, no cases) for a repository.

    Plots of an earlier report that this report lacks are deleted.
    """
    files = _write_page(folder, docs)
    for file in {docs / PLOTS / f"{name}.png" for _, name, _ in PICTURES} - set(files):
        file.unlink(missing_ok=True)
    kept = [
        {name: line[name] for name in line if name not in ("keys", "notes")} for line in latest_lines(folder).values()
    ]
    lines = docs / REPORTS
    lines.write_text("".join(map(line_text, kept)), encoding="utf-8")
    return [*files, lines]


def _write_page(folder: Path, out: Path) -> list[Path]:
    (saved, failures), progress = read_reports(folder), read_progress(folder)
    if not (saved or failures or progress.missing):
        raise ConfigError(f"{folder}: no benchmark is finished there; run: poise bench all --quick --out {folder}")
    reports = {(entry.report.bench, entry.report.robot): entry.report for entry in saved}
    plots = out / PLOTS
    plots.mkdir(parents=True, exist_ok=True)
    lines = [*_head(saved, progress, out), *summary(saved, failures), *limits(reports)]
    pictures: list[Path] = []
    for heading, name, draw in PICTURES:
        figure = draw(reports)
        if figure is not None:
            pictures.append(save(figure, plots / f"{name}.png"))
            caption = " ".join((draw.__doc__ or "").split())
            lines += [f"## {heading}", "", caption, "", f"![{heading}]({PLOTS}/{name}.png)", ""]
    page = out / "report.md"
    text = "\n".join([*lines, *figures(reports), *survival(reports), *conditions(saved)])
    page.write_text(text.rstrip() + "\n", encoding="utf-8")
    return [page, *pictures]


def _joined(values: Sequence[str]) -> str:
    return "; ".join(dict.fromkeys(values))


def _head(saved: Sequence[SavedReport], progress: Progress, out: Path) -> list[str]:
    versions = dict(item for entry in saved for item in entry.versions.items() if item[0] != "machine")
    return [
        "# Benchmark report",
        "",
        *missing(progress),
        *GUIDE.splitlines(),
        f"What a figure means: {_doc(out, 'design.md')}. The limits: {_doc(out, 'limits.md')}. How this is made: "
        f"{_doc(out, 'benchmarks.md')}.",
        "",
        f"- Machine: {_joined([name for entry in saved for name in entry.machines])}",
        f"- Revision: {_joined([entry.revision for entry in saved])}",
        f"- Versions: {', '.join(f'{name} {value}' for name, value in versions.items())}",
        "",
    ]


def _doc(out: Path, name: str) -> str:
    """Return a relative link to a documentation page if ``out`` is inside the documentation, else its name."""
    docs = ROOT / "docs"
    if not out.resolve().is_relative_to(docs):
        return f"`docs/{name}`"
    return f"[{name.removesuffix('.md')}]({os.path.relpath(docs / name, out.resolve())})"


def _html(page: Path) -> str:
    try:
        from markdown_it import MarkdownIt
    except ImportError as error:
        raise PoiseError("report.html needs markdown-it-py: pip install 'poise[bench]'") from error
    parser = MarkdownIt("commonmark").enable("table")
    tokens = parser.parse(page.read_text(encoding="utf-8"))
    for token in (child for outer in tokens for child in outer.children or [] if child.type == "image"):
        picture = base64.b64encode((page.parent / str(token.attrs["src"])).read_bytes()).decode()
        token.attrs["src"] = f"data:image/png;base64,{picture}"
    body = parser.renderer.render(tokens, parser.options, {})
    head = f'<meta charset="utf-8"><title>Benchmark report</title><style>{STYLE}</style>'
    return f'<!doctype html><html lang="en"><head>{head}</head><body>{body}</body></html>\n'
