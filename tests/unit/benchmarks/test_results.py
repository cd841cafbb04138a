"""The file of finished cases: resumed, never a case twice, whole after a crash, one writer at a time."""

import json
import math
import re
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.core import provenance
from benchmarks.core.executors import Done, InProcess
from benchmarks.core.harness import Case, Options, Sweep, collect, run_cases
from benchmarks.core.provenance import configuration, source_state
from benchmarks.core.results import (
    NOT_RUN,
    ResultsFile,
    append_line,
    case_key,
    decode_nonfinite,
    encode_nonfinite,
    plain,
    read_lines,
    scenario_of,
    with_nan,
    with_null,
)
from models.errors import ConfigError
from tests.sweep_cases import lacking, square

BASELINE = "benchmarks.stability.stand_still:StandStill"

LINE = {
    "key", "bench", "robot", "seed", "scenario", "config", "revision", "versions", "machine", "load", "seconds",
    "cpu_seconds", "case",
}  # fmt: skip


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "new" / "cases.jsonl"


def swept(path: Path, seeds: Sequence[int], bench: str = "squares", robot: str = "g1") -> tuple[list[Case], int, int]:
    """Results of a sweep, how many cases were there, and how many were measured."""
    with ResultsFile(path) as file:
        options = Options(robot, sweep=Sweep(InProcess(), file))
        results = run_cases(square, [{"robot": robot, "seed": seed} for seed in seeds], bench=bench, options=options)
        return results, file.found, file.added


def test_a_line_says_all_that_is_needed_to_trust_it(path: Path) -> None:
    swept(path, [3])
    (line,) = read_lines(path)
    assert set(line) == LINE
    assert (line["bench"], line["robot"], line["seed"], line["scenario"]) == ("squares", "g1", 3, "")
    assert (line["config"], line["revision"]) == (configuration("g1"), source_state())
    assert re.fullmatch(r"\d+ cores, \w+, \d+ GiB of memory, Linux \d+\.\d+", line["machine"])
    assert line["versions"]["mujoco"] and line["seconds"] >= 0.0 and line["load"] >= 0.0
    assert (line["case"]["seed"], line["case"]["square"]) == (3, 9)
    for text in path.read_text().splitlines():
        json.loads(text, parse_constant=pytest.fail)


def test_a_rerun_measures_what_is_missing_only(path: Path) -> None:
    first, found, added = swept(path, [2, 1])
    assert (found, added) == (0, 2)
    again, found, added = swept(path, [1, 2, 5, 5])
    assert (found, added) == (2, 1)
    assert [case["square"] for case in again] == [1, 4, 25, 25]
    assert again[:2] == first[::-1]
    assert sorted(line["seed"] for line in read_lines(path)) == [1, 2, 5]


def test_another_bench_robot_configuration_or_revision_is_another_case(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    swept(path, [1])
    assert swept(path, [1], bench="cubes")[2] == 1
    assert swept(path, [1], robot="talos")[2] == 1
    monkeypatch.setattr("benchmarks.core.harness.configuration", lambda robot, contender: "changed")
    assert swept(path, [1])[2] == 1
    monkeypatch.setattr("benchmarks.core.harness.source_state", lambda: "changed")
    monkeypatch.setattr("benchmarks.core.executors.source_state", lambda: "changed")
    assert swept(path, [1])[2] == 1
    assert len(read_lines(path)) == 5


@pytest.mark.parametrize(("name", "changed"), [("versions", {"mujoco": "9"}), ("machine", "other")])
def test_other_packages_and_for_timed_cases_another_machine_are_another_case(
    name: str, changed: Any, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def added(alone: bool) -> int:
        with ResultsFile(path) as file:
            options = Options(sweep=Sweep(InProcess(), file))
            run_cases(square, [{"seed": 1}], bench="squares", options=options, alone=alone)
            return file.added

    assert [added(alone=False), added(alone=True), added(alone=False), added(alone=True)] == [1, 1, 0, 0]
    for module in ("harness", "executors"):
        monkeypatch.setattr(f"benchmarks.core.{module}.{name}", lambda: changed)
    assert [added(alone=False), added(alone=True)] == [int(name == "versions"), 1]


def test_changes_of_the_source_and_new_files_of_it_are_another_source(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(provenance, "ROOT", tmp_path.resolve())
    old, new = tmp_path / "benchmarks/old.py", tmp_path / "benchmarks/new.py"
    old.parent.mkdir()
    (tmp_path / ".gitignore").write_text("*.pyc\n")
    states = []
    for file, text in (
        (old, "1"),
        (old, "2"),
        (new, "1"),
        (new, "2"),
        (tmp_path / "notes", "1"),
        (old.parent / "a.pyc", "1"),
    ):
        file.write_text(text)
        if not states:
            for command in (
                ["init", "-q"],
                ["add", "."],
                ["-c", "user.name=a", "-c", "user.email=a", "commit", "-qm", "a"],
            ):
                subprocess.run(["git", "-C", str(tmp_path), *command], check=True)
        states.append(provenance.source_state.__wrapped__())
    head, *_ = states
    assert "+" not in head and all(state.startswith(f"{head}+") for state in states[1:])
    assert len(set(states)) == 4 and len(set(states[3:])) == 1


def test_the_key_is_of_the_inputs_and_not_of_their_order() -> None:
    one = case_key("push", "c", "r", {}, {"seed": 0, "angle": 0.5})
    assert one == case_key("push", "c", "r", {}, {"angle": np.float64(0.5), "seed": np.int64(0)})
    others = [("walk", "c", "r", 0), ("push", "d", "r", 0), ("push", "c", "s", 0), ("push", "c", "r", 1)]
    assert len({one, *(case_key(b, c, r, {}, {"seed": s, "angle": 0.5}) for b, c, r, s in others)}) == 5


def test_the_configuration_changes_with_the_profile(tmp_path: Path) -> None:
    from models.profile import load_profile

    text = Path(load_profile("g1").source).read_text()
    copy = tmp_path / "g1.yaml"
    copy.write_text(text)
    same = configuration(str(copy))
    assert same == configuration("g1")
    copy.write_text(text + "\n# another comment\n")
    assert configuration(str(copy)) == same
    copy.write_text("{extends: g1, laws: {balance: {dcm_gain: 4.0}}}")
    other = configuration(str(copy))
    assert other != same
    (tmp_path / "top.yaml").write_text("extends: g1.yaml")
    assert configuration(str(tmp_path / "top.yaml")) == other
    assert configuration("talos") != same


def test_a_contender_is_another_configuration_and_its_file_is_in_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = tmp_path / "tried_contender.py"
    module.write_text("class Tried: ...\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    first = configuration("g1", "tried_contender:Tried")
    assert first != configuration("g1")
    assert first == configuration("g1", "tried_contender:Tried")
    module.write_text("class Tried: gain = 2.0\n")
    assert configuration("g1", "tried_contender:Tried") != first
    assert configuration("g1", "no.such.module:Class") == configuration("g1")  # refused when it is loaded


def test_cases_of_a_contender_are_not_taken_for_others(path: Path) -> None:
    with ResultsFile(path) as file:
        for contender in ("", BASELINE, ""):
            options = Options(contender=contender, sweep=Sweep(InProcess(), file))
            run_cases(square, [{"seed": 1}], bench="squares", options=options)
        assert (file.found, file.added) == (1, 2)


def test_what_a_crash_cut_off_is_measured_again(path: Path) -> None:
    swept(path, [1, 2])
    path.write_bytes(path.read_bytes()[:-20])
    assert [line["seed"] for line in read_lines(path)] == [1]
    results, found, added = swept(path, [1, 2])
    assert (found, added) == (1, 1) and [case["square"] for case in results] == [1, 4]
    assert [line["seed"] for line in read_lines(path)] == [1, 2]


def test_a_damaged_line_is_named(path: Path) -> None:
    swept(path, [1, 2])
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0], "{", lines[1]]) + "\n")
    with pytest.raises(ConfigError, match="line 2: not JSON"):
        ResultsFile(path)


