"""``imu_node``: what it publishes and writes, when it starts, and what it refuses."""

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from sensor_msgs.msg import Imu
from std_msgs.msg import String

from controllers.nodes.imu_node import ImuNode
from models.constants import GRAVITY
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.imu import COLUMNS, OrientedImuCodec
from models.nodes.messages import ImuCodec
from models.nodes.qos import SENSOR
from tests.ros.delivery import deliver
from tests.ros.nodes.test_imu_log import table

pytestmark = pytest.mark.ros

MS = 1_000_000
START = 20
RPY = (0.1, -0.2, 0.0)
BIAS = np.array([0.01, 0.02, -0.03])
FORCE = pin.rpy.rpyToMatrix(*RPY).T @ [0.0, 0.0, GRAVITY]


class Filtered:
    """The node, fed with a sample each millisecond of its stamps."""

    def __init__(self, bench: Any, **parameters: object) -> None:
        self.node = bench.add(ImuNode, start_samples=START, **parameters)
        self.stamp, self._codec = 0, ImuCodec(topics.IMU_FRAME)

    def tick(self, count: int = 1, gyro: np.ndarray = BIAS, *, ahead: int = MS) -> None:
        for _ in range(count):
            self.stamp += ahead
            self.send(self.stamp, gyro)

    def send(self, stamp: int, gyro: np.ndarray = BIAS) -> None:
        deliver(self.node, topics.IMU_RAW, self._codec.encode(stamp, gyro, FORCE))


def test_orientation_rate_and_table(bench: Any, tmp_path: Path) -> None:
    received: list[bytes] = []
    bench.world.create_subscription(Imu, topics.IMU_FILTERED, received.append, SENSOR, raw=True)
    file = tmp_path / "imu.csv"
    filtered = Filtered(bench, rate=50.0, **{"log.csv": file})
    bench.wait(lambda: filtered.node._filtered.get_subscription_count() == 1)
    filtered.tick(START + 1000)
    bench.wait(lambda: received)
    stamp, sample = OrientedImuCodec(topics.IMU_FRAME).decode(received[-1])
    assert stamp % (20 * MS) == 0  # 50 Hz
    np.testing.assert_allclose(pin.rpy.matrixToRpy(pin.Quaternion(sample.orientation).matrix()), RPY, atol=1e-6)
    np.testing.assert_allclose(sample.gyro, 0.0, atol=1e-9)
    np.testing.assert_allclose(sample.accel, FORCE)
    assert not file.exists()  # not before it is complete
    filtered.node.trigger_deactivate()
    header, rows = table(file)
    assert tuple(header) == COLUMNS
    assert len(rows) == 51
    np.testing.assert_allclose(np.diff(rows[1:, 0]), 0.02)
    np.testing.assert_allclose(rows[:, 5:8], np.tile(RPY, (51, 1)), atol=1e-6)
    assert list(tmp_path.glob(".*part")) == []


def test_it_waits_for_a_robot_at_rest(bench: Any) -> None:
    filtered = Filtered(bench)
    filtered.tick(START, np.array([0.0, 1.0, 0.0]))
    assert "not at rest: it turns at 1 rad/s" in filtered.node.values["last refusal"]
    filtered.node.before_diagnostics()
    assert filtered.node.message == "waiting for a robot at rest"
    filtered.tick(START)
    filtered.node.before_diagnostics()
    assert filtered.node.message == "filtering"
    deliver(filtered.node, topics.DRIVER_STATE, String(data=topics.HELD))  # put back to its start
    filtered.node.before_diagnostics()
    assert filtered.node.message == "waiting for a robot at rest"
    filtered.tick(START - 1)
    deliver(filtered.node, topics.DRIVER_STATE, String(data=topics.HELD))  # again, before it has started
    filtered.tick(START - 1)
    filtered.node.before_diagnostics()
    assert filtered.node.message == "waiting for a robot at rest"


def test_stamps_and_numbers_that_are_refused(bench: Any) -> None:
    filtered = Filtered(bench)
    filtered.tick(START + 10)
    law = filtered.node._law
    before = law.quaternion
    filtered.send(filtered.stamp)  # a repeated sample is ignored
    filtered.send(filtered.stamp - MS)
    filtered.send(filtered.stamp + MS, np.full(3, np.nan))
    filtered.send(filtered.stamp + 1000 * MS)  # jumps ahead alone
    assert filtered.node.counters[f"refused {topics.IMU_RAW}"] == 3
    np.testing.assert_array_equal(law.quaternion, before)
    filtered.stamp += 1000 * MS
    filtered.tick()  # the source goes on from there
    assert filtered.node.counters["gaps bridged"] == 1
    assert filtered.node.counters[f"refused {topics.IMU_RAW}"] == 3


def test_a_table_that_cannot_be_written_forbids_the_start(bench: Any, tmp_path: Path) -> None:
    node = bench.add(ImuNode, **{"log.csv": tmp_path})
    assert not node.active
    assert "cannot be written: it is a folder" in node.message


def test_a_table_without_samples_leaves_no_file(bench: Any, tmp_path: Path) -> None:
    node = bench.add(ImuNode, **{"log.csv": tmp_path / "imu.csv"})
    node.trigger_deactivate()
    assert list(tmp_path.glob("*imu*")) == []


def test_it_brings_itself_up_or_says_why_not(bench: Any) -> None:
    node = bench.add(ImuNode, active=False)
    node.trigger_cleanup()
    assert node.autostart
    node.bring_up()
    assert node.active
    bench.remove(node)
    node = bench.add(ImuNode, active=False, robot="none")
    with pytest.raises(PoiseError, match="imu_node: "):
        node.bring_up()
