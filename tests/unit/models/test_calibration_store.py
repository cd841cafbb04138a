"""The calibration file: atomic, checked, kept, rolled back."""

import os
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from models.calibration import Calibration
from models.calibration_store import DIRECTORY_VARIABLE, CalibrationStore, calibration_directory
from models.errors import ConfigError, JointNameError
from models.robot_model import RobotModel

NOW = datetime(2030, 5, 6, 7, 8, 9, tzinfo=UTC)


def sample(model: RobotModel, seed: int) -> Calibration:
    rng = np.random.default_rng(seed)
    return Calibration(
        robot=model.name,
        gyro_bias=rng.uniform(-0.1, 0.1, 3),
        accel_bias=rng.uniform(-0.3, 0.3, 3),
        encoder_offsets=rng.uniform(-0.05, 0.05, model.nj),
        wrench_offsets=rng.uniform(-5.0, 5.0, (2, 6)),
        force_gains=rng.uniform(0.9, 1.1, 2),
    )


def same(first: Calibration, second: Calibration) -> bool:
    arrays = ("gyro_bias", "accel_bias", "encoder_offsets", "wrench_offsets", "force_gains")
    return first.robot == second.robot and all(
        np.array_equal(getattr(first, name), getattr(second, name)) for name in arrays
    )


@pytest.fixture
def store(g1: RobotModel, tmp_path: Path) -> CalibrationStore:
    return CalibrationStore(g1, tmp_path / "new")


def test_nothing_written_corrects_nothing(g1: RobotModel, store: CalibrationStore) -> None:
    calibration, refused = store.load()
    assert same(calibration, Calibration.none(g1)) and refused == ()


def test_what_is_written_is_read_to_the_last_bit(robot: RobotModel, tmp_path: Path) -> None:
    store = CalibrationStore(robot, tmp_path)
    written = store.save(sample(robot, 0), now=NOW, what="imu")
    calibration, refused = store.load()
    assert refused == () and same(calibration, sample(robot, 0)) and same(written, calibration)
    assert calibration.stamps == (("imu", "2030-05-06T07:08:09+00:00"),)
    later = store.save(calibration, now=NOW + timedelta(hours=1), what="feet")
    assert dict(later.stamps) == {"imu": "2030-05-06T07:08:09+00:00", "feet": "2030-05-06T08:08:09+00:00"}
    assert [path.name for path in sorted(tmp_path.iterdir())] == [f"{robot.name}.yaml", f"{robot.name}.yaml.1"]


def test_previous_files_are_kept_up_to_the_limit(g1: RobotModel, store: CalibrationStore) -> None:
    for seed in range(8):
        store.save(sample(g1, seed), now=NOW)
    assert [path.name for path in store.files()] == ["g1.yaml", *(f"g1.yaml.{i}" for i in range(1, 6))]
    assert [same(store.read(path), sample(g1, 7 - i)) for i, path in enumerate(store.files())] == [True] * 6


@pytest.mark.parametrize("moment", ["fsync", "link", "replace"])
def test_killed_while_writing_leaves_the_old_file(
    g1: RobotModel, store: CalibrationStore, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    store.save(sample(g1, 0), now=NOW)
    store.save(sample(g1, 1), now=NOW)

    class Killed(BaseException):
        """Not an error that anyone handles, like the end of the process."""

    def die(*args: object, **kwargs: object) -> None:
        raise Killed

    with monkeypatch.context() as patch:
        if moment == "replace":  # the last step only: the kept files are aged with replace as well
            replaced = Path.replace
            patch.setattr(Path, "replace", lambda p, to: die() if p.name.endswith(".tmp") else replaced(p, to))
        else:
            patch.setattr(os, moment, die)
        with pytest.raises(Killed):
            store.save(sample(g1, 2), now=NOW)
    calibration, refused = store.load()
    assert same(calibration, sample(g1, 1)) and refused == ()
    store.save(sample(g1, 3), now=NOW)
    assert same(store.load()[0], sample(g1, 3))
    assert not [path for path in store.path.parent.iterdir() if path.name.endswith(".tmp")]


def test_every_half_written_file_is_refused_by_name_and_the_previous_one_used(
    g1: RobotModel, store: CalibrationStore
) -> None:
    store.save(sample(g1, 0), now=NOW)
    store.save(sample(g1, 1), now=NOW)
    whole = store.path.read_text()
    for length in range(0, len(whole) - 1, 97):
        store.path.write_text(whole[:length])
        calibration, refused = store.load()
        assert same(calibration, sample(g1, 0)), length
        assert len(refused) == 1 and str(store.path) in refused[0]
    store.path.write_text(whole[: whole.index("complete")])
    assert "half-written" in store.load()[1][0]


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("robot: g1", "robot: talos", "for 'talos'"),
        ("schema_version: 1", "schema_version: 2", "schema_version"),
        ("left_knee_joint", "left_tail_joint", "left_tail_joint"),
        ("gyro_bias: [", "gyro_bias: [.nan, ", "gyro_bias"),
        ("force_gain: ", "force_gain: 7", "force_gain"),
        ("2030-05-06T07:08:09+00:00", "yesterday", "yesterday"),
        ("2030-05-06T07:08:09+00:00", "2030-05-06", "no time zone"),
        ("complete: true", "complete: true\nextra: 1", "extra"),
    ],
)
def test_a_corrupted_file_is_refused_with_the_key(
    g1: RobotModel, store: CalibrationStore, old: str, new: str, word: str
) -> None:
    store.save(sample(g1, 0), now=NOW)
    store.save(sample(g1, 1), now=NOW)
    text = store.path.read_text()
    assert old in text
    store.path.write_text(text.replace(old, new, 1))
    calibration, refused = store.load()
    assert same(calibration, sample(g1, 0))
    assert len(refused) == 1 and word in refused[0] and str(store.path) in refused[0]


