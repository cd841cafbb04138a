"""A recorded run as a LeRobot data set: the layout, and every number in it against the recording."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from bridge.cli import app
from bridge.closed_loop import ClosedLoop
from bridge.record import lerobot
from bridge.record.episodes import commanded, episodes, observed
from bridge.record.mcap_log import EVENTS
from bridge.record.run_file import RecordedRun, read_run
from models.constants import FOOT_NAMES
from models.nodes import topics
from models.robot_model import RobotModel

pytestmark = pytest.mark.ros

FPS = 40
"""Of the data sets here [1/s]."""


@pytest.fixture(scope="module")
def recorded(g1: RobotModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A G1 that stands, waves, stops, walks, and is refused a squat."""
    path = tmp_path_factory.mktemp("export") / "run.mcap"
    with ClosedLoop(robot=g1, seed=3, record=False, mcap=path) as loop:
        loop.run(0.3)
        assert loop.command("wave").accepted
        loop.run(0.5)
        loop.command("stop")
        loop.run(0.2)
        assert loop.command("forward").accepted
        loop.run(0.7)
        assert not loop.command("squat").accepted
        assert loop.command("turn").accepted
        loop.run(0.5)
    return path


@pytest.fixture(scope="module")
def run(recorded: Path) -> RecordedRun:
    return read_run(recorded)


