"""A recorded run of the closed loop is reproduced bit for bit, and what was tampered with is found."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.reader import read_ros2_messages
from typer.testing import CliRunner

from bridge.cli import app
from bridge.closed_loop import ClosedLoop
from bridge.plants.fault_plan import Fault
from bridge.record.mcap_log import DESCRIPTION, ROBOT, McapLog
from bridge.record.run_file import missing, read_run
from bridge.replay.replay import replay
from models.errors import ConfigError, PoiseError
from models.nodes.messages import JointStateCodec
from models.robot_model import RobotModel
from models.types import Mode

pytestmark = pytest.mark.ros

MS = 1_000_000


@pytest.fixture(scope="module")
def recorded(g1: RobotModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A G1 that stands, waves, is pushed, walks, waves on the way, and stops."""
    path = tmp_path_factory.mktemp("record") / "new" / "run.mcap"
    with ClosedLoop(robot=g1, seed=3, record=False, mcap=path) as loop:
        loop.run(0.2)
        assert loop.command("wave").accepted
        loop.run(1.0)
        loop.apply_push((60.0, 20.0, 0.0), duration=0.1)
        loop.run(0.5)
        loop.command("stop")
        loop.run(0.5)
        assert loop.command("walk").accepted
        loop.set_velocity(0.3, 0.0, 0.2)
        loop.run(1.2)
        assert loop.command("wave").accepted
        loop.run(0.5)
        loop.command("stop")
        loop.run(2.5)
        assert loop.mode is Mode.STAND and not loop.fallen
        assert list(path.parent.glob("*.mcap")) == []  # not before it is complete
    assert [each.name for each in path.parent.iterdir()] == ["run.mcap"]
    return path


def tampered(path: Path, out: Path, change: Callable[[str, int, bytes], bytes | None]) -> Path:
    """A copy of a recording with messages changed, or left out where None is returned."""
    with path.open("rb") as file:
        reader = make_reader(file)
        log = McapLog(out)
        for metadata in reader.iter_metadata():
            log.describe(metadata.name, metadata.metadata)
        for schema, channel, message in reader.iter_messages():
            if channel.topic not in log.counts:
                log.announce(channel.topic, schema.name)
            data = change(channel.topic, message.log_time, message.data)
            if data is not None:
                log.add(channel.topic, data, message.log_time)
    log.close()
    return out


@pytest.mark.long
def test_every_command_comes_out_the_same(recorded: Path) -> None:
    report = replay(read_run(recorded))
    assert report.identical and report.compared == report.ticks > 5000


def test_other_programs_read_it(recorded: Path, g1: RobotModel) -> None:
    joints = list(read_ros2_messages(str(recorded), topics=["/joint_states"]))
    assert (joints[0].schema.name, joints[0].schema.encoding) == ("sensor_msgs/msg/JointState", "ros2msg")
    assert tuple(joints[0].ros_msg.name) == g1.joint_names
    run = read_run(recorded)
    stamps = sorted(run.joints)
    assert [each.log_time_ns for each in joints] == stamps and run.lost == 0
    np.testing.assert_array_equal(list(joints[100].ros_msg.position), run.joints[stamps[100]][1])
    modes = [each.ros_msg.data for each in read_ros2_messages(str(recorded), topics=["/mode"])]
    assert modes == ["stand", "motion", "stand", "walk", "stand"]
    (described,) = read_ros2_messages(str(recorded), topics=["/robot_description"])
    assert "<robot" in described.ros_msg.data


@pytest.mark.slow
def test_a_changed_bit_of_a_sensor_is_found_by_time_and_joint(recorded: Path, g1: RobotModel, tmp_path: Path) -> None:
    codec, at = JointStateCodec(g1), sorted(read_run(recorded).joints)[2000]

    def flip(topic: str, stamp: int, data: bytes) -> bytes:
        if topic != "/joint_states" or stamp != at:
            return data
        own, q, v, tau = codec.read(data)
        q[3] = np.nextafter(q[3], np.inf)
        return codec.encode(own, q, v, tau)

    file = tampered(recorded, tmp_path / "flipped.mcap", flip)
    report = replay(read_run(file))
    assert not report.identical and report.first is not None
    assert at <= round(report.first.t * 1e9) <= at + 5 * MS and report.first.joint in g1.joint_names
    assert 0 < max(report.largest) < 1e-3  # a bit stays a small thing
    result = CliRunner().invoke(app, ["replay", str(file)])
    assert result.exit_code == 1
    assert f"first difference at t={report.first.t:.3f} s, {report.first.joint}" in result.output


