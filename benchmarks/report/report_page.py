"""The report of a suite: ``report.md`` with pictures beside it, and ``report.html`` that holds all in one file."""

from __future__ import annotations

import base64
import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from benchmarks.core.provenance import ROOT
from benchmarks.core.results import plain, worded
from benchmarks.report.report_plots import draw_cost, draw_delays, draw_estimator, draw_speeds
from benchmarks.report.report_style import Reports, save
from benchmarks.report.report_survival import draw_curves, draw_push_maps, draw_shares, draw_terrain
from benchmarks.report.report_tables import conditions, figures, limits, missing, summary, survival
from benchmarks.report.report_times import draw_loop, draw_times
from benchmarks.report.saved_reports import REPORTS, Progress, SavedReport, latest_lines, read_progress, read_reports
from models.errors import ConfigError, PoiseError

PLOTS = "plots"  # folder of the pictures, in the folder of the report

#: Heading, file and picture, in the order of the report
PICTURES: tuple[tuple[str, str, Callable[[Reports], Figure | None]], ...] = (
    ("Survival", "survival", draw_shares),
    ("Survival over time and size of push", "survival-curves", draw_curves),
    ("Push maps", "push-maps", draw_push_maps),
    ("Uneven ground", "terrain", draw_terrain),
    ("Speed tracking", "speeds", draw_speeds),
    ("Cost of transport", "cost-of-transport", draw_cost),
    ("Time", "times", draw_times),
    ("Time of the closed loop", "loop", draw_loop),
    ("State estimation", "estimator", draw_estimator),
    ("Delay margin", "delay-margin", draw_delays),
)
GUIDE = """Simulated in MuJoCo with sensor noise and delay, the laws seeing sensors only. The summary has a row for each
benchmark and robot: whether all its bounds hold, its key figures with their bounds in parentheses (bold
where one does not hold), and the command that measures the row again. Under it stands what is broken, in the
benchmark's own words. Then come the limits that physics or the machine set, as ratios, pictures, and the other figures.
Times are of one shared machine and change with what else it does (its load stands in the last table); ratios of one run
and what happens in simulated time change less. Intervals are Wilson's, of 95 %: one seed says little about a share, and
they show it."""

STYLE = """body{font:15px/1.5 sans-serif;max-width:70em;margin:2em auto;padding:0 1em;color:#222}
table{border-collapse:collapse;margin:1em 0}td,th{border:1px solid #ccc;padding:.2em .6em;text-align:left}
td{vertical-align:top}img{max-width:100%}code{background:#f3f3f3}"""


def write_report(folder: Path) -> list[Path]:
    """Build ``report.md``, ``report.html`` and the pictures from the JSON lines of a suite's folder.

    Raises:
        ConfigError: Nothing was ever started there, or a line is damaged.
        PoiseError: ``markdown-it-py`` is not installed.
    """
    page, *pictures = _write_page(folder, folder)
    whole = folder / "report.html"
    whole.write_text(_html(page), encoding="utf-8")
    return [page, whole, *pictures]


def publish_report(folder: Path, docs: Path) -> list[Path]:
    """Write what a repository keeps: page, pictures, and ``reports.jsonl``, one line a bench and robot without cases.

    Raises:
        ConfigError: Nothing is finished there, or a line is damaged.
    """
    files = _write_page(folder, docs)
    for file in (docs / PLOTS).glob("*.png"):
        if file not in files:
            file.unlink()
    kept = [{name: line[name] for name in line if name not in ("keys", "notes")} for line in latest_lines(folder)]
    lines = docs / REPORTS
    lines.write_text(
        "".join(json.dumps(worded(plain(line)), allow_nan=False) + "\n" for line in kept), encoding="utf-8"
    )
    return [*files, lines]


def _write_page(folder: Path, out: Path) -> list[Path]:
    """The page and its pictures of a suite's folder, written into another one or the same."""
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
    """A page of the documentation: a link from a report that lies in it, else its name."""
    docs = ROOT / "docs"
    if not out.resolve().is_relative_to(docs):
        return f"`docs/{name}`"
    return f"[{name.removesuffix('.md')}]({os.path.relpath(docs / name, out.resolve())})"


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
