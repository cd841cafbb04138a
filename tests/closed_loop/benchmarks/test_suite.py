"""``poise bench all``: real cases, kept as they are finished, and their report built from the JSON lines."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from benchmarks import cli
from benchmarks.cli import app
from benchmarks.core.benchmark import Info, Listed, Part, catalogue
from benchmarks.report import report_page, suite
from benchmarks.report.suite import CASES, REPORTS, command_of, parts_of

RUNNER = CliRunner()

ROW = "stamp_in_the_future"
"""A fault that the robot rides through, quickly measured."""


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    """A suite of one case, and of a benchmark that cannot be run."""
    parts = {"faults": Part(("g1",), 1, (ROW,)), "stand": Part(("unknown",))}
    keys = {"survived": "required reaction observed", "absent": "absent"}
    info = Info("", choice="scenario", keys=keys, figures=("survived", "total", "nonsense"))
    listed = {"faults": Listed("faults", info, "benchmarks.faults.faults"), "stand": catalogue()["stand"]}
    monkeypatch.setattr(suite, "parts_of", lambda name: parts)
    for module in (cli, report_page):  # each has the name
        monkeypatch.setattr(module, "catalogue", lambda: listed)


def run(folder: Path) -> Any:
    return RUNNER.invoke(app, ["all", "--quick", "--out", str(folder), "--workers", "1"])


@pytest.mark.long
def test_a_suite_is_measured_once_and_its_report_is_built_from_the_lines(tmp_path: Path, tiny: None) -> None:
    pytest.importorskip("markdown_it")
    folder = tmp_path / "bench"
    assert run(folder).exit_code == 1  # there is no such profile
    (line,) = [json.loads(text) for text in (folder / CASES).read_text().splitlines()]
    assert (line["bench"], line["case"]["row"], line["case"]["ok"]) == ("faults", ROW, True)
    report, failure = [json.loads(text) for text in (folder / REPORTS).read_text().splitlines()]
    assert report["keys"] == [line["key"]] and report["figures"] == pytest.approx({
        "survived": 1.0, "total": 1.0, "torque_step_max": line["case"]["torque_step"],
    })  # fmt: skip
    assert (failure["bench"], failure["robot"]) == ("stand", "unknown") and "unknown robot" in failure["error"]
    page, whole = (folder / "report.md").read_text(), (folder / "report.html").read_text()
    command = f"poise bench faults --robot g1 --seeds 1 --scenario {ROW}"
    for text in (
        f"| faults | g1 | passed | required reaction observed: 1 (≥ 1) | `{command}` |",
        "| faults | g1 | 1 | 1 |",
    ):
        assert text in page, text
    for text in ("| stand | unknown | **could not be run** |", "stand, unknown: ", "0.21 to 1.00"):
        assert text in page, text
    # A figure that is none is to be seen.
    for text in ("| faults | `survived` | 1 (≥ 1) |", "| faults | `nonsense` | - |"):
        assert text in page, text
    assert "plots/survival.png" in page and (folder / "plots/survival.png").is_file()
    assert not re.search(r'(src|href)="(?!data:)', whole) and "data:image/png;base64," in whole and "<table>" in whole
    assert str(tmp_path) not in page + whole

    again = run(folder)  # measures nothing
    assert len((folder / CASES).read_text().splitlines()) == 1
    assert again.exit_code == 1 and "faults g1: 1 cases, passed" in again.output

    for file in (folder / "report.md", folder / "report.html", folder / "plots/survival.png"):
        file.unlink()
    assert RUNNER.invoke(app, ["report", str(folder)]).exit_code == 0
    assert ((folder / "report.md").read_text(), (folder / "report.html").read_text()) == (page, whole)

    docs = tmp_path / "docs"
    (docs / "plots").mkdir(parents=True)
    for name in ("times", "own"):  # of an earlier report, and of somebody else
        (docs / f"plots/{name}.png").touch()
    assert RUNNER.invoke(app, ["report", str(folder), "--docs", str(docs)]).exit_code == 0
    assert {str(file.relative_to(docs)) for file in docs.rglob("*") if file.is_file()} == {
        "report.md", "reports.jsonl", "plots/survival.png", "plots/own.png",
    }  # fmt: skip
    assert (docs / "report.md").read_text() == page
    kept, lost = [json.loads(text) for text in (docs / REPORTS).read_text().splitlines()]
    assert kept == {name: value for name, value in report.items() if name not in ("keys", "notes")}
    assert lost == failure


def test_a_folder_without_lines_or_with_a_missing_case_is_refused(tmp_path: Path) -> None:
    refused = RUNNER.invoke(app, ["report", str(tmp_path)])
    assert refused.exit_code == 2 and "no benchmark is finished" in refused.output
    line = {"bench": "stand", "robot": "g1", "seeds": 1, "figures": {}, "passed": True, "load": {}, "notes": []}
    line |= {"keys": ["lost"], "command": "", "revision": "", "versions": {}}
    (tmp_path / REPORTS).write_text(json.dumps(line) + "\n")
    refused = RUNNER.invoke(app, ["report", str(tmp_path)])
    assert refused.exit_code == 2 and "'lost'" in refused.output


def test_the_packaged_suites_are_of_benchmarks_and_robots_that_there_are() -> None:
    from models.profile import robot_names

    quick, full = parts_of("quick"), parts_of("full")
    for part in (*quick.values(), *full.values()):
        assert set(part.robots) <= set(robot_names())
    assert list(full) == [name for name in catalogue() if name != "scaling"]
    assert set(quick) <= set(full)
    for bench in full:
        assert catalogue()[bench].info.keys and catalogue()[bench].info.figures


def test_a_command_says_how_to_measure_again() -> None:
    assert command_of(Part(("g1",), 2, ("left",)), catalogue()["push_walk"], "g1") == (
        "poise bench push --robot g1 --seeds 2 --mode walk --direction left"
    )
    assert command_of(Part(("talos",), 1, ("stop", "top")), catalogue()["walk"], "talos") == (
        "poise bench walk --robot talos --seeds 1 --scenario stop --scenario top"
    )
