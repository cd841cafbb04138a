"""The bridge's part of a calibration: encoders are corrected from a start on, and a crane lifts the robot."""

from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from bridge.driver.world import DriverWorld
from bridge.nodes.robot_driver import RobotDriver
from models.calibration import Calibration
from models.calibration_store import CalibrationStore
from models.errors import CommandError
from models.nodes import topics
from models.nodes.messages import JointStateCodec
from models.nodes.qos import LATCHED
from models.robot_model import RobotModel

pytestmark = pytest.mark.ros


def save(robot: RobotModel, folder: Path, offset: float, namespace: str = "") -> CalibrationStore:
    calibration = Calibration.none(robot)
    calibration.encoder_offsets[:] = offset
    store = CalibrationStore(robot, folder, namespace=namespace)
    store.save(calibration, now=datetime.now(UTC), what="joints")
    return store


class World:
    """Subscriptions to what the bridge publishes, and a client."""

    def __init__(self, bench: Any, robot: RobotModel) -> None:
        self.bench, self.states, self.offsets = bench, [], []
        self.clients: dict[str, Any] = {}
        node, codec = bench.world, JointStateCodec(robot)
        node.create_subscription(String, topics.DRIVER_STATE, lambda word: self.states.append(word.data), LATCHED)
        hear = node.create_subscription
        hear(
            JointState,
            topics.ENCODER_OFFSETS,
            lambda data: self.offsets.append(codec.decode(data)[1]),
            LATCHED,
            raw=True,
        )

    def call(self, kind: type, name: str, **fields: object) -> tuple[bool, str]:
        if name not in self.clients:
            self.clients[name] = self.bench.world.create_client(kind, name)
            self.bench.wait(self.clients[name].service_is_ready)
            self.bench.spin(0.2)
        future = self.clients[name].call_async(kind.Request(**fields))
        self.bench.wait(future.done)
        return future.result().success, future.result().message


def test_offsets_are_taken_at_the_start_and_published(bench: Any, g1: RobotModel, tmp_path: Path) -> None:
    world = World(bench, g1)
    store = save(g1, tmp_path, 0.01)
    bridge = bench.add(RobotDriver, calibration_dir=tmp_path)
    bench.wait(lambda: world.offsets)
    np.testing.assert_array_equal(world.offsets[-1], 0.01)
    driven = bridge.drivers
    np.testing.assert_allclose(driven.plant.read().q - driven.read().q, 0.01)
    save(g1, tmp_path, 0.02)
    for _ in range(20):
        bridge.publish_tick(0.0)
        bridge.step()
    np.testing.assert_allclose(driven.plant.read().q - driven.read().q, 0.01)  # a running robot keeps its zero
    assert world.call(Trigger, "reset") == (True, "the robot is back at its start, held")
    bench.wait(lambda: np.array_equal(world.offsets[-1], np.full(g1.nj, 0.02)))
    np.testing.assert_allclose(driven.plant.read().q - driven.read().q, 0.02)
    store.path.write_text("half")
    assert world.call(Trigger, "reset")[0]
    bench.wait(lambda: np.array_equal(world.offsets[-1], np.full(g1.nj, 0.01)))
    assert str(store.path) in bridge.values["calibration refused"]


def test_a_simulated_robot_reads_no_file_of_the_users(
    bench: Any, g1: RobotModel, calibration_dir: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("POISE_CALIBRATION_DIR", str(tmp_path))
    save(g1, tmp_path, 0.01)
    bridge = bench.add(RobotDriver)
    assert bridge.drivers.encoder_offsets is None
    assert bridge.values["calibration"] == "none is read"


def test_two_robots_in_namespaces_have_files_of_their_own(bench: Any, g1: RobotModel, tmp_path: Path) -> None:
    save(g1, tmp_path, 0.01, "/cell")
    found = []
    for namespace in ("/cell", "/other"):
        node = bench.add(lambda at=namespace, **kwargs: RobotDriver(namespace=at, **kwargs), calibration_dir=tmp_path)
        found.append(node.drivers.encoder_offsets)
    np.testing.assert_array_equal(found[0], 0.01)
    assert found[1] is None


def test_a_refused_reset_leaves_the_offsets(bench: Any, g1: RobotModel, tmp_path: Path) -> None:
    shared = DriverWorld()
    given: dict[str, Any] = {"configured": False, "calibration_dir": tmp_path}
    first, second = (
        bench.add(partial(RobotDriver, shared, namespace=f"/robot_{number}"), place=[0.0, 1.5 * number, 0.0], **given)
        for number in range(2)
    )
    first.bring_up()
    second.bring_up()
    save(g1, tmp_path, 0.01, "/robot_0")
    place, other = (shared.world.robots[name].qpos for name in ("robot_0", "robot_1"))
    shared.world.data.qpos[other] = shared.world.data.qpos[place]
    with pytest.raises(CommandError, match="the place of robot_0 is occupied by robot_1"):
        first.restart()
    assert first.drivers.encoder_offsets is None


def test_the_crane_takes_a_robot_that_is_held_or_off_only(bench: Any, g1: RobotModel) -> None:
    world = World(bench, g1)
    bridge = bench.add(RobotDriver)
    assert world.call(SetBool, "hang", data=False) == (True, "the robot does not hang already")
    assert world.call(SetBool, "hang", data=True) == (True, "the robot hangs, feet in the air")
    assert np.abs(bridge.drivers.plant.wrenches[:, 2]).max() < 1.0
    assert bridge.free_running  # in lockstep nothing answers a robot in the air
    bridge.commands.on_mode(String(data="stand"))
    assert bridge.counters[f"refused {topics.MODE}"] == 1
    assert world.call(SetBool, "hang", data=False) == (True, "the robot is back at its start, held")
    assert world.states[-2:] == ["hanging", "held"] and not bridge.free_running
    bridge.commands.on_mode(String(data="stand"))
    accepted, reason = world.call(SetBool, "hang", data=True)
    assert not accepted and "refused: the drivers are 'held'" in reason
    bridge.drivers.plant.release()
    assert "'active'" in world.call(SetBool, "hang", data=True)[1]
    for mode in ("damp", "off"):
        bridge.commands.on_mode(String(data=mode))
    assert world.call(SetBool, "hang", data=True)[0]


def test_sensor_errors_are_injected_or_refused(bench: Any, g1: RobotModel) -> None:
    bridge = bench.add(RobotDriver, sensor_noise=False, sensor_errors="'{gyro_bias: [0.05, 0, 0]}'")
    np.testing.assert_array_equal(bridge.drivers.plant.noise.bias[3 * g1.nj : 3 * g1.nj + 3], [0.05, 0.0, 0.0])
    bench.remove(bridge)
    bridge = bench.add(RobotDriver, active=False, sensor_errors="'{gyro: 1}'")
    assert "unknown key 'gyro'" in bridge.message
