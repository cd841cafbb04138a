"""What a suite is to measure and how far it has come, so that a report of an unfinished one says what is missing.

``plan.jsonl`` lies beside the cases. A suite that starts adds ``{"suite", "revision", "parts"}``, of each part bench,
robot and command; a part of which cases are missing adds ``{"bench", "robot", "revision", "keys", "reports"}`` when it
begins, with the keys of its cases and the number of lines in ``reports.jsonl`` by then.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.provenance import source_state
from benchmarks.results import Line, append_line, read_lines
from benchmarks.saved_reports import CASES, REPORTS

PLAN = "plan.jsonl"
"""File in a suite's folder."""

Part = tuple[str, str]
"""Bench and robot."""


@dataclass(frozen=True, slots=True)
class Missing:
    """A part of a suite that is not finished.

    Attributes:
        bench: Its name.
        robot: On which robot.
        done: Cases that are there.
        total: Cases that it has asked for by now; 0 where it has not begun.
        earlier: Whether there is a report of it, of another revision or of other cases.
    """

    bench: str
    robot: str
    done: int
    total: int
    earlier: bool

    @property
    def state(self) -> str:
        """In words."""
        told = f"{self.done} of {self.total} cases" if self.total else "not begun"
        return f"{told}; reported: an earlier measurement" if self.earlier else told


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a suite has come.

    Attributes:
        suite: Its name; empty where nobody has said what is to be measured.
        parts: How many it has.
        missing: Those that are not finished, in their order.
    """

    suite: str = ""
    parts: int = 0
    missing: tuple[Missing, ...] = ()

    def __str__(self) -> str:
        begun = [part for part in self.missing if part.total]
        done, total = sum(part.done for part in begun), sum(part.total for part in begun)
        finished = f"partial: {self.parts - len(self.missing)} of {self.parts} parts of --{self.suite} are finished"
        left = f"{done} of {total} cases of the unfinished that have begun, {len(self.missing) - len(begun)} not begun"
        return f"{finished}; {left}" if self.missing else ""


def save_plan(folder: Path, suite: str, commands: Mapping[Part, str]) -> None:
    """Add what is to be measured to a suite's folder, unless it is known.

    Args:
        folder: Of the suite.
        suite: Its name.
        commands: Command that measures each part, in their order.
    """
    parts = [[*part, command] for part, command in commands.items()]
    line = {"suite": suite, "revision": source_state(), "parts": parts}
    plans = [found for found in read_lines(folder / PLAN) if "parts" in found]
    if plans[-1:] != [line]:
        append_line(folder / PLAN, line)


def save_begun(folder: Path, part: Part, keys: Sequence[str]) -> None:
    """Add that a part begins to a suite's folder.

    Args:
        folder: Of the suite.
        part: Which one.
        keys: Of all its cases that are known by now.
    """
    reports = len(read_lines(folder / REPORTS))
    found = {"bench": part[0], "robot": part[1], "revision": source_state(), "keys": list(keys), "reports": reports}
    append_line(folder / PLAN, found)


def read_progress(folder: Path) -> Progress:
    """How far the suite has come that was started last.

    Raises:
        ConfigError: A line is damaged.
    """
    lines = read_lines(folder / PLAN)
    plans = [line for line in lines if "parts" in line]
    if not plans:
        return Progress()
    plan = plans[-1]
    begun = {_part(line): line for line in lines if "keys" in line and line["revision"] == plan["revision"]}
    reported = {_part(line): (number, line) for number, line in enumerate(read_lines(folder / REPORTS))}
    measured = {line["key"] for line in read_lines(folder / CASES) if "key" in line}
    missing = []
    for bench, robot, command in plan["parts"]:
        number, report = reported.get((bench, robot), (-1, {}))
        start = begun.get((bench, robot), {"keys": [], "reports": 0})
        other = report.get("revision") != plan["revision"] or report.get("command", command) != command
        if other or number < start["reports"]:
            done = sum(key in measured for key in start["keys"])
            missing.append(Missing(bench, robot, done, len(start["keys"]), "figures" in report))
    return Progress(plan["suite"], len(plan["parts"]), tuple(missing))


def _part(line: Line) -> Part:
    return line.get("bench", ""), line.get("robot", "")
