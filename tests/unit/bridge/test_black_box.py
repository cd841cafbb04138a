"""The black box: what the ring keeps, what the file says, and what a disk that refuses does."""

import json
import os
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from bridge.record.recording import Recording
from bridge.replay.replay import replay_box
from controllers.recording.black_box import BlackBox, BlackBoxConfig
from controllers.recording.black_box_file import FORMAT, UNITS, BlackBoxFolder, BlackBoxRecord
from models.config import default_config
from models.errors import PoiseError
from models.robot_model import RobotModel
from models.types import ControlResult, JointCommand, Mode, RobotState, SensorData, SolveStatus
from tests.support import standing

CONFIG = BlackBoxConfig(duration=0.08, after=0.02, period=0.001, keep=3, folder="")
ROWS = 100


def tick(model: RobotModel, k: int) -> tuple[RobotState, SensorData, ControlResult]:
    """A tick in which every number is its own, and exact in single precision."""
    numbers = iter(range(100_000))

    def some(*shape: int) -> np.ndarray:
        size = int(np.prod(shape))
        return (k + 0.25 * np.array([next(numbers) for _ in range(size)])).reshape(shape)

    state = replace(standing(model, t=0.001 * k), q=some(model.nq), v=some(model.nv))
    nj = model.nj
    sensors = SensorData(state.t, some(nj), some(nj), some(nj), some(3), some(3), some(2, 6))
    command = JointCommand(some(nj), some(nj), some(nj))
    result = ControlResult(command, SolveStatus.RELAXED, 0.5 * k, some(model.nv), some(2, 6), some(3), some(2), some(2))
    return state, sensors, result


def filled(model: RobotModel, count: int) -> BlackBox:
    box = BlackBox(model, CONFIG)
    for k in range(1, count + 1):
        box.add(*tick(model, k), Mode.WALK)
    return box


@pytest.mark.parametrize("count", [1, ROWS - 1, ROWS, ROWS + 1, 2 * ROWS + 37])
def test_the_ring_keeps_the_last_rows_in_order(count: int, g1: RobotModel) -> None:
    record = filled(g1, count).record("test")
    kept = range(max(count - ROWS, 0) + 1, count + 1)
    np.testing.assert_array_equal(record.t, [0.001 * k for k in kept])
    for row, k in enumerate(kept):
        state, sensors, result = tick(g1, k)
        expected = {
            "q": state.q, "v": state.v, "joint_q": sensors.q, "joint_v": sensors.v, "joint_tau": sensors.tau,
            "gyro": sensors.gyro, "accel": sensors.accel, "wrenches": sensors.wrenches,
            "command_q": result.command.q, "command_v": result.command.v, "command_tau": result.command.tau,
            "planned_wrenches": result.wrenches, "dcm": result.dcm, "zmp": result.zmp, "residual": result.residual,
        }  # fmt: skip
        assert {*expected, "t", "stamp", "number", "sample_t", "status", "mode"} == set(UNITS)
        assert (record.stamp[row], record.number[row], record.sample_t[row]) == (1_000_000 * k, k, state.t)
        for name, values in expected.items():
            np.testing.assert_array_equal(getattr(record, name)[row], values, err_msg=name)
    assert set(record.modes) == {Mode.WALK}
    assert set(record.status) == {list(SolveStatus).index(SolveStatus.RELAXED)}


def test_what_is_not_known_is_not_made_up(g1: RobotModel) -> None:
    """A row without sensors or command holds nothing of the row that it overwrites."""
    box = filled(g1, ROWS)
    state, _, _ = tick(g1, ROWS + 1)
    box.add(state, None, None, Mode.DAMP)
    record = box.record("test")
    for name in ("gyro", "accel", "command_q", "command_v", "command_tau", "planned_wrenches", "dcm", "zmp"):
        assert np.isnan(getattr(record, name)[-1]).all() and not np.isnan(getattr(record, name)[-2]).any(), name
    assert (np.isnan(record.residual[-1]), record.status[-1], record.modes[-1]) == (True, -1, Mode.DAMP)
    np.testing.assert_array_equal(record.joint_q[-1], state.q[7:])
    np.testing.assert_array_equal(record.wrenches[-1, 1], state.contacts[1].wrench)


def test_a_tick_counts_once_and_stamps_may_begin_anew(g1: RobotModel) -> None:
    box = filled(g1, 10)
    box.add(*tick(g1, 10), Mode.WALK)  # the answer was lost, the plant asked again
    assert len(box) == 10
    box.add(*tick(g1, 1), Mode.WALK)  # another simulation
    assert len(box) == 11


def test_nothing_changes_while_it_is_written(g1: RobotModel) -> None:
    box = filled(g1, 5)
    box.sealed = True
    box.add(*tick(g1, 6), Mode.DAMP)
    box.event(0.006, "late")
    assert (len(box), box.record("test").events) == (5, ())
    box.sealed = False
    box.add(*tick(g1, 7), Mode.DAMP)
    assert len(box) == 6


def test_a_tick_allocates_nothing_that_stays(g1: RobotModel) -> None:
    box, ticks = filled(g1, 3), [tick(g1, k) for k in range(10, 200)]
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        tracemalloc.reset_peak()
        for one in ticks:
            box.add(*one, Mode.STAND)
        current, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert current - before < 2_000 and peak - before < 4_000  # [bytes]; a row has some 2 000


