"""The pictures of failed trials and of the push maps: their numbers, and that JSON is enough to draw them."""

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks.cli import app
from benchmarks.core.benchmark import catalogue
from benchmarks.core.harness import Case, Report, read_json, write_json
from benchmarks.stability import falls, push_map
from benchmarks.stability.falls import AFTER, LEG_JOINTS, OTHER_JOINTS, draw_fall, last_moments, moments_since
from benchmarks.stability.push import direction_name
from bridge.closed_loop import ClosedLoop
from models.types import Mode

LOAD = {"before": [0.0], "after": [0.0], "cores": 1}


@pytest.fixture(scope="module")
def loop() -> ClosedLoop:
    """A robot that is pushed to the left off its feet, after a walk command; shared, as no test runs it on."""
    loop = ClosedLoop("g1", record_period_s=0.01)
    loop.run(0.3)
    loop.command("walk")
    loop.run(0.2)
    loop.apply_push((0.0, 1000.0, 0.0), 0.1)
    while not loop.fallen and loop.t < 6.0:
        loop.run(0.02)
    assert loop.fallen
    loop.run(0.3)  # lying on the floor
    return loop


@pytest.fixture(scope="module")
def moments(loop: ClosedLoop) -> Case:
    return last_moments(loop, loop.t)


def test_the_signals_of_standing_are_those_of_a_robot_that_stands(moments: Case, loop: ClosedLoop) -> None:
    pushed = next(t for t, text in moments["events"] if text.startswith("push"))
    rest = (np.array(moments["t"]) < pushed) & (np.array(moments["t"]) > pushed - 0.1)
    low, high = np.array(moments["soles_low"])[rest], np.array(moments["soles_high"])[rest]
    assert (low[:, 0, 1] > 0.05).all() and (high[:, 1, 1] < -0.05).all()  # left, right of the CoM
    assert (low[:, :, 0] < 0.0).all() and (high[:, :, 0] > 0.0).all()
    for name in ("dcm", "dcm_seen", "cop", "cmp"):
        assert np.abs(np.array(moments[name])[rest]).max() < 0.06
    for name in ("loads", "planned_loads"):
        assert np.array(moments[name])[rest].sum(axis=1) == pytest.approx(1.0, abs=0.15)
    assert np.isnan(np.array(moments["aims"])[rest]).all()
    assert np.abs(np.array(moments["heights"])[rest]).max() < 0.005
    assert np.abs(np.array(moments["tilts"])[rest]).max() < 2.0
    assert np.abs(np.array(moments["base_tilt"])[rest]).max() < 3.0
    assert set(np.array(moments["status"])[rest]) == {"optimal"}


def test_the_signals_of_the_fall_tell_where_to(moments: Case) -> None:
    assert np.nanmax(np.array(moments["dcm"])[:, 1]) > 0.2  # the push was to the left
    aims = np.array(moments["aims"])
    assert np.isfinite(aims).any() and not np.isfinite(aims).all(axis=2).all(axis=1).any()  # never both feet at once
    loads, swings = np.array(moments["loads"]), np.isfinite(aims[:, :, 0])
    for foot in range(2):
        if swings[:, foot].any():
            assert loads[swings[:, foot], foot].mean() < loads[swings[:, foot], 1 - foot].mean()


def test_the_joints_shown_are_those_nearest_to_their_limits_before_the_robot_was_given_up(
    moments: Case, loop: ClosedLoop
) -> None:
    model, acting = loop.robot, [mode is not Mode.DAMP for mode in loop.log.modes]
    legs = {index - 6 for foot in model.feet for index in foot.joint_ids_v}
    for name in ("torques", "margins"):
        shown = [model.joint_names.index(joint) in legs for joint in moments[name]]
        assert shown == [True] * LEG_JOINTS + [False] * OTHER_JOINTS
        assert all(len(values) == len(moments["t"]) for values in moments[name].values())
    joints = loop.log.true_q[acting, 7:]
    margins = np.degrees(np.minimum(joints - model.q_lower, model.q_upper - joints).min(axis=0))
    expected = sorted(legs, key=lambda i: margins[i])[:LEG_JOINTS]
    assert list(moments["margins"])[:LEG_JOINTS] == [model.joint_names[i] for i in expected]
    assert max(max(values) for values in moments["torques"].values()) > 0.95


def test_what_happens_long_after_the_robot_was_given_up_is_left_out(moments: Case) -> None:
    modes, t = np.array(moments["mode"]), np.array(moments["t"])
    assert modes[-1] == "damp"
    assert t[-1] - t[modes == "damp"][0] <= AFTER + 1e-6
    assert any(text.startswith("mode damp") for _, text in moments["events"])


def given_up(loop: ClosedLoop) -> float:
    return next(float(t) for t, mode in zip(loop.log.t, loop.log.modes, strict=True) if mode is Mode.DAMP)


@pytest.mark.parametrize("duration", [0.2, 0.02])  # the robot lies on the floor for 0.3 s and longer
def test_the_rows_are_the_last_ones_before_the_robot_was_given_up(loop: ClosedLoop, duration: float) -> None:
    shown = last_moments(loop, duration)
    assert shown["t"][0] == pytest.approx(given_up(loop) - duration, abs=0.011)
    assert shown["mode"][0] == "walk" and shown["mode"][-1] == "damp"


