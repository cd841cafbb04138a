from __future__ import annotations

import json
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import pytest
from typer.testing import CliRunner

import benchmarks.cli
from benchmarks.harness import LoadMeter, Options, Report, write_json
from bridge.cli import app
from models.errors import ConfigError
from models.types import CommandReply

RUNNER = CliRunner()


def _bench(passed: bool) -> SimpleNamespace:
    def run(options: Options) -> Report:
        if options.robot == "nobody":
            raise ConfigError("unknown robot 'nobody'")
        figures = {"dv_min": 0.25}
        return Report("push", options.robot, options.seeds, figures, [], passed=passed, load=LoadMeter().read())

    def plot(report: Report, folder: Path) -> list[Path]:
        (folder / "push.png").write_bytes(b"picture")
        return [folder / "push.png"]

    return SimpleNamespace(run=run, plot=plot)


@pytest.mark.parametrize(("passed", "code"), [(True, 0), (False, 1)])
def test_a_bench_ends_with_its_verdict(
    passed: bool, code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(benchmarks.cli, "import_module", lambda name: _bench(passed))
    options = ["--robot", "talos", "--seeds", "3", "--json", str(tmp_path / "a.json"), "--plot", str(tmp_path / "p")]
    result = RUNNER.invoke(app, ["bench", "push", *options])
    assert result.exit_code == code, result.output
    assert "dv_min" in result.output and ("not passed" in result.output) == (not passed)
    data = json.loads((tmp_path / "a.json").read_text())
    assert (data["robot"], data["seeds"], data["passed"]) == ("talos", 3, passed)
    assert (tmp_path / "p/push.png").is_file()


@pytest.mark.parametrize(("mode", "module"), [("stand", "push"), ("step", "push_map"), ("walk", "push_map")])
def test_the_push_test_has_modes(mode: str, module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, str]] = []

    def imported(name: str) -> SimpleNamespace:
        def run(options: Options) -> Report:
            asked.append((name, options.mode))
            return _bench(True).run(options)

        return SimpleNamespace(run=run, plot=None)

    monkeypatch.setattr(benchmarks.cli, "import_module", imported)
    assert RUNNER.invoke(app, ["bench", "push", "--mode", mode]).exit_code == 0
    assert asked == [(f"benchmarks.{module}", mode)]
    assert RUNNER.invoke(app, ["bench", "push", "--mode", "run"]).exit_code == 2


USUAL_SEEDS = {"stand": 20, "walk": 20, "terrain": 20, "estimate": 20}
"""Of the commands that do not measure one seed."""

COMMANDS = sorted({str(command.name) for command in benchmarks.cli.app.registered_commands} - {"draw", "all", "report"})


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_runs_its_own_module_with_its_usual_seeds(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, int]] = []

    def imported(module: str) -> SimpleNamespace:
        bench = _bench(True)

        def run(options: Options) -> Report:
            asked.append((module, options.seeds))
            return bench.run(options)

        return SimpleNamespace(run=run, plot=bench.plot)

    monkeypatch.setattr(benchmarks.cli, "import_module", imported)
    assert RUNNER.invoke(app, ["bench", name]).exit_code == 0
    assert asked == [(f"benchmarks.{name}", USUAL_SEEDS.get(name, 1))]


