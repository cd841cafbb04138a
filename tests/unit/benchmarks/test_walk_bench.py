"""The walking benchmark: what it measures, and that its verdict depends on every bound."""

import math
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.core.harness import Report
from benchmarks.stability import walk, walk_cases
from benchmarks.stability.walk_cases import speed_error, tracking_error
from models.errors import ConfigError, PoiseError
from models.robot_model import RobotModel
from models.types import CommandReply, Mode


def good() -> list[dict[str, Any]]:
    """Results of one perfect seed of TALOS."""
    results = walk.cases("talos", range(1))
    scores = {
        "fell": False,
        "reason": "",
        "tracking_error": 0.01,
        "cost_of_transport": 0.5,
        "foot_slip": 0.001,
        "moments": {},
    }
    outcome: dict[str, dict[str, Any]] = {
        "steady": {**scores, "speed_error": 0.0},
        "stop": {"fell": False, "reason": "", "steps": 2, "stood": True, "drift": 0.001, "ok": True},
        "top": {"top_speed": 0.8, "reason": "0.9 m/s: base tilted", "moments": {}},
    }
    return [{**case, **outcome[case["kind"]], "velocity": list(case.get("command", ()))} for case in results]


def test_a_contender_has_the_scenarios_that_need_no_modes_of_poise() -> None:
    cases = walk.cases("g1", range(2), contender="some.module:Class")
    assert {case["kind"] for case in cases} == set(walk.CONTESTED)
    assert all(case["contender"] == "some.module:Class" for case in cases)
    assert not any("contender" in case for case in walk.cases("g1", range(2)))
    with pytest.raises(ConfigError, match="unknown scenario 'stop'"):
        walk.cases("g1", range(1), ("stop",), "some.module:Class")


def test_a_perfect_walk_passes() -> None:
    figures, broken = walk.judge("talos", good())
    assert broken == []
    assert figures["falls"] == 0.0 and figures["walks"] == 6.0
    assert figures["speed_error_mean"] == 0.0 and figures["top_speed"] == 0.8


@pytest.mark.parametrize(
    ("kind", "change", "says"),
    [
        ("steady", {"fell": True, "reason": "base tilted"}, "fell: forward"),
        ("steady", {"velocity": [0.35, 0.0, 0.0]}, "mean velocity"),
        ("steady", {"velocity": [math.nan, 0.0, 0.0]}, "mean velocity"),
        ("stop", {"fell": True}, "fell: stop"),
        ("stop", {"ok": False}, "stop, seed 0"),
        ("top", {"top_speed": 0.3, "reason": "0.4 m/s: fell"}, "top speed, seed 0"),
    ],
)
def test_every_bound_decides(kind: str, change: dict[str, Any], says: str) -> None:
    results = [{**case, **change} if case["kind"] == kind else case for case in good()]
    _, broken = walk.judge("talos", results)
    assert any(says in line for line in broken)


def test_a_choice_of_scenarios_is_judged_by_itself() -> None:
    chosen = walk.cases("g1", range(3), ("random", "left"))
    assert [case["scenario"] for case in chosen] == ["random", "left"] * 3
    figures, broken = walk.judge("talos", [case for case in good() if case["scenario"] in ("left", "top")])
    assert broken == []
    assert "speed_error_left" in figures and "speed_error_forward" not in figures and "stop_steps_max" not in figures


def test_an_unknown_scenario_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"--robot g1: unknown scenario 'uphill'; known: forward, .*stop, top"):
        walk.cases("g1", range(1), ("forward", "uphill"))


def test_the_top_speed_is_the_highest_that_is_held(monkeypatch: pytest.MonkeyPatch) -> None:
    def steady(robot: str, seed: int, command: tuple[float, float, float], duration: float) -> dict[str, Any]:
        fell = command[0] > 0.65
        return {
            "fell": fell,
            "reason": "base tilted",
            "velocity": [command[0]],
            "moments": {"t": [1.0]} if fell else {},
        }

    monkeypatch.setattr(walk_cases, "steady", steady)
    case = walk_cases.top_speed("g1", 0)
    assert case == {"top_speed": 0.6, "reason": "0.7 m/s: base tilted", "moments": {"t": [1.0]}}


def test_a_speed_that_is_not_held_without_a_fall_is_explained_too(monkeypatch: pytest.MonkeyPatch) -> None:
    def steady(robot: str, seed: int, command: tuple[float, float, float], duration: float) -> dict[str, Any]:
        return {"fell": False, "reason": "", "velocity": [min(command[0], 0.62)], "moments": {}}

    monkeypatch.setattr(walk_cases, "steady", steady)
    monkeypatch.setattr(walk_cases, "_loop", lambda robot: robot)
    monkeypatch.setattr(walk_cases, "last_moments", lambda loop, duration: {"t": [duration]})
    case = walk_cases.top_speed("g1", 0)
    assert case == {"top_speed": 0.6, "reason": "0.7 m/s: mean 0.62 m/s", "moments": {"t": [walk.walk_config().shown]}}


