"""The report of a suite: ``report.md`` with pictures beside it, and ``report.html`` that holds all in one file."""

from __future__ import annotations

import base64
import math
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path

from matplotlib.figure import Figure

from benchmarks.report_plots import draw_cost, draw_delays, draw_estimator, draw_speeds, draw_times
from benchmarks.report_survival import PUSHES, Reports, draw_curves, draw_shares, draw_terrain, robots_of
from benchmarks.saved_reports import Failure, SavedReport, read_reports
from benchmarks.suite import suite_config
from benchmarks.suite_plan import Progress, read_progress
from benchmarks.survival import shares
from models.errors import ConfigError, PoiseError

PLOTS = "plots"
"""Folder of the pictures, in the folder of the report."""

MOST_NOTES = 12
"""Lines that the report says of a benchmark that has not passed."""

PICTURES: tuple[tuple[str, str, Callable[[Reports], Figure | None]], ...] = (
    ("Survival", "survival", draw_shares),
    ("Survival over time and size", "survival-curves", draw_curves),
    ("Uneven ground", "terrain", draw_terrain),
    ("Walking at commanded velocities", "speeds", draw_speeds),
    ("Cost of transport", "cost-of-transport", draw_cost),
    ("Time", "times", draw_times),
    ("State estimation", "estimator", draw_estimator),
    ("Delay margin", "delay-margin", draw_delays),
)
"""Heading, file and picture, in the order of the report."""

STYLE = """body{font:15px/1.5 sans-serif;max-width:70em;margin:2em auto;padding:0 1em;color:#222}
table{border-collapse:collapse;margin:1em 0}td,th{border:1px solid #ccc;padding:.2em .6em;text-align:left}
img{max-width:100%}code{background:#f3f3f3}"""


def write_report(folder: Path, modules: Mapping[str, str]) -> list[Path]:
    """Build the report from the JSON lines of a suite's folder.

    Args:
        folder: Of the suite.
        modules: Module of each benchmark, by the name that its reports bear.

    Returns:
        ``report.md``, ``report.html`` and the pictures.

    Raises:
        ConfigError: Nothing was ever started there, or a line is damaged.
        PoiseError: ``markdown-it-py`` is not installed.
    """
    (saved, failures), progress = read_reports(folder), read_progress(folder)
    if not (saved or failures or progress.missing):
        raise ConfigError(f"{folder}: no benchmark is finished there; run: poise bench all --quick --out {folder}")
    reports = {(entry.report.bench, entry.report.robot): entry.report for entry in saved}
    plots = folder / PLOTS
    plots.mkdir(exist_ok=True)
    lines = [*_head(saved, progress), *_verdicts(saved, failures), *_figures(reports), *_survival(reports)]
    pictures: list[Path] = []
    for heading, name, draw in PICTURES:
        figure = draw(reports)
        if figure is not None:
            pictures.append(plots / f"{name}.png")
            figure.savefig(pictures[-1], dpi=110)
            lines += _picture(heading, (draw.__doc__ or "").strip(), [pictures[-1]])
        if draw is draw_curves:
            maps = _push_maps(reports, modules, plots)
            pictures += maps
            lines += _picture("Push maps", "Impulse over mass that is taken, by direction, beside its bounds.", maps)
    page = folder / "report.md"
    page.write_text("\n".join([*lines, *_again(saved)]) + "\n", encoding="utf-8")
    whole = folder / "report.html"
    whole.write_text(_html(page), encoding="utf-8")
    return [page, whole, *pictures]


def _push_maps(reports: Reports, modules: Mapping[str, str], plots: Path) -> list[Path]:
    """The map of every push benchmark, without how the weakest push failed."""
    found: list[Path] = []
    for (bench, _), report in reports.items():
        if bench in PUSHES:
            first, *others = import_module(f"benchmarks.{modules[bench]}").plot(report, plots)
            found.append(first)
            for other in others:
                other.unlink()
    return found


