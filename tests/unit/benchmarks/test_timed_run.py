"""What the benchmarks of time share: every seed is judged, the notes say the same as the verdict."""

import gc
import math

import pytest

from benchmarks.core.benchmark import Bound, at_most
from benchmarks.core.harness import Case, Options, Report
from benchmarks.core.timed_run import TimedBenchmark, collector_off, over_seeds


class Timed(TimedBenchmark):
    """Two figures with an upper bound each."""

    def bounds(self, report: Report) -> dict[str, Bound]:
        return at_most({"tick_us_p99": 100.0, "ratio": 2.0})


def cases(*ratios: float) -> list[Case]:
    """A seed for each ratio."""
    return [{"seed": k, "figures": {"tick_us_p99": 90.0, "ratio": ratio}} for k, ratio in enumerate(ratios)]


def judged(*ratios: float) -> tuple[bool, list[str]]:
    """Verdict and notes of the seeds, without the last note."""
    benchmark = Timed("tick")
    report = Report("tick", "g1", len(ratios), {"preempted_fraction": 0.0}, cases(*ratios), False, {})
    return benchmark.passed(report), benchmark.notes(report)[:-1]


def test_all_within_their_limits_pass() -> None:
    assert judged(1.0, 2.0, 1.5) == (
        True,
        ["ok     tick_us_p99 ≤ 100: worst 90, seed 0", "ok     ratio ≤ 2: worst 2, seed 1"],
    )


@pytest.mark.parametrize(("bad", "reported"), [(2.1, "2.1"), (math.nan, "nan"), (math.inf, "inf")])
def test_one_seed_beyond_a_limit_fails_and_is_named_though_the_median_holds(bad: float, reported: str) -> None:
    passed, lines = judged(1.0, 1.2, bad, 1.1)
    assert not passed
    assert lines == ["ok     tick_us_p99 ≤ 100: worst 90, seed 0", f"FAILED ratio ≤ 2: worst {reported}, seed 2"]


def test_the_figures_are_medians_but_the_worst_of_tails_and_failures() -> None:
    names = ("us_p50", "ratio", "us_max", "us_p999", "ticks_uncertified", "blocks_growth", "growth_kib")
    figures = over_seeds([{"figures": dict.fromkeys(names, value)} for value in (1.0, 2.0, 9.0)])
    assert figures == {name: 2.0 if name in ("us_p50", "ratio") else 9.0 for name in names}


@pytest.mark.parametrize(("worst", "passed"), [(1.9, True), (2.1, False)])
def test_a_report_has_the_verdict_of_its_notes(worst: float, passed: bool) -> None:
    def measure(robot: str, seed: int) -> Case:
        return {"figures": {"ratio": (1.0, 1.1, worst)[seed], "preempted_fraction": 0.25}}

    class Timed(TimedBenchmark):
        def bounds(self, report: Report) -> dict[str, Bound]:
            return at_most({"ratio": 2.0})

    Timed.measure = staticmethod(measure)
    report = Timed("tick").run(Options("talos", seeds=3))
    assert (report.bench, report.robot, report.seeds, report.passed) == ("tick", "talos", 3, passed)
    assert [(case["robot"], case["seed"]) for case in report.cases] == [("talos", seed) for seed in range(3)]
    assert report.figures["ratio"] == worst  # as it is judged
    assert report.notes[0] == f"{'ok    ' if passed else 'FAILED'} ratio ≤ 2: worst {worst}, seed 2"
    assert "25.00%" in report.notes[1]


def test_the_collector_is_off_and_comes_back() -> None:
    with pytest.raises(ZeroDivisionError), collector_off():
        assert not gc.isenabled()
        raise ZeroDivisionError
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0
