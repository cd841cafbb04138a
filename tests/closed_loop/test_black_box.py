"""A fall leaves a file with what led to it, and the laws run on it again."""

from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from bridge.cli import app
from bridge.closed_loop import ClosedLoop
from bridge.replay.replay import replay_box
from controllers.recording.black_box_file import UNITS, BlackBoxRecord
from models.errors import PoiseError
from models.robot_model import RobotModel
from models.types import Mode


def test_a_fall_leaves_a_black_box(tmp_path: Path) -> None:
    loop = ClosedLoop(robot="g1", seed=0, record=False, black_box=tmp_path)
    loop.run(0.5)
    loop.apply_push((400.0, 0.0, 0.0), duration=0.2)
    for _ in range(30):
        loop.run(0.1)
        if loop.black_box is not None and loop.black_box.files:
            break
    assert loop.mode is Mode.DAMP and loop.black_box is not None
    (file,) = loop.black_box.files
    assert list(tmp_path.iterdir()) == [file]
    record = BlackBoxRecord.load(file)
    assert record.reason == "; ".join(loop.faults)
    # Every tick from the start (it has not run for 10 s) to half a second after the fault.
    np.testing.assert_allclose(np.diff(record.t), 0.001, atol=1e-9)
    damped = [t for t, text in record.events if text.startswith("mode damp")]
    assert len(damped) == 1 and any(text.startswith("push") for _, text in record.events)
    begin = next(t for t, text in loop.events if text == "released")
    assert record.t[0] <= begin and 0.49 < record.t[-1] - damped[0] < 0.53
    modes = np.array([mode is Mode.DAMP for mode in record.modes])
    assert record.t[modes][0] - damped[0] < 0.005
    assert np.isfinite(record.command_tau[~modes]).all() and np.isnan(record.command_tau[modes]).all()
    assert np.isfinite(record.gyro).all() and np.abs(record.gyro).max() > 0.5  # it falls
    out = tmp_path / "pictures"
    drawn = CliRunner().invoke(app, ["log", "black-box", str(file), "--out", str(out)])
    assert drawn.exit_code == 0 and record.reason[:30] in drawn.output, drawn.output
    assert {picture.name for picture in out.iterdir()} == {"black_box.png", "balance.png", "torques.png"}
    assert all(picture.stat().st_size > 20_000 for picture in out.iterdir())
    loop.reset()
    loop.run(0.1)
    assert len(loop.black_box.files) == 1 and len(loop.black_box.box) < len(record.t)


@pytest.fixture(scope="module")
def fallen(g1: RobotModel, tmp_path_factory: pytest.TempPathFactory) -> ClosedLoop:
    """A G1 that waves, walks, stands, waves as it walks again, and is pushed over; with more checkpoints than usual."""
    folder = tmp_path_factory.mktemp("boxes")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("controllers.recording.black_box.CHECKPOINT_PERIOD", 0.45)
        return _fall(ClosedLoop(robot=g1, seed=0, record=False, black_box=folder))


def _fall(loop: ClosedLoop) -> ClosedLoop:
    loop.command("wave")
    loop.run(0.5)
    loop.command("stop")
    loop.run(0.4)
    assert loop.command("forward").accepted
    loop.run(2.0)
    loop.command("stop")
    while loop.mode is Mode.WALK:
        loop.run(0.1)
    loop.run(0.5)
    assert loop.command("forward").accepted
    loop.run(1.2)
    assert loop.command("wave").accepted
    loop.run(0.6)
    loop.apply_push((300.0, 250.0, 0.0), duration=0.2)
    for _ in range(30):
        loop.run(0.1)
        if loop.black_box is not None and loop.black_box.files:
            return loop
    raise AssertionError("it did not fall")


def _record(loop: ClosedLoop) -> BlackBoxRecord:
    assert loop.black_box is not None
    return BlackBoxRecord.load(loop.black_box.files[0])


def _rows(record: BlackBoxRecord, rows: np.ndarray) -> BlackBoxRecord:
    return replace(record, **{name: getattr(record, name)[rows] for name in UNITS})


@pytest.mark.long
def test_a_fall_is_run_again_bit_for_bit(fallen: ClosedLoop) -> None:
    record = _record(fallen)
    report = replay_box(record)
    commanded = int((record.status >= 0).sum())
    assert report.identical and report.compared == commanded - 1 > 3000 and report.ticks == len(record.t) - 1


@pytest.mark.long
def test_it_begins_with_any_checkpoint(fallen: ClosedLoop, tmp_path: Path) -> None:
    """Standing, walking, and with arms that wave on the way: what is put back is all of the state."""
    assert fallen.black_box is not None
    box = fallen.black_box.box
    turns: list[bool] = []
    while box.checkpoints:
        walking = box.checkpoints[0].memory.mode is Mode.WALK
        if len(box.checkpoints) == 1 or not turns or walking is not turns[-1]:
            turns.append(walking)
            record = box.record("again")
            report = replay_box(record)
            assert report.identical, f"from {report.since} s: {report.first}"
        box.checkpoints.popleft()
    assert turns == [False, True, False, True, True]
    record.save(tmp_path / "last.npz")
    result = CliRunner().invoke(app, ["replay", str(tmp_path / "last.npz")])
    assert result.exit_code == 0 and f"identical: {report.compared} commands" in result.output, result.output
    assert f"from t={report.since:.3f} s on" in result.output


@pytest.mark.long
def test_a_changed_sensor_is_found(fallen: ClosedLoop) -> None:
    """One bit of a joint; a billionth of what is filtered, where one bit is lost in rounding; of the wrenches, which
    only tell which foot is loaded, a foot without load."""
    record = _record(fallen)
    row = len(record.t) // 8  # it stands
    record = _rows(record, np.arange(row + 60))
    assert replay_box(record).identical
    changed = {name: getattr(record, name).copy() for name in ("joint_q", "gyro", "accel", "wrenches")}
    changed["joint_q"][row, 2] = np.nextafter(changed["joint_q"][row, 2], np.inf)
    changed["gyro"][row] *= 1.0 + 1e-9
    changed["accel"][row] *= 1.0 + 1e-9
    changed["wrenches"][row : row + 50, 0] = 0.0
    for name, values in changed.items():
        report = replay_box(replace(record, **{name: values}))
        assert not report.identical and report.first is not None, name
        assert round(1e3 * (report.first.t - record.t[row])) in range(50 if name == "wrenches" else 10), name


@pytest.mark.long
def test_what_cannot_be_run_again_is_said(fallen: ClosedLoop, tmp_path: Path) -> None:
    record = _record(fallen)
    assert record.last(1.0).replay is None
    replace(record, replay=None).save(tmp_path / "without.npz")
    result = CliRunner().invoke(app, ["replay", str(tmp_path / "without.npz")])
    assert result.exit_code == 2 and "contains no initial state of the laws" in result.output.replace("\n", " ")
    assert record.replay is not None
    broken = deepcopy(record.replay.record)
    del broken["stages"]["estimator"]["arrays"][3]
    with pytest.raises(PoiseError, match="another version"):
        replay_box(replace(record, replay=replace(record.replay, record=broken)))
    assert replay_box(_rows(record, np.delete(np.arange(200), 50))).lost == 1
