"""Rows of ``poise bench faults`` hold, and fail when the guard that they are about is taken away."""

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from benchmarks.core.benchmark import catalogue
from benchmarks.core.harness import Case, Options
from benchmarks.faults import faults
from benchmarks.faults.fault_acts import ACTS
from benchmarks.faults.faults import Row, config, measure, with_knee
from models.errors import ConfigError
from tests.fault_guards import GUARDS, RATE, WITHOUT_GUARD


def test_every_act_is_of_a_row_and_every_row_has_its_act() -> None:
    named = {row.act for row in config().rows.values()} - {""}
    assert named == set(ACTS)


def test_the_knees_name_is_put_in_everywhere() -> None:
    assert with_knee([{"target": "joint:{knee}", "delay": 1.0}], "k") == [{"target": "joint:k", "delay": 1.0}]


def test_an_unknown_row_is_refused_with_those_there_are() -> None:
    with pytest.raises(ConfigError, match="unknown scenario 'meteor'; known: joints_out_10ms"):
        catalogue()["faults"].load().run(Options(scenarios=("meteor",)))


def test_every_row_has_a_guard_or_needs_none() -> None:
    assert not set(GUARDS) & set(WITHOUT_GUARD)
    assert set(GUARDS) | set(WITHOUT_GUARD) == set(config().rows)
    assert all(config().rows[name].expect == "rides" for name in WITHOUT_GUARD)


def test_every_row_that_damps_or_refuses_names_a_reason() -> None:
    assert all(row.reason for row in config().rows.values() if row.expect in ("damps", "refuses"))


QUICK = ("knee_dead", "trajectory_nan", "imu_flipped")
"""In every run of the tests."""

STRIDE = 20
"""Runs of the tests until each of the other rows has been in one: each commit has its own twentieth."""


def _rotating() -> frozenset[str]:
    """The rows of this commit; without git, those of the first."""
    count = ["git", "-C", str(Path(__file__).parent), "rev-list", "--count", "HEAD"]
    try:
        turn = int(subprocess.run(count, capture_output=True, text=True, check=True).stdout)
    except (OSError, subprocess.CalledProcessError):
        turn = 0
    return frozenset(list(GUARDS)[turn % STRIDE :: STRIDE])


IN_EVERY_RUN = _rotating().union(QUICK)


def holds(name: str) -> bool:
    try:
        return bool(measure("g1", 0, name)["ok"])
    except (ArithmeticError, LookupError, ValueError):  # what a guard keeps from the arithmetic behind it
        return False


@pytest.mark.long
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in IN_EVERY_RUN else pytest.mark.slow) for name in GUARDS]
)
def test_a_row_holds_and_fails_without_its_guard(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo leaves a log where it is given a torque that is no number
    assert holds(name)
    with GUARDS[name].gone():
        assert not holds(name)


@pytest.mark.slow
def test_a_row_fails_when_the_drivers_limit_no_rate() -> None:
    with RATE.gone():
        assert not holds("joints_out_40ms")


def only_to(limit: float) -> Callable[[str, int, Row], Case]:
    """A robot that rides through delays up to a limit [s]."""

    def trial(robot: str, seed: int, row: Row) -> Case:
        ok = row.faults[0]["delay"] <= limit
        return {"ok": ok, "seen": "mode", "reason": "too late", "torque_step": 0.5}

    return trial


def test_a_margin_is_the_largest_delay_that_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(faults, "trial", only_to(0.0234))
    case = measure("g1", 0, "delay_margin")
    assert 0.0234 - config().delays.resolution <= case["margin"] <= 0.0234
    assert case["ok"] and case["reason"] == "then mode, too late"


def test_a_margin_below_what_is_required_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(faults, "trial", only_to(0.0075))
    assert measure("g1", 0, "delay_margin_walk")["ok"] is False


@pytest.mark.slow
def test_joint_states_that_never_come_on_time_have_a_margin() -> None:
    report = catalogue()["faults"].load().run(Options(scenarios=("delay_margin_walk",)))
    assert report.passed and report.figures["delay_margin_walk_s"] < config().delays.largest