class Robot:
    """A closed loop that does not move."""

    robot = RobotModel.load("talos")
    fall_reason, faults, t, foot_slip = "base tilted", (), 0.0, np.zeros(2)
    truth = SimpleNamespace(q=robot.standing_configuration())

    def __init__(self, reply: CommandReply, *, fallen: bool) -> None:
        self.reply, self.fallen, self.mode = reply, fallen, Mode.DAMP
        self.velocities: list[tuple[float, ...]] = []

    def reset(self, seed: int) -> None:
        pass

    def command(self, text: str) -> CommandReply:
        return self.reply

    def set_velocity(self, *velocity: float) -> None:
        self.velocities.append(velocity)


@pytest.mark.parametrize(
    "measure",
    [
        lambda: walk_cases.steady("g1", 0, (0.3, 0.0, 0.0), 5.0),
        lambda: walk_cases.random_walk("g1", 0),
        lambda: walk_cases.stop("g1", 0),
    ],
)
def test_a_robot_that_would_not_walk_is_no_result(measure: Callable[[], Any], monkeypatch: pytest.MonkeyPatch) -> None:
    robot = Robot(CommandReply(False, "mode damp is latched"), fallen=False)
    monkeypatch.setattr(walk_cases, "_loop", lambda name: robot)
    with pytest.raises(PoiseError, match="walk: mode damp is latched"):
        measure()


def test_a_robot_that_falls_at_once_has_fallen(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = Robot(CommandReply(True, ""), fallen=True)
    monkeypatch.setattr(walk_cases, "_loop", lambda name: robot)
    monkeypatch.setattr(walk_cases, "last_moments", lambda loop, duration: {"t": [duration]})
    case = walk_cases.random_walk("g1", 0)
    assert case["fell"] and case["reason"] == "base tilted at 0.0 s"
    assert case["velocity"] == [0.0, 0.0, 0.0] and math.isnan(case["tracking_error"])
    assert len(robot.velocities) == 1


def test_a_stop_that_fails_is_reported_in_words() -> None:
    results = [
        {**case, "ok": False, "stood": False, "moments": {"t": [0.0]}} for case in good() if case["kind"] == "stop"
    ]
    assert walk.judge("talos", results)[1] == ["stop, seed 0: did not stand after 2 steps, then drifted 1.0 mm"]


def test_the_plot_shows_what_was_measured(tmp_path: Path) -> None:
    def drawn(kinds: tuple[str, ...]) -> list[str]:
        report = Report("walk", "talos", 1, {}, [case for case in good() if case["kind"] in kinds], True, {})
        return [file.name for file in walk.Walk("walk").plots(report, tmp_path) if file.stat().st_size > 5_000]

    assert drawn(("steady", "top")) == drawn(("top",)) == drawn(("steady",)) == ["walk-talos.png"]
    assert drawn(("stop",)) == []


def test_an_unknown_robot_is_refused() -> None:
    with pytest.raises(ConfigError, match="no scenarios for 'atlas'"):
        walk.cases("atlas", range(1))


def test_the_cases_cover_every_scenario_and_seed() -> None:
    cases = walk.cases("g1", range(2))
    names = {case["scenario"] for case in cases}
    assert names == {"forward", "backward", "left", "right", "turn", "random", "stop", "top"}
    assert len(cases) == 2 * len(names)


def test_the_speed_error_is_relative() -> None:
    assert speed_error(np.array([0.54, 0.0, 0.0]), (0.6, 0.0, 0.0)) == pytest.approx(0.1)
    assert speed_error(np.array([0.0, 0.0, 0.6]), (0.0, 0.0, 0.6)) == 0.0


def test_the_tracking_error_averages_a_stride_away_but_not_an_offset() -> None:
    t = np.arange(400) * 0.05
    commands = np.tile([0.4, 0.0, 0.0], (400, 1))
    sway = np.column_stack([np.full(400, 0.4), 0.2 * np.sin(2.0 * np.pi * t), np.zeros(400)])
    assert tracking_error(sway, commands, 20) == pytest.approx(0.0, abs=1e-9)
    assert tracking_error(sway + np.array([0.05, 0.0, 0.0]), commands, 20) == pytest.approx(0.05)
    assert math.isnan(tracking_error(sway[:10], commands[:10], 20))


@pytest.mark.long
def test_a_short_walk_is_measured() -> None:
    """Three seconds of the real thing: it goes where the command says, and walking costs energy."""
    case = walk_cases.steady("talos", 0, (0.3, 0.0, 0.0), 5.0)
    assert not case["fell"]
    assert case["speed_error"] < 0.2
    assert 0.1 < case["cost_of_transport"] < 3.0
