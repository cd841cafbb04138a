from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import pytest
from typer.testing import CliRunner

import benchmarks.cli
from benchmarks.core.benchmark import Benchmark, Listed, catalogue
from benchmarks.core.harness import Case, LoadMeter, Options, Report, write_json
from benchmarks.core.results import read_lines
from bridge.cli import app
from models.errors import ConfigError
from models.types import CommandReply

ROOT = Path(__file__).resolve().parents[3]
RUNNER = CliRunner()


class _Bench(Benchmark):
    """A benchmark without cases that records its name and options."""

    asked: ClassVar[list[tuple[str, Options]]] = []
    holds = True

    def cases(self, options: Options) -> list[Case]:
        return []

    def figures(self, cases: list[Case]) -> dict[str, float]:
        return {"dv_min": 0.25}

    def run(self, options: Options) -> Report:
        if options.robot == "unknown_robot":
            raise ConfigError("unknown robot 'unknown_robot'")
        self.asked.append((self.name, options))
        return replace(self.report(options, [], self.figures([]), LoadMeter()), passed=self.holds)

    def plots(self, report: Report, folder: Path) -> list[Path]:
        self.asked.append((self.name, Options()))
        (folder / "push.png").write_bytes(b"picture")
        return [folder / "push.png"]


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, Options]]:
    """What ``_Bench``, in place of every benchmark, is asked for."""
    _Bench.asked.clear()
    monkeypatch.setattr(Listed, "load", lambda listed: _Bench(listed.name))
    return _Bench.asked


def test_joints_lists_names_aliases_and_limits() -> None:
    result = RUNNER.invoke(app, ["joints", "--robot", "g1"], env={"COLUMNS": "200"})
    assert result.exit_code == 0, result.output
    (knee,) = [line for line in result.output.splitlines() if "left_knee_joint" in line]
    assert "left_knee, left_knee_pitch" in knee
    assert "-0.09 to 2.88" in knee
    narrow = RUNNER.invoke(app, ["joints", "--robot", "g1"], env={"COLUMNS": "80"}).output
    assert {"left_knee_pitch", "right_shoulder_pitch,"} <= set(narrow.split())  # no name is broken between two lines


@pytest.mark.parametrize(("passed", "code"), [(True, 0), (False, 1)])
def test_a_bench_ends_with_its_verdict(
    passed: bool, code: int, tmp_path: Path, asked: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_Bench, "holds", passed)
    options = ["--robot", "talos", "--seeds", "3", "--json", str(tmp_path / "a.json"), "--plot", str(tmp_path / "p")]
    result = RUNNER.invoke(app, ["bench", "push", *options])
    assert result.exit_code == code, result.output
    assert "dv_min" in result.output and ("not passed" in result.output) == (not passed)
    data = json.loads((tmp_path / "a.json").read_text())
    assert (data["robot"], data["seeds"], data["passed"]) == ("talos", 3, passed)
    assert (tmp_path / "p/push.png").is_file()


@pytest.mark.parametrize("option", ["--json", "--plot", "--results"])
def test_an_output_that_cannot_be_written_is_named_before_anything_is_measured(
    option: str, tmp_path: Path, asked: list[tuple[str, Options]]
) -> None:
    file = tmp_path / "file"
    file.write_text("kept")
    for taken in (file / "new", *([file] if option == "--plot" else [tmp_path])):
        result = RUNNER.invoke(app, ["bench", "push", option, str(taken)], env={"COLUMNS": "500"})
        assert result.exit_code == 2 and f"{taken.parent}" in result.output.replace("\n", "") and not asked
        assert "cannot be written" in result.output
    assert file.read_text() == "kept" and [*tmp_path.iterdir()] == [file]


@pytest.mark.parametrize(
    ("mode", "name"),
    [("stand", "push"), ("catch", "push_catch"), ("step", "push_step"), ("walk", "push_walk")],
)
def test_the_push_test_has_modes(mode: str, name: str, asked: list[tuple[str, Options]]) -> None:
    assert RUNNER.invoke(app, ["bench", "push", "--mode", mode]).exit_code == 0
    assert [found for found, _ in asked] == [name]
    assert RUNNER.invoke(app, ["bench", "push", "--mode", "run"]).exit_code == 2


USUAL_SEEDS = {"stand": 20, "walk": 20, "terrain": 20, "terrain_map": 3, "stairs": 20, "estimate": 20, "sim2sim": 20}
"""Of the commands that do not measure one seed."""