def _picture(heading: str, caption: str, files: Sequence[Path]) -> list[str]:
    if not files:
        return []
    return [f"## {heading}", "", caption, "", *(f"![{file.stem}]({PLOTS}/{file.name})\n" for file in files)]


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    cells = [head, ["---"] * len(head), *rows]
    return [f"| {' | '.join(cell.replace('|', '/') for cell in row)} |" for row in cells] + [""]


def _joined(values: Sequence[str]) -> str:
    return "; ".join(dict.fromkeys(values))


def _head(saved: Sequence[SavedReport], progress: Progress) -> list[str]:
    versions = dict(item for entry in saved for item in entry.versions.items())
    return [
        "# Benchmark report",
        "",
        *_missing(progress),
        f"- Machine: {_joined([name for entry in saved for name in entry.machines])}",
        f"- Revision: {_joined([entry.revision for entry in saved])}",
        f"- Versions: {', '.join(f'{name} {value}' for name, value in versions.items())}",
        "",
        "Intervals are Wilson's, of 95 %. What a figure means: docs/design.md. How this is made: docs/benchmarks.md.",
        "",
    ]


def _missing(progress: Progress) -> list[str]:
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
        *(_table(["unfinished", "robot", "cases"], rows) if rows else []),
        *([f"Not begun: {', '.join(untouched)}.", ""] if untouched else []),
    ]


def _verdicts(saved: Sequence[SavedReport], failures: Sequence[Failure]) -> list[str]:
    rows = [
        [
            entry.report.bench,
            entry.report.who,
            str(entry.report.seeds),
            str(len(entry.report.cases)),
            f"{entry.seconds:.0f}",
            f"{entry.report.load['before'][0]:g}, {entry.report.load['after'][0]:g}",
            "passed" if entry.report.passed else "not passed",
        ]
        for entry in saved
    ]
    rows += [[failed.bench, failed.robot, "-", "-", "-", "-", "could not be run"] for failed in failures]
    head = ["bench", "robot", "seeds", "cases", "time of the cases [s]", "load before, after", "bounds"]
    lines = ["## Verdicts", "", *_table(head, rows)]
    for entry in saved:
        if not entry.report.passed:
            notes = [note for note in entry.report.notes if not note.startswith(("ok", "holds"))]
            lines += [f"Not passed: {entry.report.bench}, {entry.report.who}", ""]
            lines += [*(f"    {note}" for note in notes[:MOST_NOTES]), ""]
    lines += [f"- {failed.bench}, {failed.robot}: {failed.error}{_traced(failed)}" for failed in failures]
    return [*lines, ""] if failures else lines


def _traced(failed: Failure) -> str:
    return f" (`{failed.trace}`)" if failed.trace else ""


def _figures(reports: Reports) -> list[str]:
    """The figures that the suite's configuration names, one column a robot; a dash where it was not measured."""
    robots, lines = robots_of(reports), ["## Figures", ""]
    rows = []
    for bench, names in suite_config().figures.items():
        of = {robot: reports[bench, robot].figures for robot in robots if (bench, robot) in reports}
        for name in names if of else ():
            values = [_number(of.get(robot, {}).get(name, math.nan)) for robot in robots]
            rows.append([bench, f"`{name}`", *values])
    if not rows:
        return []
    return [*lines, *_table(["bench", "figure", *robots], rows), "All figures are in `reports.jsonl`.", ""]


def _number(value: float) -> str:
    return f"{value:.4g}" if math.isfinite(value) else "-"


def _survival(reports: Reports) -> list[str]:
    found = shares(reports.values())
    rows = [
        [share.name, share.robot, f"{share.survived} of {share.total}", "{:.2f} to {:.2f}".format(*share.interval)]
        for share in found
    ]
    if not rows:
        return []
    return ["## Survived", "", *_table(["what", "robot", "survived", "interval of the share"], rows)]


def _again(saved: Sequence[SavedReport]) -> list[str]:
    commands = (f"    {entry.command}" for entry in saved)
    return ["## Again", "", "Each of these measures its part of this report:", "", *commands]


def _html(page: Path) -> str:
    """A Markdown file with its pictures as one HTML text."""
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