def test_a_robot_that_was_given_up_before_the_first_row_asked_for_is_shown_from_then_on(loop: ClosedLoop) -> None:
    shown = moments_since(loop, loop.t)
    assert shown["t"][0] == pytest.approx(given_up(loop), abs=1e-4)
    assert set(shown["mode"]) == {"damp"}
    assert len(shown["torques"]) == LEG_JOINTS + OTHER_JOINTS


def test_a_robot_that_is_not_given_up_is_shown_to_the_end_of_its_log() -> None:
    log = SimpleNamespace(t=np.array([0.0, 0.5, 1.0]), modes=[Mode.STAND, Mode.WALK, Mode.WALK])
    assert falls._end(log) == 1.0


def test_the_rows_are_few(loop: ClosedLoop, monkeypatch: pytest.MonkeyPatch) -> None:
    last = last_moments(loop, 0.2)["t"][-1]
    monkeypatch.setattr(falls, "ROWS", 20)
    thin = last_moments(loop, math.inf)["t"]
    assert 10 <= len(thin) <= 20 and thin[-1] == last


def case(k: int, moments: Case) -> Case:
    dv = 0.6 + 0.1 * k
    return {
        "robot": "g1", "mode": "walk", "seed": 0, "angle": 0.25 * math.pi * k, "mass": 33.0, "dv": dv, "pushes": 4,
        "impulse": 33.0 * dv, "ankle_dv": 0.4, "steps_dv": 1.5, "failed_dv": dv + 0.1, "failed_phase": 1,
        "reason": "base tilted", "moments": moments, "bound_dv": 0.5, "ratio": dv / 0.5,
    }  # fmt: skip


def draw(report: Report, folder: Path) -> list[str]:
    """Names of the pictures that a report's JSON gives on the command line."""
    write_json(report, folder / "report.json")
    result = CliRunner().invoke(app, ["draw", str(folder / "report.json"), str(folder / "plots")])
    assert result.exit_code == 0, result.output
    files = sorted((folder / "plots").iterdir())
    assert all(file.stat().st_size > 10_000 for file in files)
    return [file.name for file in files]


def test_a_push_map_and_its_limiting_failure_are_drawn_from_json(moments: Case, tmp_path: Path) -> None:
    cases = [case(k, moments if k == 0 else {}) for k in range(8)]
    files = draw(Report("push_walk", "folder/g1.yaml", 1, {}, cases, False, LOAD), tmp_path)
    assert files == ["push-failure-walk-g1.png", "push-map-walk-g1.png"]


def test_a_map_of_pushes_that_were_all_taken_has_no_failure(tmp_path: Path) -> None:
    taken: dict[str, Any] = {"reason": "", "failed_dv": math.nan, "moments": {}}
    report = Report("push_step", "folder/g1.yaml", 1, {}, [{**case(k, {}), **taken} for k in range(8)], True, LOAD)
    assert draw(report, tmp_path) == ["push-map-step-g1.png"]
    assert push_map.case_lines(report.cases)[1].endswith("-")


def test_the_map_of_pushes_without_a_step_is_drawn(tmp_path: Path) -> None:
    report = Report("push", "folder/g1.yaml", 1, {}, [case(k, {}) for k in range(8)], True, LOAD)
    assert [file.name for file in catalogue()["push"].load().plots(report, tmp_path)] == ["push-g1.png"]


@pytest.mark.long
def test_the_first_failure_of_each_scenario_on_terrain_is_drawn(moments: Case, tmp_path: Path) -> None:
    outcome = {"survived": False, "distance": 0.4, "reason": "base tilted", "moments": moments}
    cases = [
        {"robot": "g1", "seed": seed, "scenario": name, **outcome} for name in ("tiles", "soft") for seed in (0, 1)
    ]
    files = draw(Report("terrain", "folder/g1.yaml", 2, {}, cases, False, LOAD), tmp_path)
    assert files == ["terrain-g1-soft.png", "terrain-g1-tiles.png", "terrain-g1.png"]


@pytest.mark.long
def test_a_failure_is_drawn_the_same_from_json(moments: Case, tmp_path: Path) -> None:
    write_json(Report("walk", "g1", 1, {}, [{"moments": moments}], False, LOAD), tmp_path / "report.json")
    again = read_json(tmp_path / "report.json").cases[0]["moments"]
    first, second = (draw_fall(m, "fall", tmp_path / f"{i}.png") for i, m in enumerate((moments, again)))
    assert first.read_bytes() == second.read_bytes()


@pytest.mark.parametrize("text", ["{}", '{"bench": "os"}'])
def test_what_is_no_report_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "report.json").write_text(text)
    assert CliRunner().invoke(app, ["draw", str(tmp_path / "report.json"), str(tmp_path)]).exit_code == 2


def test_a_report_of_an_unknown_benchmark_is_refused(tmp_path: Path) -> None:
    write_json(Report("os", "g1", 1, {}, [], True, LOAD), tmp_path / "report.json")
    result = CliRunner().invoke(app, ["draw", str(tmp_path / "report.json"), str(tmp_path)])
    assert result.exit_code == 2 and "unknown benchmark" in result.output


def test_directions_have_names() -> None:
    assert [direction_name(0.5 * math.pi * k) for k in range(4)] == ["forward", "left", "backward", "right"]
    assert direction_name(1.75 * math.pi) == "forward-right"
    assert direction_name(math.radians(30.0)) == "30 deg"
