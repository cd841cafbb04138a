"""Shares of trials that were survived, with their confidence."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from scipy.stats import binomtest

from benchmarks.harness import Case, Report
from benchmarks.results import NOT_RUN

CONFIDENCE = 0.95
"""Of the two-sided intervals [-]."""


@dataclass(frozen=True, slots=True)
class Share:
    """How many of some trials were survived.

    Attributes:
        name: Of the trials.
        robot: Which one tried.
        survived: How many were survived.
        total: How many there were.
    """

    name: str
    robot: str
    survived: int
    total: int

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's interval of the share at ``CONFIDENCE`` [-]."""
        return wilson(self.survived, self.total)


def wilson(survived: int, total: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Wilson's two-sided interval of a share [-].

    Args:
        survived: How many trials were survived.
        total: Of how many, at least one.
        confidence: Of the interval [-].
    """
    found = binomtest(survived, total).proportion_ci(confidence, method="wilson")
    return float(found.low), float(found.high)


def shares(reports: Iterable[Report]) -> list[Share]:
    """What was survived in every benchmark that can be survived, by scenario."""
    found: list[Share] = []
    for report in reports:
        groups: dict[str, list[bool]] = {}
        for case in report.cases:
            outcome = _outcome(report.bench, case)
            if outcome is not None:
                groups.setdefault(f"{report.bench}: {outcome[0]}", []).append(outcome[1])
        found += [Share(name, report.robot, sum(held), len(held)) for name, held in groups.items()]
    return found


def _outcome(bench: str, case: Case) -> tuple[str, bool] | None:
    """Group of a case, and whether it was survived; None where there is nothing to survive."""
    if bench == "stand":
        return case.get("motion", "quiet"), bool(case["ok"])
    if bench == "walk":  # the search for the top speed may fall
        return None if case["kind"] == "top" else (case["scenario"], not case["fell"])
    if bench == "terrain":
        return case["scenario"], bool(case["survived"])
    if bench == "estimate":
        return case["scenario"], bool(case["ok"])
    if bench == "calibrate":
        return case["way"], bool(case["ok"])
    if bench in ("faults", "graph_faults"):
        return None if case.get(NOT_RUN) else (case["group"], bool(case["ok"]))
    return None


def lasting(ends: Sequence[float], at: Sequence[float]) -> list[tuple[float, float, float]]:
    """Share of trials that last at least so long, or take at least so much, with its interval.

    Args:
        ends: Where each trial ended.
        at: Where the share is asked for.

    Returns:
        Share, and the bounds of its interval, for each of ``at`` [-].
    """
    counts = [sum(end >= x for end in ends) for x in at]
    return [(count / len(ends), *wilson(count, len(ends))) for count in counts]