@pytest.fixture(scope="module")
def exported(recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("data") / "set"
    result = CliRunner().invoke(app, ["export", str(recorded), str(recorded), "--out", str(out), "--fps", str(FPS)])
    assert result.exit_code == 0, result.output
    assert [each.name for each in out.parent.iterdir()] == ["set"]
    return out


def _info(exported: Path) -> dict[str, Any]:
    data: dict[str, Any] = json.loads((exported / lerobot.INFO).read_text())
    return data


def _newest(samples: dict[int, Any], stamp: int) -> Any:
    return samples[max(each for each in samples if each <= stamp)]


def test_the_layout_is_that_of_version_3(exported: Path, g1: RobotModel) -> None:
    info = _info(exported)
    assert info["codebase_version"] == "v3.0" and info["robot_type"] == "g1" and info["fps"] == FPS
    assert info["data_path"] == "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
    assert info["splits"] == {"train": f"0:{info['total_episodes']}"} and info["video_path"] is None
    assert {str(each.relative_to(exported)) for each in exported.rglob("*") if each.is_file()} == {
        "data/chunk-000/file-000.parquet",
        "meta/episodes/chunk-000/file-000.parquet",
        "meta/info.json",
        "meta/stats.json",
        "meta/tasks.parquet",
    }
    schema = pq.read_schema(exported / "data/chunk-000/file-000.parquet")
    s, a = len(observed(g1).names), len(commanded(g1).names)
    assert {name: schema.field(name).type for name in schema.names} == {
        "observation.state": pa.list_(pa.float32(), s),
        "action": pa.list_(pa.float32(), a),
        "timestamp": pa.float32(),
        "frame_index": pa.int64(),
        "episode_index": pa.int64(),
        "index": pa.int64(),
        "task_index": pa.int64(),
    }
    for name, size in (("observation.state", s), ("action", a)):
        feature = info["features"][name]
        assert feature["dtype"] == "float32" and feature["shape"] == [size]
        assert len(feature["names"]) == len(set(feature["names"])) == len(feature["units"]) == size
    assert info["features"]["timestamp"] == {"dtype": "float32", "shape": [1], "names": None}
    assert set(info["features"]) == set(schema.names)
    units = dict(zip(info["features"]["action"]["names"], info["features"]["action"]["units"], strict=True))
    assert units["left_knee_joint.pos"] == "rad" and units["left_knee_joint.torque"] == "N.m"


def test_episodes_are_the_commands(exported: Path) -> None:
    tasks = pq.read_table(exported / lerobot.TASKS).to_pydict()
    described = json.loads(pq.read_schema(exported / lerobot.TASKS).metadata[b"pandas"])
    assert described["index_columns"] == ["task"]  # pandas takes the words for the index, as LeRobot expects
    assert {each["name"] for each in described["columns"]} == {"task_index", "task"}
    assert tasks == {"task_index": [0, 1, 2, 3], "task": ["stand", "wave", "forward", "turn"]}
    rows = pq.read_table(exported / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert [row["tasks"] for row in rows] == 2 * [["stand"], ["wave"], ["stand"], ["forward"], ["turn"]]
    assert [row["episode_index"] for row in rows] == list(range(10))
    frames = pq.ParquetFile(exported / "data/chunk-000/file-000.parquet")
    assert frames.num_row_groups == 10
    table, begin = frames.read(), 0
    for row in rows:
        assert (row["dataset_from_index"], row["dataset_to_index"]) == (begin, begin + row["length"])
        part = table.slice(begin, row["length"])
        assert part["episode_index"].to_pylist() == [row["episode_index"]] * row["length"]
        assert part["frame_index"].to_pylist() == list(range(row["length"]))
        assert {tasks["task"][i] for i in part["task_index"].to_pylist()} == set(row["tasks"])
        np.testing.assert_allclose(part["timestamp"].to_numpy(), np.arange(row["length"]) / FPS, atol=1e-4)
        begin += row["length"]
    assert table["index"].to_pylist() == list(range(begin)) and begin == _info(exported)["total_frames"]
    assert rows[1]["length"] == pytest.approx(0.5 * FPS, abs=1)


def test_every_number_is_the_newest_of_the_recording(exported: Path, run: RecordedRun) -> None:
    feature = _info(exported)["features"]
    table = pq.read_table(exported / "data/chunk-000/file-000.parquet")
    states, actions = (np.array(table[name].to_pylist()) for name in ("observation.state", "action"))
    found = list(episodes(run, FPS))
    stamps = [each.start + round(k * 1e9 / FPS) for each in found for k in range(len(each.state))]
    assert len(states) == 2 * len(stamps)
    column = {name: i for i, name in enumerate(feature["observation.state"]["names"])}
    names = run.robot.joint_names
    for row in range(0, len(stamps), 7):
        stamp, state, action = stamps[row], states[row], actions[row]
        _, *joints = _newest(run.joints, stamp)
        command = _newest(run.commands, stamp)
        for values, kind in zip(joints, ("pos", "vel", "torque"), strict=True):
            np.testing.assert_array_equal(state[[column[f"{n}.{kind}"] for n in names]], values.astype(np.float32))
        want = np.r_[command.q, command.v, command.tau].astype(np.float32)
        np.testing.assert_array_equal(action, want)
        pose, twist = _newest(run.estimates, stamp)
        assert state[column["base.z"]] == np.float32(pose[2]) and state[column["base.qw"]] == np.float32(pose[6])
        assert state[column["base.vx"]] == np.float32(twist[0]) and state[column["base.wz"]] == np.float32(twist[5])
        gyro, accel = _newest(run.imu, stamp)
        assert state[column["imu.gyro_x"]] == np.float32(gyro[0])
        assert state[column["imu.accel_z"]] == np.float32(accel[2])
        for foot, name in enumerate(FOOT_NAMES):
            assert state[column[f"{name}_foot.fz"]] == np.float32(_newest(run.feet[foot], stamp)[2])
    np.testing.assert_array_equal(states[len(stamps) :], states[: len(stamps)])


def test_statistics_are_those_of_the_frames(exported: Path) -> None:
    table = pq.read_table(exported / "data/chunk-000/file-000.parquet")
    stats = json.loads((exported / lerobot.STATS).read_text())
    values = np.array(table["action"].to_pylist())
    np.testing.assert_allclose(stats["action"]["mean"], values.mean(axis=0), atol=1e-12)
    np.testing.assert_allclose(stats["action"]["std"], values.std(axis=0), atol=1e-12)
    np.testing.assert_allclose(stats["action"]["q99"], np.quantile(values, 0.99, axis=0), atol=1e-12)
    assert stats["action"]["count"] == [len(values)] and set(stats) == set(table.schema.names)
    row = pq.read_table(exported / "meta/episodes/chunk-000/file-000.parquet").to_pylist()[3]
    part = values[row["dataset_from_index"] : row["dataset_to_index"]]
    assert row["stats/action/max"] == part.max(axis=0).tolist() and row["stats/action/count"] == [len(part)]


def test_what_the_simulator_knows_is_not_in_it(run: RecordedRun) -> None:
    before = list(episodes(run, FPS))
    assert len(run.truths) > 100
    without, other = replace(run, truths={}), replace(run, estimates=run.truths)
    for kept, blind, knowing in zip(before, episodes(without, FPS), episodes(other, FPS), strict=True):
        np.testing.assert_array_equal(kept.state, blind.state)
        assert not np.array_equal(kept.state, knowing.state)


def _without(samples: dict[int, Any], gone: Callable[[float], bool]) -> dict[int, Any]:
    return {stamp: sample for stamp, sample in samples.items() if not gone(stamp / 1e9)}


def test_missing_and_broken_samples_end_an_episode(run: RecordedRun) -> None:
    wave = list(episodes(run, FPS))[1]
    middle = wave.start / 1e9 + 0.2
    lost = replace(run, joints=_without(run.joints, lambda t: middle < t < middle + 0.1))
    parts = [each for each in episodes(lost, FPS) if each.task == "wave"]
    assert len(parts) == 2 and len(wave.state) - 5 <= sum(len(each.state) for each in parts) < len(wave.state)
    broken = {stamp: (gyro * np.nan, accel) if abs(stamp / 1e9 - middle) < 0.01 else (gyro, accel)
              for stamp, (gyro, accel) in run.imu.items()}  # fmt: skip
    (bridged,) = [each for each in episodes(replace(run, imu=broken), FPS) if each.task == "wave"]
    assert np.isfinite(bridged.state).all() and len(bridged.state) == len(wave.state)
    assert list(episodes(replace(run, estimates={}), FPS)) == []


def test_words_of_the_graph_are_tasks(run: RecordedRun) -> None:
    modes = [(stamp, topic, text) for stamp, topic, text in run.texts if topic == topics.MODE]
    words = [(s - 1, EVENTS, t) for s, _, t in modes]  # never a word: nothing of it is known
    stamps = {text: stamp for stamp, _, text in modes}
    words.append((stamps["motion"] - 2, topics.HUMANOID_COMMANDS, "1 operator 17 0badc0de Wave"))
    words.append((stamps["walk"] + 200_000_000, topics.HUMANOID_COMMANDS, "left"))
    words.append((stamps["walk"] + 300_000_000, topics.HUMANOID_COMMANDS, "squat"))
    found = [each.task for each in episodes(replace(run, texts=modes + words), FPS)]
    assert found == ["stand", "wave", "stand", "walk", "left"]


def test_one_task_for_everything_and_refusals(recorded: Path, tmp_path: Path) -> None:
    call = ["export", str(recorded), "--out", str(tmp_path / "set"), "--task", "wave and walk", "--fps", "10"]
    result = CliRunner().invoke(app, call)
    assert result.exit_code == 0 and "wave and walk" in result.output, result.output
    (row,) = pq.read_table(tmp_path / "set/meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert row["tasks"] == ["wave and walk"] and row["length"] > 20
    again = CliRunner().invoke(app, call)
    assert again.exit_code == 2 and "give an empty or a new one" in again.output
    other = CliRunner().invoke(app, ["export", str(tmp_path / "no.mcap"), "--out", str(tmp_path / "other")])
    assert other.exit_code == 2 and "no.mcap" in other.output
    assert [each.name for each in tmp_path.iterdir()] == ["set"]


def test_a_large_set_goes_on_in_another_file(run: RecordedRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lerobot, "DATA_FILE_MB", 0.05)
    dataset = lerobot.LeRobotDataset(tmp_path / "set", "g1", FPS, observed(run.robot), commanded(run.robot))
    for episode in episodes(run, FPS):
        dataset.add(episode)
    dataset.close()
    rows = pq.read_table(tmp_path / "set/meta/episodes/chunk-000/file-000.parquet").to_pylist()
    files = [row["data/file_index"] for row in rows]
    assert files[0] == 0 and files[-1] > 0 and sorted(files) == files
    for row in rows:
        held = pq.read_table(tmp_path / f"set/data/chunk-000/file-{row['data/file_index']:03d}.parquet")
        assert row["episode_index"] in held["episode_index"].to_pylist()