@pytest.mark.slow
def test_lost_samples_and_notes_are_counted(recorded: Path, tmp_path: Path) -> None:
    run = read_run(recorded)
    stamps = sorted(run.joints)
    gone = {stamps[1000], stamps[1001]}

    def drop(topic: str, stamp: int, data: bytes) -> bytes | None:
        return None if topic == "/joint_states" and stamp in gone else data

    file = tampered(recorded, tmp_path / "lost.mcap", drop)
    report = replay(read_run(file))
    assert read_run(file).lost == 2 and report.lost == 1 and report.unmatched == 2 and not report.identical
    assert report.first is not None and report.first.t == pytest.approx(1e-9 * stamps[1002], abs=1e-9)
    del run.notes[2]
    assert replay(run).gaps == 1


def test_what_cannot_be_replayed_is_said(recorded: Path, tmp_path: Path) -> None:
    run = read_run(recorded)
    run.notes = run.notes[1:]
    with pytest.raises(PoiseError, match="start the recording before the robot"):
        replay(run)
    (tmp_path / "text.mcap").write_text("no recording")
    result = CliRunner().invoke(app, ["replay", str(tmp_path / "text.mcap")])
    assert result.exit_code == 2 and "text.mcap: not a" in result.output
    with pytest.raises(PoiseError, match="cannot be read: No such file"):
        read_run(tmp_path / "missing.mcap")
    unnamed = tmp_path / "unnamed.mcap"
    log = McapLog(unnamed)
    log.close()
    with pytest.raises(PoiseError, match="give it with --robot"):
        read_run(unnamed)
    log = McapLog(unnamed)
    log.describe(DESCRIPTION, {ROBOT: "unknown_robot"})
    log.close()
    with pytest.raises(PoiseError, match="unknown_robot"):
        read_run(unnamed)


@pytest.mark.parametrize("part", ["begin", "half", "chunk"])
def test_a_damaged_recording_is_refused(recorded: Path, tmp_path: Path, part: str) -> None:
    data, damaged = recorded.read_bytes(), tmp_path / "damaged.mcap"
    middle = len(data) // 2
    contents = {"begin": data[:4], "half": data[:middle], "chunk": data[:middle] + bytes(99) + data[middle + 99 :]}
    damaged.write_bytes(contents[part])
    with pytest.raises(PoiseError, match=r"damaged.mcap: not a recording, or a damaged or incomplete one"):
        read_run(damaged)


def test_missing_stamps_are_counted_by_the_shortest_step() -> None:
    assert missing([]) == missing([5]) == missing([5, 6, 7]) == 0
    assert missing([1 * MS, 2 * MS, 5 * MS, 6 * MS, 8 * MS]) == 3


def test_a_run_on_the_true_state_is_not_recorded(g1: RobotModel, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="mcap"):
        ClosedLoop(robot=g1, estimate="truth", mcap=tmp_path / "run.mcap")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.long
def test_a_reset_begins_the_file_anew_and_faults_are_replayed(g1: RobotModel, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with ClosedLoop(robot=g1, record=False, mcap=path) as loop:
        loop.run(0.3)
        loop.reset(seed=1)
        begin = loop.t
        loop.inject([Fault("imu", "off", start=0.1, end=0.12), Fault("joint_states", "off", start=0.2, end=0.203)])
        loop.run(0.5)
    run = read_run(path)
    assert sorted(run.joints)[0] < 1e9 * begin and max(run.joints) == round(1e9 * (loop.t - 0.001))
    report = replay(run)
    assert report.identical
    result = CliRunner().invoke(app, ["replay", str(path)])
    assert result.exit_code == 0 and f"identical: {report.compared} commands" in result.output, result.output


@pytest.mark.long
def test_a_recording_is_drawn(recorded: Path, tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["plot", str(recorded), "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    assert {each.name for each in tmp_path.iterdir()} == {"record.png", "balance.png", "torques.png", "walk.png"}
    assert all(each.stat().st_size > 20_000 for each in tmp_path.iterdir())