PUBLISHED = {line["bench"]: line["figures"] for line in read_lines(ROOT / "docs/benchmark_report/reports.jsonl")}
"""Figures of the benchmarks of the published report."""

COMMANDS = sorted({listed.command for listed in catalogue().values()})


def test_there_is_a_command_for_every_benchmark() -> None:
    assert {str(command.name) for command in benchmarks.cli.app.registered_commands} - {"draw", "all", "report"} == {
        *COMMANDS
    }


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_runs_its_own_benchmark_with_its_usual_seeds(name: str, asked: list[tuple[str, Options]]) -> None:
    assert RUNNER.invoke(app, ["bench", name]).exit_code == 0
    assert [(found, options.seeds) for found, options in asked] == [(name, USUAL_SEEDS.get(name, 1))]


@pytest.mark.parametrize("name", [name for name, listed in catalogue().items() if listed.info.mode])
def test_each_mode_has_its_usual_seeds(name: str, asked: list[tuple[str, Options]]) -> None:
    listed = catalogue()[name]
    assert RUNNER.invoke(app, ["bench", listed.command, "--mode", listed.info.mode]).exit_code == 0
    assert [(found, options.seeds) for found, options in asked] == [(name, listed.info.seeds)]


def test_each_benchmark_has_a_place_of_its_own_in_the_report() -> None:
    orders = [listed.info.order for listed in catalogue().values()]
    assert len(set(orders)) == len(orders)


@pytest.mark.parametrize("name", list(catalogue()))
def test_the_report_of_every_benchmark_is_drawn_by_it(
    name: str, tmp_path: Path, asked: list[tuple[str, Options]]
) -> None:
    write_json(Report(name, "g1", 1, {}, [], True, LoadMeter().read()), tmp_path / "a.json")
    result = RUNNER.invoke(app, ["bench", "draw", str(tmp_path / "a.json"), str(tmp_path / "p")])
    assert result.exit_code == 0, result.output
    assert [found for found, _ in asked] == [name]
    assert (tmp_path / "p/push.png").is_file()


@pytest.mark.parametrize("name", list(catalogue()))
def test_every_module_defines_one_benchmark_that_measures_and_draws(name: str, tmp_path: Path) -> None:
    if name in ("latency", "graph_faults"):
        pytest.importorskip("rclpy")
    bench = catalogue()[name].load()
    assert callable(bench.run)
    if type(bench).plots is Benchmark.plots and name in PUBLISHED:  # drawn from the figures alone
        report = Report(name, "folder/g1.yaml", 1, PUBLISHED[name], [], True, LoadMeter().read())
        (file,) = bench.plots(report, tmp_path)
        assert file.is_file() and file.name == f"{name}-g1.png"


@pytest.mark.parametrize("name", ["push", "walk", "terrain"])
def test_another_controller_can_be_tested(name: str, asked: list[tuple[str, Options]]) -> None:
    assert RUNNER.invoke(app, ["bench", name, "--contender", "some.module:Class"]).exit_code == 0
    assert [options.contender for _, options in asked] == ["some.module:Class"]


def test_a_benchmark_that_takes_no_contender_says_so(asked: object) -> None:
    result = RUNNER.invoke(app, ["bench", "faults", "--contender", "a:B"])
    assert result.exit_code == 2 and "has no --contender" in result.output and "push, walk, terrain" in result.output


def test_a_benchmark_without_scenarios_refuses_one(asked: object) -> None:
    result = RUNNER.invoke(app, ["bench", "tick", "--scenario", "x"])
    assert result.exit_code == 2 and "has no --scenario" in result.output


def test_words_in_brackets_are_printed_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.core.harness.find_spec", lambda name: None)
    result = RUNNER.invoke(app, ["bench", "stand", "--scheduler", "tcp://127.0.0.1:1"])
    assert result.exit_code == 2 and "pip install 'poise[bench]'" in result.output


@pytest.mark.parametrize("name", COMMANDS)
def test_help_offers_a_contender_where_it_is_taken(name: str) -> None:
    shown = RUNNER.invoke(app, ["bench", name, "--help"], env={"COLUMNS": "120"}).output
    assert ("--contender" in shown) is (name in ("push", "terrain", "walk"))


@pytest.mark.parametrize(("mode", "name"), [("stand", "push"), ("walk", "push_walk")])
def test_the_push_test_takes_contenders_grids_and_seeds(mode: str, name: str, asked: list[tuple[str, Options]]) -> None:
    given = ["--contender", "a:B", "--directions", "8+22.5", "--first-seed", "300", "--seeds", "2"]
    assert RUNNER.invoke(app, ["bench", "push", "--mode", mode, *given]).exit_code == 0
    ((found, options),) = asked
    assert (found, options.contender, options.directions) == (name, "a:B", "8+22.5")
    assert list(options.each_seed(100)) == [300, 301]