def test_missing_joint_is_named(g1: RobotModel, store: CalibrationStore) -> None:
    store.save(Calibration.none(g1), now=NOW)
    text = store.path.read_text()
    store.path.write_text(text.replace("left_knee_joint: 0.0, ", ""))
    with pytest.raises(JointNameError, match="left_knee_joint"):
        store.read(store.path)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"gyro_bias": np.array([0.0, 0.21, 0.0])}, "gyro_bias.y"),
        ({"accel_bias": np.array([2.0, 0.0, 0.0])}, "accel_bias.x"),
        ({"wrench_offsets": np.full((2, 6), 20.0)}, "left torque_offset.x"),
        ({"force_gains": np.array([1.0, 0.5])}, "right force_gain"),
        ({"force_gains": np.array([np.nan, 1.0])}, "left force_gain"),
    ],
)
def test_implausible_values_are_neither_written_nor_read(
    g1: RobotModel, store: CalibrationStore, change: dict[str, np.ndarray], word: str
) -> None:
    with pytest.raises(ConfigError, match=word):
        store.save(replace(sample(g1, 0), **change), now=NOW)
    assert store.files() == []


def test_implausible_offset_in_the_file_is_refused(g1: RobotModel, store: CalibrationStore) -> None:
    store.save(Calibration.none(g1), now=NOW)
    store.path.write_text(store.path.read_text().replace("left_knee_joint: 0.0", "left_knee_joint: 0.11"))
    calibration, refused = store.load()
    assert same(calibration, Calibration.none(g1)) and "encoder_offsets.left_knee_joint is 0.11" in refused[0]


def test_rollback_returns_to_the_previous_file(g1: RobotModel, store: CalibrationStore) -> None:
    for seed in range(3):
        store.save(sample(g1, seed), now=NOW)
    assert same(store.rollback(), sample(g1, 1)) and same(store.load()[0], sample(g1, 1))
    assert same(store.rollback(), sample(g1, 0)) and same(store.load()[0], sample(g1, 0))
    with pytest.raises(ConfigError, match="no previous"):
        store.rollback()
    assert same(store.load()[0], sample(g1, 0))


def test_rollback_skips_a_corrupted_file(g1: RobotModel, store: CalibrationStore) -> None:
    for seed in range(3):
        store.save(sample(g1, seed), now=NOW)
    store.path.with_name("g1.yaml.1").write_text("nonsense: [")
    assert same(store.rollback(), sample(g1, 0))


def test_a_rollback_that_the_disk_refuses_changes_nothing(g1: RobotModel, store: CalibrationStore) -> None:
    for seed in range(2):
        store.save(sample(g1, seed), now=NOW)
    store.path.with_name("g1.yaml.rejected").mkdir()
    with pytest.raises(ConfigError, match="cannot be rolled back"):
        store.rollback()
    assert same(store.load()[0], sample(g1, 1))


def test_no_zone_other_robot_and_full_disk_are_refused(
    g1: RobotModel, talos: RobotModel, store: CalibrationStore, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match="time zone"):
        store.save(sample(g1, 0), now=NOW.replace(tzinfo=None))
    with pytest.raises(ConfigError, match="for 'talos'"):
        store.save(sample(talos, 0), now=NOW)
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="cannot be written"):
        CalibrationStore(g1, tmp_path / "file").save(sample(g1, 0), now=NOW)


def test_folder_comes_from_the_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("XDG_CONFIG_HOME", raising=False)
    monkeypatch.delenv(DIRECTORY_VARIABLE, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    assert calibration_directory() == tmp_path / ".config" / "poise" / "calibration"
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "mine"))
    assert calibration_directory() == tmp_path / "mine" / "poise" / "calibration"
    monkeypatch.setenv(DIRECTORY_VARIABLE, str(tmp_path / "mine"))
    assert calibration_directory() == tmp_path / "mine"


def test_robots_in_different_namespaces_share_no_file(g1: RobotModel, tmp_path: Path) -> None:
    names = ("", "/", "/cell", "/cell/two")
    stores = [CalibrationStore(g1, tmp_path, namespace=name) for name in names]
    assert [store.path.name for store in stores] == ["g1.yaml", "g1.yaml", "g1.cell.yaml", "g1.cell.two.yaml"]
    stores[2].save(sample(g1, 1), now=NOW)
    stores[2].save(sample(g1, 2), now=NOW)
    assert same(stores[3].load()[0], Calibration.none(g1)) and same(stores[0].load()[0], Calibration.none(g1))
    assert same(stores[2].load()[0], sample(g1, 2))
