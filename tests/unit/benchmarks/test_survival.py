"""Wilson's interval against published values, and what counts as survived."""

import math

import pytest

from benchmarks.core.harness import Report
from benchmarks.report.report_survival import Share, lasting, shares, wilson

LOAD = {"before": [0.0] * 3, "after": [0.0] * 3, "cores": 2}


@pytest.mark.parametrize(
    ("survived", "total", "low", "high"),
    [
        # Newcombe, "Two-sided confidence intervals for the single proportion", Stat. Med. 1998, table I, method 3
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0000, 0.1611),
        (1, 29, 0.0061, 0.1718),
        (20, 20, 0.8389, 1.0000),
    ],
)
def test_the_interval_is_wilsons(survived: int, total: int, low: float, high: float) -> None:
    assert wilson(survived, total) == pytest.approx((low, high), abs=5e-5)


def test_the_interval_solves_its_equation() -> None:
    z, n = 1.959964, 20
    for bound in wilson(18, n):
        assert abs(18 / n - bound) == pytest.approx(z * math.sqrt(bound * (1.0 - bound) / n), rel=1e-5)


def test_a_curve_counts_who_lasts_and_falls_only() -> None:
    rows = lasting([1.0, 2.0, math.inf, math.inf], [0.0, 1.0, 1.5, 3.0])
    assert [share for share, _, _ in rows] == [1.0, 1.0, 0.75, 0.5]
    assert all(low <= share <= high for share, low, high in rows)
    assert rows[2][1:] == wilson(3, 4)


def test_each_benchmark_says_what_was_survived() -> None:
    cases = {
        "stand": [{"kind": "stand", "ok": True}, {"kind": "motion", "motion": "wave", "ok": False}],
        "walk": [{"kind": "steady", "scenario": "left", "fell": True}, {"kind": "top", "scenario": "top"}],
        "terrain": [{"scenario": "tiles", "survived": True}, {"scenario": "tiles", "survived": False}],
        "graph_faults": [{"group": "host", "ok": True}, {"group": "host", "ok": False, "not_run": True}],
        "tick": [{"figures": {}}],
    }
    reports = [Report(bench, "g1", 1, {}, found, True, LOAD) for bench, found in cases.items()]
    assert shares(reports) == [
        Share("stand: quiet", "g1", 1, 1),
        Share("stand: wave", "g1", 0, 1),
        Share("walk: left", "g1", 0, 1),
        Share("terrain: tiles", "g1", 1, 2),
        Share("graph_faults: host", "g1", 1, 1),
    ]
