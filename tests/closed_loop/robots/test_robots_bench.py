"""``poise bench robots``: which robots, how a refusal and a verdict are recorded, and the tables."""

from contextlib import nullcontext
from pathlib import Path

import pytest

from benchmarks.core.benchmark import catalogue
from benchmarks.core.harness import Options, Report
from benchmarks.stability import robots_page
from benchmarks.stability.robots import GENERATED, Robots, check, check_progress, robot_files, run_trial, write_robot
from benchmarks.stability.robots_page import PICTURE, TABLE, rows, trial_rows, write_page
from models.errors import ConfigError, PoiseError
from models.types import Velocity
from models.urdf import data_folder

BOLT = "bolt_description/robots/bolt.urdf"


def test_the_files_are_those_of_the_installed_packages(tmp_path: Path) -> None:
    files = robot_files()
    assert files[BOLT] == data_folder() / "robots" / BOLT
    assert all(path.is_file() for path in files.values())
    assert write_robot(BOLT, tmp_path) == files[BOLT]
    assert "<robot" in write_robot(f"{GENERATED}four-joint legs", tmp_path).read_text()


def test_every_robot_is_checked_once_a_seed_and_the_long_runs_are_those_of_the_chosen() -> None:
    cases = Robots("robots").cases(Options(seeds=2))
    names = {case["robot"] for case in cases}
    assert len(cases) == 2 * len(names) and BOLT in names and f"{GENERATED}one arm" in names
    long = Robots("robots_trials").cases(Options(seeds=5))
    assert len(long) == 2 * 25 and {case["robot"] for case in long} == {"g1", "talos"}
    assert {case["trial"] for case in long} == {"stand", "motions", "forward", "sideways", "on the spot"}
    with pytest.raises(ConfigError, match="unknown scenario 'no_robot'"):
        Robots("robots").cases(Options(scenarios=("no_robot",)))
    with pytest.raises(ConfigError, match="--scenario 'talos'"):
        Robots("robots").cases(Options("talos"))


def test_a_file_without_two_legs_is_refused_with_the_reason() -> None:
    assert check(BOLT, 0)["refused"].startswith("no feet: the leg that ends at joint 'FL_KFE' has 3 joints")
    case = run_trial(BOLT, "stand", 0)
    assert not case["passed"] and "no feet" in case["reason"]


@pytest.mark.parametrize(("robot", "passed"), [(BOLT, True), (f"{GENERATED}one arm", False)])
def test_no_generated_robot_may_be_refused(robot: str, passed: bool) -> None:
    bench = Robots("robots")
    walks = {"robot": "a/b/c.urdf", "trials": {"walk": [True, ""]}, "time": 9.0}
    figures = bench.figures([walks, {"robot": robot, "refused": "no feet"}])
    report = Report(bench.name, "g1", 1, figures, [], True, {})
    assert bench.passed(report) is passed and set(bench.bounds(report)) <= set(figures)


def test_the_table_has_a_row_a_robot_and_the_refused_files() -> None:
    trials = {
        "stand": [True, "5 s: CoM drift 2.0 mm, slip 0.00 mm"],
        "walk": [False, "fallen"],
        "push": [True, "0.3 m/s from x, y"],
    }
    tried = {
        "robot": "a/b/c.urdf",
        "seed": 0,
        "mass": 41.2,
        "legs": 6,
        "arms": 0,
        "time": 21.4,
        "limits": ["walk: fallen"],
    }
    refused = [{"robot": name, "seed": 0, "refused": f"no feet: joint '{name}'"} for name in ("bolt", "nut")]
    lines = rows([tried | {"trials": trials}, *refused])
    cells = [cell.strip() for cell in lines[2].strip("|").split("|")]
    assert cells == [
        *("`a/b/c.urdf`", "41 kg", "6 joints", "CoM drift 2.0 mm", "-", "no arm", "no", "0.3 m/s from x", "21 s"),
        "walk: fallen",
    ]
    assert lines[-1] == "- no feet: joint ...: `bolt`, `nut`"


def test_the_picture_has_the_robots_that_walk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kind = f"{GENERATED}four-joint legs"

    def case(name: str, walks: bool) -> dict[str, object]:
        trials = {"walk": [walks, "0.7 m"]}
        return {"robot": name, "mass": 40.0, "legs": 4, "arms": 2, "time": 9.0, "limits": [], "trials": trials}

    asked: list[str] = []

    def run(module: str, arguments: list[str], picture: Path, timeout: float) -> str:
        asked.extend(arguments)
        return "" if kind in arguments else "no pictures: EGL was not found"

    monkeypatch.setattr(robots_page, "run_renderer", run)
    files = write_page([case(kind, True), case("a/b/c.urdf", False)], tmp_path, long=False)
    assert files == [tmp_path / TABLE, tmp_path / PICTURE]
    assert asked == [str(tmp_path / PICTURE), kind]
    with pytest.warns(UserWarning, match="EGL was not found"):
        assert write_page([case("d.urdf", True)], tmp_path, long=False) == [tmp_path / TABLE]


@pytest.mark.parametrize(
    ("gone", "velocity", "enough"),
    [
        ((6.0, 0.5, 0.2), (0.5, 0.0, 0.0), True),
        ((-6.0, 0.5, 0.2), (0.5, 0.0, 0.0), False),
        ((0.5, 6.0, 0.2), (0.5, 0.0, 0.0), False),
        ((0.1, 3.0, 0.0), (0.0, 0.2, 0.0), True),
        ((0.1, -3.0, 0.0), (0.0, 0.2, 0.0), False),
        ((0.1, 0.0, 4.0), (0.0, 0.0, 0.3), True),
        ((0.1, 0.0, -4.0), (0.0, 0.0, 0.3), False),
        ((-0.1, 0.1, -0.1), (0.0, 0.0, 0.0), True),
    ],
)
def test_only_the_way_that_was_commanded_counts(gone: Velocity, velocity: Velocity, enough: bool) -> None:
    with nullcontext() if enough else pytest.raises(PoiseError, match="displacement"):
        check_progress(gone, velocity)


def test_one_failed_run_of_twenty_five_is_allowed(tmp_path: Path) -> None:
    bench = Robots("robots_trials")
    cases = [{"robot": "g1", "trial": "stand", "seed": k, "passed": k > 0, "reason": "fell"} for k in range(25)]
    figures = bench.figures(cases)
    assert set(catalogue()[bench.name].info.least) <= set(figures)
    assert figures == {"robots": 1, "runs": 25, "passed": 24, "passed_share_min": 0.96}
    report = Report(bench.name, "g1", 25, figures, cases, True, {})
    assert bench.passed(report) and "fell" in bench.notes(report)[-1]
    two = [case | {"passed": case["seed"] > 1} for case in cases]
    assert not bench.passed(Report(bench.name, "g1", 25, bench.figures(two), two, True, {}))
    assert trial_rows(cases)[2].startswith("| g1 | 24 of 25 |")
    (file,) = bench.plots(report, tmp_path)
    assert "24 of 25" in file.read_text()


def test_both_modes_are_one_command() -> None:
    modes = [each.info.mode for each in catalogue().values() if each.command == "robots"]
    assert modes == ["check", "trials"]