def test_two_sweeps_do_not_share_a_file(path: Path) -> None:
    with ResultsFile(path), pytest.raises(ConfigError, match="in use by another sweep"):
        ResultsFile(path)
    ResultsFile(path).__exit__(None, None, None)


def test_what_is_finished_stays_when_a_later_case_fails(path: Path) -> None:
    def breaks(left: Sequence[Case]) -> Iterator[tuple[int, Done]]:
        yield from InProcess().run(square, left[:2])
        raise KeyError("third")

    inputs = [{"seed": seed} for seed in range(3)]
    with ResultsFile(path) as file, pytest.raises(KeyError):
        collect(breaks, inputs, bench="squares", options=Options(sweep=Sweep(None, file)))
    assert [line["seed"] for line in read_lines(path)] == [0, 1]


def test_what_could_not_be_run_here_is_reported_and_tried_again(path: Path) -> None:
    for added in (2, 0):
        with ResultsFile(path) as file:
            options = Options(sweep=Sweep(InProcess(), file))
            results = run_cases(lacking, [{"seed": seed} for seed in range(4)], bench="squares", options=options)
            assert [bool(case.get(NOT_RUN)) for case in results] == [False, True, False, True]
            assert file.added == added and len(file.requested["squares"]) == 2
    assert [line["seed"] for line in read_lines(path)] == [0, 2]
    first = read_lines(path)[0]
    append_line(path, first | {"key": "kept", "case": first["case"] | {NOT_RUN: True}})  # as files once did
    with ResultsFile(path) as file:
        assert not file.has(["kept"]) and file.has([first["key"]])


def test_a_line_is_not_added_to_one_that_was_cut_off(tmp_path: Path) -> None:
    file = tmp_path / "lines.jsonl"
    append_line(file, {"a": 1})
    file.write_bytes(file.read_bytes() + b'{"a": 2, "b')
    append_line(file, {"a": 3})
    assert read_lines(file) == [{"a": 1}, {"a": 3}]


def test_numbers_that_json_has_no_word_for_come_back_as_they_were() -> None:
    value: dict[str, Any] = {"a": [np.float64("nan"), -math.inf, None], "b": np.zeros(2), "c": (np.bool_(True), "x")}
    text = json.dumps(encode_nonfinite(plain(value)), allow_nan=False)
    back = decode_nonfinite(json.loads(text))
    assert math.isnan(back["a"][0]) and back["a"][1:] == [-math.inf, None]
    assert back["b"] == [0.0, 0.0] and back["c"] == [True, "x"]
    assert with_null([math.inf, 1.0]) == [None, 1.0] and math.isnan(with_nan([None])[0])


def test_a_scenario_is_its_name_or_its_inputs() -> None:
    assert scenario_of({"robot": "g1", "seed": 0, "scenario": "tiles", "kind": "steady"}) == "tiles"
    inputs = {"robot": "g1", "seed": 0, "mode": "walk", "angle": 0.5, "contender": ""}
    assert scenario_of(inputs) == "mode walk, angle 0.5"
    assert scenario_of(inputs | {"contender": BASELINE}) == f"mode walk, angle 0.5, contender {BASELINE}"