def test_the_file_says_all_of_it(g1: RobotModel, tmp_path: Path) -> None:
    box, path = filled(g1, 30), tmp_path / "new" / "a.npz"
    box.event(0.02, "mode damp")
    box.record("fallen").save(path)
    assert [file.name for file in path.parent.iterdir()] == ["a.npz"]
    back, record = BlackBoxRecord.load(path), box.record("fallen")
    for name in UNITS:
        np.testing.assert_array_equal(getattr(back, name), getattr(record, name))
    assert (back.robot, back.reason, back.joint_names) == ("g1", "fallen", g1.joint_names)
    assert back.events == ((0.02, "mode damp"),)
    with np.load(path) as data:
        meta = json.loads(str(data["meta"]))
    assert meta["units"]["joint_tau"] == "N.m" and meta["modes"][back.mode[0]] == "walk"
    assert meta["statuses"][back.status[0]] == "relaxed" and meta["format"] == FORMAT


def test_the_end_of_a_record(g1: RobotModel) -> None:
    box = filled(g1, 30)
    box.event(0.01, "old")
    box.event(0.028, "new")
    end = box.record("fallen").last(0.0045)
    np.testing.assert_allclose(end.t, [0.026, 0.027, 0.028, 0.029, 0.03])
    np.testing.assert_array_equal(end.q[0], tick(g1, 26)[0].q)
    assert (end.events, end.reason, len(end.status)) == (((0.028, "new"),), "fallen", 5)
    assert len(BlackBox(g1, CONFIG).record("empty").last(1.0).t) == 0


def test_old_events_are_left_out(g1: RobotModel) -> None:
    box = filled(g1, 3 * ROWS)
    box.event(0.1, "old")
    box.event(0.25, "new")
    assert box.record("test").events == ((0.25, "new"),)


def test_a_write_that_fails_leaves_the_file_before(
    g1: RobotModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    box, path = filled(g1, 5), tmp_path / "a.npz"
    box.record("first").save(path)

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(PoiseError, match="No space left"):
        box.record("second").save(path)
    assert BlackBoxRecord.load(path).reason == "first"
    assert [file.name for file in tmp_path.iterdir()] == ["a.npz"]


def test_a_folder_that_cannot_be_is_reported(g1: RobotModel, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    folder = BlackBoxFolder("g1", tmp_path / "file", 3)
    with pytest.raises(PoiseError, match="black box not written"):
        folder.save(filled(g1, 2).record("test"))


def test_the_newest_files_are_kept_and_others_left_alone(g1: RobotModel, tmp_path: Path) -> None:
    other = tmp_path / "g1.cell-20200101T000000.000000Z.npz"
    ahead = tmp_path / "g1-29990101T000000.000000Z.npz"  # from before the clock was set back
    for file in (other, ahead):
        file.write_bytes(b"")
    folder, record = BlackBoxFolder("g1", tmp_path, 3), filled(g1, 2).record("test")
    files = [folder.save(record) for _ in range(5)]
    assert folder.files() == [files[3], files[4], ahead]
    assert other.is_file()
    only = BlackBoxFolder("g1", tmp_path, 1)
    newest = only.save(record)
    assert only.files() == [newest]


def test_the_folder_is_the_users_by_default(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, g1: RobotModel) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    path = BlackBoxFolder("g1", "", 3).save(filled(g1, 2).record("test"))
    assert path.parent == tmp_path / "poise" / "black_box"


def test_what_is_no_black_box_is_refused(tmp_path: Path, g1: RobotModel) -> None:
    path = tmp_path / "a.npz"
    for contents in (b"", b"text", b"PK\x03\x04 half a file"):
        path.write_bytes(contents)
        for kind, name in ((BlackBoxRecord, "the file of a black box"), (Recording, "a recording")):
            with pytest.raises(PoiseError, match=f"not {name}: no NumPy archive, or an incomplete one"):
                kind.load(path)
    np.savez(path, t=np.zeros(3))
    with pytest.raises(PoiseError, match="not the file of a black box"):
        BlackBoxRecord.load(path)
    np.savez(path, meta=np.array(json.dumps({"format": FORMAT + 1})))
    with pytest.raises(PoiseError, match=f"format {FORMAT + 1}; this version reads {FORMAT}"):
        BlackBoxRecord.load(path)


def test_one_of_an_earlier_version_is_read_but_not_run_again(g1: RobotModel, tmp_path: Path) -> None:
    path = tmp_path / "old.npz"
    filled(g1, 5).record("test").save(path)
    with np.load(path) as data:
        meta = json.loads(str(data["meta"])) | {"format": 1}
        old = {name: data[name] for name in UNITS if name not in ("stamp", "number", "sample_t")}
    single = {
        name: each.astype(np.float32) if each.dtype == float and name != "t" else each for name, each in old.items()
    }
    np.savez(path, meta=np.array(json.dumps(meta)), **single)
    record = BlackBoxRecord.load(path)
    assert record.last(1.0).joint_q.dtype == np.float32 and list(record.number) == [0, 1, 2, 3, 4]
    with pytest.raises(PoiseError, match=r"earlier version \(format 1\).*not replayed"):
        replay_box(record)


def test_the_packaged_one_holds_ten_seconds_of_every_tick() -> None:
    config = default_config(BlackBoxConfig, "controllers", "black_box")
    assert (config.duration, config.period) == (10.0, 0.001)
