"""The hour of random commands and pushes: what it counts, and that its verdict depends on every bound."""

from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest

from benchmarks.core.benchmark import catalogue
from benchmarks.core.harness import Case, Options
from benchmarks.stability import endurance
from benchmarks.stability.endurance import hour
from models.robot_model import RobotModel

GIVEN = endurance._config()
BENCH = catalogue()["endurance"].load()
NOTHING = dict.fromkeys(GIVEN.shares, 0.0)


def minute(robot: RobotModel, duration: float = 3.0, **changes: Any) -> Case:
    """A short one, in which somebody does something every fifth of a second."""
    given = replace(GIVEN, **{"duration": duration, "pause": (0.2, 0.2), "warm_up": 0.5, "sample": 0.5, **changes})
    with patch.object(endurance, "_config", lambda: given):
        return hour(robot.name, 0)


@pytest.fixture(scope="module")
def short(g1: RobotModel) -> Case:
    """Words and nonsense only."""
    return minute(g1, shares={**NOTHING, "word": 0.5, "nonsense": 0.5})


@pytest.mark.long
def test_everything_that_is_done_is_counted(short: Case) -> None:
    assert short["word"] + short["nonsense"] == 15
    assert short["velocity"] == short["push"] == 0
    assert short["nonsense"] <= short["refused"] < 15
    assert sum(short["modes"].values()) == pytest.approx(1.0)


@pytest.mark.long
def test_nothing_happens_to_the_robot(short: Case) -> None:
    assert short["ends"] == []
    assert short["torque_step"] <= 1.0 + 1e-9
    assert [row[0] for row in short["memory"]] == pytest.approx([0.0, 0.5, 1.0, 1.5, 2.0, 2.5])


@pytest.mark.long
def test_a_fall_is_reported_and_the_hour_goes_on(g1: RobotModel) -> None:
    case = minute(g1, push_stand=2.0, push_walk=2.0, shares={**NOTHING, "push": 1.0})
    assert not case["ok"]
    assert "after push of" in case["ends"][0]
    assert case["push"] == 15


@pytest.mark.parametrize(
    "change", [{"memory_limit": 0.5}, pytest.param({"torque_step_limit": 1e-6}, marks=pytest.mark.long)]
)
def test_every_bound_decides(g1: RobotModel, change: dict[str, float]) -> None:
    usage = iter((500.0, 100.0, 101.0, 102.0))  # the leak stays below an earlier peak
    words = {**NOTHING, "word": 1.0}
    with patch.object(endurance, "resident", lambda pid: next(usage)):
        case = minute(g1, 2.0, shares=words, **{"memory_limit": 10.0, **change})
    assert case["memory_growth"] == 2.0
    assert case["ends"] == [] and not case["ok"]


def test_the_report_draws_and_judges(short: Case, tmp_path: Path) -> None:
    with patch.object(
        endurance.Endurance,
        "measure",
        staticmethod(lambda robot, seed: {**short, "ok": seed == 0, "ends": ["at 1.0 s: x"] * seed}),
    ):
        report = BENCH.run(Options(seeds=2))
    assert not report.passed
    assert report.figures["falls_and_faults"] == 1.0
    assert report.notes == ["seed 1 at 1.0 s: x"]
    assert BENCH.plots(report, tmp_path)[0].stat().st_size > 0
