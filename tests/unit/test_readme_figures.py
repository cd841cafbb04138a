"""Every documented figure has a command beside it, and every documented command exists."""

import re
import shlex
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import typer

from benchmarks.core.benchmark import bounds_of
from benchmarks.core.harness import Report
from benchmarks.core.results import read_lines
from bridge.cli import app
from models.profile import robot_names

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "README.md"
FIGURES = ROOT / "docs" / "measured.md"
MEASURED = (
    FIGURES,
    *(
        ROOT / "docs" / f"{name}.md"
        for name in ("peers", "walking_measured", "walking_tried", "latency", "tick", "limits")
    ),
)
"""Pages whose tables hold measured figures."""

PAGES = (README, *sorted((ROOT / "docs").glob("*.md")))
REPORT = ROOT / "docs/benchmark_report"
REPORT_SIZE = 1_500_000
"""Most that the committed report may take [B]."""

COMMAND = re.compile(r"`((?:poise|make) [^`]+)`|^    ((?:poise|make) .+)$", re.MULTILINE)
UNIT = re.compile(r"\d (us|ms|s|min|mm|cm|m|m/s|%|N\.s)\b")

MENTIONS = {
    "poise bench",
    "poise replay",
    "poise send",
    "poise check-robot",
    "poise up --namespace",
    "poise --install-completion",
}
"""Commands that a sentence names without what they need."""


def commands(text: str) -> list[str]:
    """Single command lines of a page, without comments."""
    found = (re.split(r"\s#", "".join(pair))[0] for pair in COMMAND.findall(text))
    lines = (part.strip() for line in found for part in re.split(r"&&|;|\s\|", line))
    return [line for line in lines if line.startswith(("poise ", "make "))]


@cache
def root_command() -> Any:
    """The command line; its groups load when they are asked for."""
    return typer.main.get_command(app)


@cache
def refusal(line: str) -> str:
    """Why the command line does not take a command; empty when it does. Nothing is run."""
    command = root_command()
    words = shlex.split(line)[1:]
    parent = command.context_class(command, info_name="poise")
    while hasattr(command, "commands"):
        name = words.pop(0) if words else ""
        found = command.get_command(parent, name)
        if found is None:
            return f"{line}: no command '{name}'"
        command = found
        parent = command.context_class(command, info_name=name, parent=parent)
    try:
        given = command.make_context(command.name, words).params
    except Exception as error:  # of typer's own copy of click
        return f"{line}: {getattr(error, 'format_message', error.__str__)()}"
    robot = given.get("robot", "g1")
    known = robot in robot_names() or not line.startswith("poise bench")
    return "" if known else f"{line}: no robot '{robot}'"


def sections(text: str) -> list[str]:
    """A page by its headings."""
    return re.split(r"^#+ ", text, flags=re.MULTILINE)


def measured_tables(section: str) -> list[str]:
    """Tables of a section with a figure in them."""
    tables = re.findall(r"(?:^\|.*\n)+", section, flags=re.MULTILINE)
    return [table for table in tables if UNIT.search(table) or re.search(r"\| [\d.]+[,; |]", table)]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_command_that_a_page_names_is_one(page: Path) -> None:
    found = [line for line in commands(page.read_text()) if line.startswith("poise ") and line not in MENTIONS]
    assert [refusal(line) for line in found if refusal(line)] == []


@pytest.mark.parametrize(
    "wrong",
    [
        "poise bench stnad",
        "poise bench stand --robots g1",
        "poise bench stand --seeds many",
        "poise bench stand --robot g2",
    ],
)
def test_a_command_that_is_none_is_noticed(wrong: str) -> None:
    assert refusal(wrong) and not refusal("poise bench stand --robot talos --seeds 2 --json FILE")


def test_every_measured_row_names_its_benchmark() -> None:
    rows = [line for line in FIGURES.read_text().splitlines() if line.startswith("| ")][1:]
    assert len(rows) > 15
    assert [row for row in rows if not re.search(r"\| [^|]*`poise bench [^`]+`[^|]*\|$", row)] == []


def test_the_readme_is_short_and_its_links_lead_to_pages() -> None:
    text = README.read_text()
    assert len(text.split()) <= 900
    assert [link for link in re.findall(r"\]\(([^)#:]+)\)", text) if not (ROOT / link).exists()] == []


@pytest.mark.parametrize("page", MEASURED, ids=lambda page: page.stem)
def test_every_table_of_figures_stands_beside_its_command(page: Path) -> None:
    bare = [
        f"{section.splitlines()[0]}: {table.splitlines()[0]}"
        for section in sections(page.read_text())
        for table in measured_tables(section)
        if not commands(section)
    ]
    assert bare == []


def test_every_make_target_that_a_page_names_is_one() -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), flags=re.MULTILINE))
    named = {line.split()[1] for page in PAGES for line in commands(page.read_text()) if line.startswith("make ")}
    assert named <= targets


@pytest.mark.skipif(not REPORT.is_dir(), reason="no report is committed: make report-docs")
def test_the_committed_report_is_whole_small_and_general() -> None:
    page = (REPORT / "report.md").read_text()
    pictures = set(re.findall(r"\]\((plots/[^)]+)\)", page))
    assert pictures == {f"plots/{file.name}" for file in (REPORT / "plots").iterdir()}
    assert sum(file.stat().st_size for file in REPORT.rglob("*") if file.is_file()) < REPORT_SIZE
    lines = (REPORT / "reports.jsonl").read_text()
    assert not re.search(r"/(tmp|home|root|work)/", page + lines)
    for line in read_lines(REPORT / "reports.jsonl"):
        assert "error" in line or (not refusal(line["command"]) and line["revision"] in page), line["bench"]
        if line.get("passed"):  # then no bound of a figure that is shown may be broken
            kept = {field.name: line[field.name] for field in fields(Report) if field.name in line}
            report = Report(cases=[], **kept)
            shown = {name: bound for name, bound in bounds_of(report).items() if name in report.figures}
            assert [name for name, bound in shown.items() if not bound.holds(report.figures[name])] == [], line["bench"]
