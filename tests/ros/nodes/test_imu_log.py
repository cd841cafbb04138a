"""``poise log imu``: what is in the files, and that they are complete or absent, whatever ends the log."""

import csv
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from mcap_ros2.reader import read_ros2_messages
from sensor_msgs.msg import Imu
from std_msgs.msg import String
from typer.testing import CliRunner

from bridge.cli import app
from bridge.record.graph_recorder import ImuListener
from bridge.record.mcap_log import McapLog, message_text
from models.constants import GRAVITY
from models.errors import CommandError, MessageError, PoiseError
from models.nodes import topics
from models.nodes.imu import COLUMNS, CsvImuLog, ImuSample, OrientedImuCodec
from models.nodes.qos import LATCHED, SENSOR

pytestmark = pytest.mark.ros

RPY = (0.1, -0.2, 0.3)
MS = 1_000_000


def sample(value: float = 0.0) -> ImuSample:
    orientation = np.array(pin.Quaternion(pin.rpy.rpyToMatrix(*RPY)).coeffs())
    return ImuSample(orientation, 1e-6 * np.eye(3), np.array([value, 2.0, 3.0]), np.array([4.0, 5.0, GRAVITY]))


def encode(stamp: int, value: float = 0.0) -> bytes:
    return OrientedImuCodec(topics.IMU_FRAME).encode(stamp, sample(value))


def table(path: Path) -> tuple[list[str], np.ndarray]:
    """Header and numbers of a CSV file."""
    with path.open(newline="", encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    return header, np.array(rows, dtype=np.float64)


def test_both_files_hold_every_sample(tmp_path: Path) -> None:
    lines, messages = CsvImuLog(tmp_path / "new" / "imu.csv"), McapLog(tmp_path / "imu.mcap")
    messages.announce("/imu/data", "sensor_msgs/msg/Imu")

    def take(stamp: int, taken: ImuSample, data: bytes) -> None:
        lines.add(stamp, taken, data)
        messages.add("/imu/data", data, stamp)

    listener = ImuListener(take)
    stamps = [12_000_000_000 + 10 * MS * i for i in range(300)]
    for i, stamp in enumerate(stamps):
        listener.on_message(encode(stamp, i))
    listener.on_message(encode(stamps[-1]))  # twice
    listener.on_message(b"no message")
    assert list(tmp_path.glob("*.mcap")) == []  # not before it is complete
    lines.close()
    messages.close()
    assert (listener.count, listener.refused, listener.duration) == (300, 2, pytest.approx(2.99))

    header, rows = table(tmp_path / "new" / "imu.csv")
    assert tuple(header) == COLUMNS
    np.testing.assert_allclose(rows[:, 0], np.array(stamps) * 1e-9, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(rows[7, 1:5], sample().orientation, atol=1e-8)
    np.testing.assert_allclose(rows[7, 5:8], RPY, atol=1e-8)
    np.testing.assert_allclose(rows[7, 8:], [7.0, 2.0, 3.0, 4.0, 5.0, GRAVITY])

    found = list(read_ros2_messages(str(tmp_path / "imu.mcap")))
    assert [each.log_time_ns for each in found] == stamps
    assert (found[7].channel.topic, found[7].schema.name) == ("/imu/data", "sensor_msgs/msg/Imu")
    message = found[7].ros_msg
    assert message.header.frame_id == topics.IMU_FRAME
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (12, 70 * MS)
    assert message.orientation.w == pytest.approx(sample().orientation[3], abs=1e-15)
    assert (message.angular_velocity.x, message.linear_acceleration.z) == (7.0, GRAVITY)
    assert message.orientation_covariance[4] == 1e-6
    assert sorted(each.name for each in tmp_path.iterdir()) == ["imu.mcap", "new"]


@pytest.mark.parametrize("name", ["folder", "folder/file/imu.csv"])
def test_a_file_that_cannot_be_written_is_named(tmp_path: Path, name: str) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "file").touch()
    with pytest.raises(PoiseError, match=name):
        CsvImuLog(tmp_path / name)


def test_an_unknown_message_has_no_text() -> None:
    with pytest.raises(MessageError, match="sensor_msgs/msg/Nothing: its definition is not installed"):
        message_text("sensor_msgs/msg/Nothing")


@pytest.fixture
def robot(bench: Any) -> Any:
    """A robot whose IMU is received a hundred times a second."""
    publisher = bench.world.create_publisher(Imu, topics.IMU_DATA, SENSOR)
    tick = iter(range(10**9))
    bench.world.create_timer(0.01, lambda: publisher.publish(encode(10 * MS * next(tick) + 1)))
    return bench


@pytest.fixture
def log(tmp_path: Path) -> Iterator[Any]:
    """Starts ``poise log imu`` with both files in ``tmp_path``."""
    started: list[subprocess.Popen[str]] = []

    def start(*arguments: str) -> subprocess.Popen[str]:
        files = ["--csv", str(tmp_path / "imu.csv"), "--mcap", str(tmp_path / "imu.mcap")]
        command = [sys.executable, "-c", "from bridge.cli import app; app()", "log", "imu", *files, *arguments]
        started.append(
            subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=os.environ)
        )
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.wait()


@pytest.mark.long
def test_a_log_of_so_many_seconds(robot: Any, log: Any, tmp_path: Path) -> None:
    process = log("--seconds", "0.5")
    robot.wait(lambda: process.poll() is not None, 60.0)
    assert process.returncode == 0, process.stdout.read()
    _, rows = table(tmp_path / "imu.csv")
    assert rows[-1, 0] - rows[0, 0] >= 0.5 - 1e-6
    assert len(list(read_ros2_messages(str(tmp_path / "imu.mcap")))) == len(rows)
    assert f"{len(rows)} samples" in process.stdout.read()


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.slow)])
def test_a_signal_completes_the_files(robot: Any, log: Any, tmp_path: Path, number: signal.Signals) -> None:
    process = log()
    part = tmp_path / ".imu.csv.part"
    robot.wait(lambda: part.exists() and part.stat().st_size > 8192, 60.0)
    process.send_signal(number)
    robot.wait(lambda: process.poll() is not None, 20.0)
    assert process.returncode == 0, process.stdout.read()
    _, rows = table(tmp_path / "imu.csv")
    assert len(rows) > 50
    assert len(list(read_ros2_messages(str(tmp_path / "imu.mcap")))) == len(rows)
    assert sorted(each.name for each in tmp_path.glob("*imu*")) == ["imu.csv", "imu.mcap"]


def test_a_log_needs_a_file() -> None:
    result = CliRunner().invoke(app, ["log", "imu", "--seconds", "1"])
    assert result.exit_code == 2
    assert "name a file" in result.output


def test_a_silent_robot_is_told_from_one_elsewhere(bench: Any) -> None:
    bench.world.create_publisher(String, f"/robot_2/{topics.SUPERVISOR_STATUS}", LATCHED)
    listener = ImuListener(lambda *_: None)
    stop: Any = SimpleNamespace(requested=False)
    with pytest.raises(CommandError, match="robots are up in /robot_2: give --namespace"):
        listener.listen(None, stop, silence=2.0)


@pytest.mark.slow
def test_a_silent_robot_leaves_no_files(bench: Any, log: Any, tmp_path: Path) -> None:
    process = log("--seconds", "1")
    bench.wait(lambda: process.poll() is not None, 60.0)
    assert process.returncode == 2
    assert "no message on imu/data" in process.stdout.read()
    assert list(tmp_path.glob("*imu*")) == []