def test_directions_are_refused_where_there_are_none() -> None:
    result = RUNNER.invoke(app, ["bench", "walk", "--directions", "8"])
    assert result.exit_code == 2 and "bench walk has no --directions" in " ".join(result.output.split())


def test_an_error_is_one_line_and_status_two(asked: object) -> None:
    result = RUNNER.invoke(app, ["bench", "push", "--robot", "unknown_robot"])
    assert result.exit_code == 2 and "unknown robot 'unknown_robot'" in result.output


@pytest.mark.parametrize(
    "words", [["mode", "fly"], ["calibrate", "soul"], ["bench", "push", "--seeds", "0"], ["dance"]]
)
def test_words_that_are_not_known_are_refused(words: list[str]) -> None:
    assert RUNNER.invoke(app, words).exit_code == 2


def test_unknown_faults_are_refused_before_anything_starts() -> None:
    pytest.importorskip("rclpy")
    result = RUNNER.invoke(app, ["up", "--faults", "headless"])
    assert result.exit_code == 2 and "unknown scenario 'headless'" in result.output


@pytest.mark.parametrize(
    "given",
    [
        ["--robot-rate", "500"],
        ["--robot-domain", "0"],
        ["--plant-options", "{rate: 500.0}"],
        ["--plant", "unitree", "--faults", "dead_knee"],
        ["--plant", "unitree", "--sensor-errors", "{force_offsets: 15}"],
        ["--plant", "own:Plant", "--terrain", "tiles"],
    ],
)
def test_options_that_a_plant_does_not_have_are_refused(given: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    graph = pytest.importorskip("bridge.launch.graph")
    monkeypatch.setattr(graph, "up", lambda *_, **__: 0)
    result = RUNNER.invoke(app, ["up", *given])
    words = "".join(result.output.split("│")).split()  # in a frame
    assert result.exit_code == 2 and given[-2] in " ".join(words) and "--plant" in words, result.output


@pytest.mark.parametrize("given", [["--speed", "0.5"], ["--lockstep"], ["--camera"]])
def test_what_only_a_simulated_robot_has_is_refused_for_a_real_one(
    given: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    graph, hardware = pytest.importorskip("bridge.launch.graph"), pytest.importorskip("bridge.launch.hardware")
    monkeypatch.setattr(graph, "up", lambda *_, **__: 0)
    monkeypatch.setattr(hardware, "check_plant", lambda *_: None)
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    result = RUNNER.invoke(app, ["up", "--plant", "unitree", "--network-interface", "lo", *given])
    words = " ".join("".join(result.output.split("│")).split())
    assert result.exit_code == 2 and given[0] in words and "simulated robot" in words, result.output


def test_a_terrain_map_without_sensors_is_refused_before_anything_starts() -> None:
    pytest.importorskip("rclpy")
    result = RUNNER.invoke(app, ["up", "--robot", "talos_hardware", "--terrain-map"])
    assert result.exit_code == 2 and "talos_hardware has neither sensors.depth nor sensors.lidar" in result.output
    assert "start without --terrain-map" in result.output


def test_robots_lists_the_profiles() -> None:
    result = RUNNER.invoke(app, ["robots"])
    assert result.exit_code == 0
    assert "g1" in result.output and "talos" in result.output and "[kg]" in result.output


class _Robot:
    """A client whose robot answers at once."""

    asked: ClassVar[list[object]] = []

    def __init__(self, *, network: bool = False, namespace: str = "", signer: object = None) -> None:
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
    client, robot = pytest.importorskip("bridge.ros.client"), pytest.importorskip("bridge.ros.walk")
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


def test_commands_of_one_word_import_no_heavy_module() -> None:
    pytest.importorskip("rclpy")
    code = "import bridge.cli, bridge.ros.client, sys; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {"pydantic", "mujoco", "pinocchio", "numba", "scipy", "rich.console"} & set(loaded)


@pytest.mark.parametrize(
    ("line", "word"), [("poise sta", "status"), ("poise mode res", "reset_faults"), ("poise send wa", "wave")]
)
def test_the_tab_key_completes_commands_and_their_values(line: str, word: str) -> None:
    variables = {"_POISE_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(len(line.split()) - 1)}
    result = RUNNER.invoke(app, [], prog_name="poise", env=variables)
    assert word in result.output.split()