@pytest.mark.parametrize("name", [*COMMANDS, "push_step", "push_walk"])
def test_the_report_of_every_command_is_drawn_by_its_module(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []

    def imported(module: str) -> SimpleNamespace:
        asked.append(module)
        return _bench(True)

    monkeypatch.setattr(benchmarks.cli, "import_module", imported)
    write_json(Report(name, "g1", 1, {}, [], True, LoadMeter().read()), tmp_path / "a.json")
    result = RUNNER.invoke(app, ["bench", "draw", str(tmp_path / "a.json"), str(tmp_path / "p")])
    assert result.exit_code == 0, result.output
    assert asked == [f"benchmarks.{'push_map' if name.startswith('push_') else name}"]
    assert (tmp_path / "p/push.png").is_file()


@pytest.mark.parametrize("name", benchmarks.cli.MODULES.values())
def test_every_module_measures_and_draws(name: str) -> None:
    if name == "latency":
        pytest.importorskip("rclpy")
    module = import_module(f"benchmarks.{name}")
    assert callable(module.run) and callable(module.plot)


@pytest.mark.parametrize("name", ["push", "walk", "terrain"])
def test_another_controller_can_be_tested(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def run(options: Options) -> Report:
        asked.append(options.contender)
        return _bench(True).run(options)

    monkeypatch.setattr(benchmarks.cli, "import_module", lambda module: SimpleNamespace(run=run))
    assert RUNNER.invoke(app, ["bench", name, "--contender", "some.module:Class"]).exit_code == 0
    assert asked == ["some.module:Class"]


def test_a_benchmark_that_takes_no_contender_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benchmarks.cli, "import_module", lambda module: _bench(True))
    result = RUNNER.invoke(app, ["bench", "faults", "--contender", "a:B"])
    assert result.exit_code == 2 and "takes no contender" in result.output and "push, terrain, walk" in result.output


def test_words_in_brackets_are_told_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.executors.find_spec", lambda name: None)
    result = RUNNER.invoke(app, ["bench", "stand", "--scheduler", "tcp://127.0.0.1:1"])
    assert result.exit_code == 2 and "pip install 'poise[bench]'" in result.output


@pytest.mark.parametrize("name", [name for name in benchmarks.cli.MODULES if not name.startswith("push_")])
def test_help_offers_a_contender_where_it_is_taken(name: str) -> None:
    shown = RUNNER.invoke(app, ["bench", name, "--help"], env={"COLUMNS": "120"}).output
    assert ("--contender" in shown) is (name in benchmarks.cli.CONTESTED)


def test_a_contender_is_pushed_without_steps_only() -> None:
    result = RUNNER.invoke(app, ["bench", "push", "--mode", "walk", "--contender", "a:B"])
    assert result.exit_code == 2 and "in mode 'stand' only" in " ".join(result.output.split())


def test_an_error_is_one_line_and_status_two(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benchmarks.cli, "import_module", lambda name: _bench(True))
    result = RUNNER.invoke(app, ["bench", "push", "--robot", "nobody"])
    assert result.exit_code == 2 and "unknown robot 'nobody'" in result.output


@pytest.mark.parametrize(
    "words", [["mode", "fly"], ["calibrate", "soul"], ["bench", "push", "--seeds", "0"], ["dance"]]
)
def test_words_that_are_not_known_are_refused(words: list[str]) -> None:
    assert RUNNER.invoke(app, words).exit_code == 2


def test_unknown_faults_are_refused_before_anything_starts() -> None:
    pytest.importorskip("rclpy")
    result = RUNNER.invoke(app, ["up", "--faults", "headless"])
    assert result.exit_code == 2 and "unknown scenario 'headless'" in result.output


def test_robots_lists_the_profiles() -> None:
    result = RUNNER.invoke(app, ["robots"])
    assert result.exit_code == 0
    assert "g1" in result.output and "talos" in result.output and "[kg]" in result.output


class _Robot:
    """A client whose robot answers at once."""

    asked: ClassVar[list[object]] = []

    def __init__(self, *, network: bool = False, namespace: str = "") -> None:
        self.asked.clear()

    def __enter__(self) -> _Robot:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def trigger(self, service: str, answer_timeout: float = 0.0) -> CommandReply:
        self.asked.append(service)
        return CommandReply(service != "calibrate/joints", "gyro bias of 0.05 rad/s", {"left_fx [N]": 15.25})

    def switch(self, service: str, on: bool) -> CommandReply:
        self.asked.append((service, on))
        return CommandReply(True, "the robot hangs")


@pytest.mark.parametrize(("what", "code"), [("imu", 0), ("joints", 1), ("show", 0), ("rollback", 0)])
def test_a_calibration_prints_its_numbers(what: str, code: int, monkeypatch: pytest.MonkeyPatch) -> None:
    client = pytest.importorskip("bridge.ros.client")
    monkeypatch.setattr(client, "Client", _Robot)
    result = RUNNER.invoke(app, ["calibrate", what])
    assert result.exit_code == code and _Robot.asked == [f"calibrate/{what}"]
    for word in ("gyro bias", "left_fx [N]", "15.25"):
        assert word in result.output
    for options, on in (([], True), (["--down"], False)):
        assert RUNNER.invoke(app, ["hang", *options]).exit_code == 0
        assert _Robot.asked == [("hang", on)]


def test_a_hand_reaches_for_a_place_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    client, robot = pytest.importorskip("bridge.ros.client"), pytest.importorskip("bridge.ros.reach")
    asked: list[object] = []

    def reach(client: object, frame: str, place: object, **options: object) -> CommandReply:
        asked.append((frame, place, options))
        return CommandReply(frame != "tail", "why")

    monkeypatch.setattr(client, "Client", _Robot)
    monkeypatch.setattr(robot, "reach", reach)
    result = RUNNER.invoke(app, ["reach", "left_hand", "-0.1", "0.2", "0.3", "--in", "odom", "--plan-only"])
    assert result.exit_code == 0 and "why" in result.output
    assert asked == [("left_hand", (-0.1, 0.2, 0.3), {"frame_id": "odom", "duration": 0.0, "execute": False})]
    assert RUNNER.invoke(app, ["reach", "tail", "0", "0", "0"]).exit_code == 1
    assert RUNNER.invoke(app, ["reach", "left_hand", "0.1", "nowhere", "0"]).exit_code == 2
