"""Clouds, depth pictures and maps as messages, and the nodes that make them from states and from each other."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec import structs
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo, Image, JointState, PointCloud2, PointField
from std_msgs.msg import Header, String, UInt8MultiArray

from bridge.nodes.range_sensor_node import RangeSensorNode
from models.errors import MessageError
from models.nodes import topics
from models.nodes.grid_map import grid_map_message, grid_map_type, layer_of, patches_message
from models.nodes.messages import JointStateCodec, stamp_ns
from models.nodes.odometry import OdometryCodec, contacts_to_bytes
from models.nodes.perception import cloud_from_message, cloud_message, depth_message, pinhole_of
from models.nodes.progress import IDLE
from models.nodes.qos import COMMAND, EVENT, LATCHED, SENSOR, STATE
from models.nodes.services import own_message
from models.range_sensor import DEPTH_FRAME, LIDAR_FRAME, PointCloud
from models.robot_model import RobotModel
from models.terrain import terrain_named
from models.types import ContactState, RobotState
from planners.nodes.terrain_mapper import TerrainMapperNode
from planners.terrain.given_map import save_given_map, terrain_heights

pytestmark = pytest.mark.ros

MS = 1_000_000


@pytest.fixture(scope="module")
def types() -> tuple[Any, Any]:
    try:
        return grid_map_type(), own_message("TerrainPatches")
    except MessageError as error:
        pytest.skip(str(error))


def test_clouds_go_over_unchanged_in_any_layout() -> None:
    points = np.random.default_rng(1).normal(size=(50, 3))
    message = cloud_message(7 * MS, PointCloud(0.007, LIDAR_FRAME, points))
    found = cloud_from_message(message)
    assert (found.t, found.frame) == (0.007, LIDAR_FRAME)
    np.testing.assert_allclose(found.points, points, rtol=1e-6)
    # as other drivers send them: organised, padded, with an intensity, big-endian, and nan for what is not there
    other = PointCloud2(height=2, width=3, point_step=20, row_step=60, is_bigendian=True)
    other.header.frame_id = DEPTH_FRAME
    names = (("intensity", 0), ("z", 4), ("y", 8), ("x", 16))
    other.fields = [PointField(name=x, offset=k, datatype=PointField.FLOAT32, count=1) for x, k in names]
    values = np.zeros((6, 5), dtype=">f4")
    values[:, 1], values[:, 2], values[:, 4] = np.arange(6), -np.arange(6), 0.5
    values[3, 1] = np.nan
    other.data = values.tobytes()
    expected = [[0.5, -k, k] for k in (0, 1, 2, 4, 5)]
    np.testing.assert_allclose(cloud_from_message(other).points, expected)


@pytest.mark.parametrize(
    ("change", "culprit"),
    [
        ({"width": 51}, "data: 600 bytes"),
        ({"point_step": 8}, "data: 600 bytes"),
        ({"fields": []}, "fields: no x, y, z of type FLOAT32"),
    ],
)
def test_clouds_of_another_form_are_refused(change: dict[str, Any], culprit: str) -> None:
    message = cloud_message(0, PointCloud(0.0, LIDAR_FRAME, np.zeros((50, 3))))
    for name, value in change.items():
        setattr(message, name, value)
    with pytest.raises(MessageError, match=culprit):
        cloud_from_message(message)


def test_depths_are_whole_millimetres_and_0_where_there_is_none() -> None:
    message = depth_message(MS, np.array([[0.5, 1.2344], [np.nan, 70.0]]))
    assert (message.encoding, message.step, message.header.frame_id) == ("16UC1", 4, DEPTH_FRAME)
    np.testing.assert_array_equal(np.frombuffer(message.data, dtype="<u2"), [500, 1234, 0, 65535])


def test_a_layer_begins_at_the_largest_x_and_y(types: Any) -> None:
    """As grid_map reads it: row 0 at the largest x, column 0 at the largest y, stored column by column."""
    layer = np.arange(9.0).reshape(3, 3)
    layer[0, 0] = np.nan
    message = grid_map_message(MS, np.array([1.0, 2.0]), 0.5, {"elevation": layer, "age": 2.0 * layer}, "elevation")
    assert (message.layers, message.basic_layers, message.info.length_x) == (["elevation", "age"], ["elevation"], 1.5)
    assert [dim.label for dim in message.data[0].layout.dim] == ["column_index", "row_index"]
    np.testing.assert_array_equal(message.data[0].data, [8, 5, 2, 7, 4, 1, 6, 3, np.nan])
    np.testing.assert_array_equal(layer_of(message, "age"), 2.0 * layer)
    with pytest.raises(MessageError, match="no 'slope' among elevation, age"):
        layer_of(message, "slope")


def test_patches_keep_their_normals_and_corners(types: Any) -> None:
    corners = np.array([[0.0, 0.0, 0.1], [1.0, 0.0, 0.1], [0.0, 1.0, 0.1]])
    message = patches_message(MS, [(np.array([0.0, 0.0, 1.0]), corners)])
    (patch,) = message.patches
    assert message.header.frame_id == topics.ODOM_FRAME and patch.normal.z == 1.0
    np.testing.assert_allclose([[p.x, p.y, p.z] for p in patch.boundary.points], corners)


class World:
    """The driver and the estimator of a standing G1, and what the nodes make of it."""

    def __init__(self, bench: Any, model: RobotModel, *, listens: bool = True) -> None:
        self.bench, self.model, self.stamp = bench, model, 1000 * MS
        make, listen = bench.world.create_publisher, bench.world.create_subscription
        kinds = {topics.GROUND_TRUTH: Odometry, topics.GROUND_TRUTH_JOINTS: JointState, topics.ODOM: Odometry}
        kinds |= {topics.JOINT_STATES: JointState, topics.CONTACTS: UInt8MultiArray}
        self.publishers = {topic: make(kind, topic, SENSOR) for topic, kind in kinds.items()}
        self.driver = make(String, topics.DRIVER_STATE, LATCHED)
        self.clouds: list[tuple[int, PointCloud]] = []
        self.pictures: list[Any] = []
        self.infos: list[Any] = []
        self.maps: list[Any] = []
        self.patches: list[Any] = []
        if listens:
            for topic in (topics.DEPTH_POINTS, topics.LIDAR_POINTS):
                listen(PointCloud2, topic, lambda m: self.clouds.append((self.stamp, cloud_from_message(m))), COMMAND)
            listen(Image, topics.DEPTH_IMAGE, self.pictures.append, SENSOR)
            listen(CameraInfo, topics.DEPTH_INFO, self.infos.append, SENSOR)
        foot = ContactState(active=True, wrench=np.zeros(6))
        zero = np.zeros(model.nj)
        self.state = RobotState(0.0, model.standing_configuration(), np.zeros(model.nv), zero, (foot, foot))
        self.joints_first = False
        self.drift = 0.0  #: Error of the height of the odometry [m]
        self._odometry, self._joints = OdometryCodec(), JointStateCodec(model)

    def receive_maps(self, types: tuple[Any, Any]) -> None:
        for kind, topic, kept in zip(
            types, (topics.TERRAIN_MAP, topics.TERRAIN_PATCHES), (self.maps, self.patches), strict=True
        ):
            self.bench.world.create_subscription(kind, topic, kept.append, STATE)

    def tick(self) -> None:
        """A hundredth of a second."""
        self.stamp += 10 * MS
        zero = np.zeros(self.model.nj)
        truth = self._odometry.encode(self.stamp, self.state)
        estimate = structs.replace(self.state, q=self.state.q + np.eye(self.model.nq)[2] * self.drift)
        joints = self._joints.encode(self.stamp, self.state.q[7:], zero, zero)
        send = self.publishers
        send[topics.CONTACTS].publish(contacts_to_bytes(self.state.contacts))
        send[topics.ODOM].publish(self._odometry.encode(self.stamp, estimate))
        send[topics.JOINT_STATES].publish(joints)
        true = [(topics.GROUND_TRUTH, truth), (topics.GROUND_TRUTH_JOINTS, joints)]
        for topic, message in reversed(true) if self.joints_first else true:
            send[topic].publish(message)
            self.bench.spin(0.005)
        self.bench.spin(0.025)

    def until(self, condition: Any) -> None:
        for _ in range(300):
            self.tick()
            if condition():
                return
        raise AssertionError("it did not happen in time")


def test_sensors_measure_while_subscribed_to_and_come_with_their_latency(bench: Any, g1: RobotModel) -> None:
    node = bench.add(RangeSensorNode, noise=0.0)
    world = World(bench, g1)
    world.until(lambda: len({cloud.frame for _, cloud in world.clouds}) == 2 and world.pictures and world.infos)
    depth = next(cloud for _, cloud in world.clouds if cloud.frame == DEPTH_FRAME)
    camera = pinhole_of(world.infos[0])
    assert world.infos[0].header.frame_id == DEPTH_FRAME and (camera.width, camera.height) == (106, 60)
    picture = np.frombuffer(world.pictures[0].data, dtype="<u2").reshape(60, 106) / 1000.0
    np.testing.assert_allclose(picture.ravel(), depth.points[:, 2], atol=1e-6)
    np.testing.assert_allclose(depth.points, camera.rays * depth.points[:, 2:], atol=1e-6)
    sensors = g1.profile.sensors
    assert sensors.depth is not None and sensors.lidar is not None
    for arrived, cloud in world.clouds:
        latency = (sensors.depth if cloud.frame == DEPTH_FRAME else sensors.lidar).latency
        assert latency - 1e-9 <= arrived / 1e9 - cloud.t <= latency + 0.05
    node.publish_diagnostics()
    assert node.message == "measuring" and "newest lidar took [ms]" in node.values


def test_nothing_is_cast_without_a_subscriber(bench: Any, g1: RobotModel) -> None:
    node = bench.add(RangeSensorNode)
    world, times = World(bench, g1, listens=False), list[int]()
    listen = bench.world.create_subscription
    listen(Header, topics.PERCEPTION_TIME, lambda message: times.append(stamp_ns(message.stamp)), SENSOR)
    for _ in range(20):
        world.tick()
    assert times and not any(times)
    node.publish_diagnostics()
    assert node.message == "no subscriber" and "newest depth took [ms]" not in node.values
    refused = bench.add(RangeSensorNode, active=False, robot="talos_hardware")
    assert "talos_hardware: sensors.depth, sensors.lidar" in refused.message


def test_a_state_is_measured_in_whichever_order_base_and_joints_arrive(bench: Any, g1: RobotModel) -> None:
    """The time of a state is published after all sensors that are due have measured it."""
    events: list[tuple[str, int]] = []
    node = bench.add(RangeSensorNode)
    report, casts = node._progress.report, node._casts
    node._casts = {name: lambda t, cast=cast: (events.append(("cast", t)), cast(t))[1] for name, cast in casts.items()}
    node._progress.report = lambda stamp: (events.append(("time", stamp)), report(stamp))
    world = World(bench, g1)
    for world.joints_first in (False, True):
        events.clear()
        world.until(lambda: ("cast", world.stamp) in events)
        assert events.index(("time", world.stamp)) > max(i for i, each in enumerate(events) if each[0] == "cast")
    node.trigger_deactivate()
    assert events[-1] == ("time", 0)


def test_what_waits_is_dropped_when_time_runs_backwards_and_on_activation(bench: Any, g1: RobotModel) -> None:
    node = bench.add(RangeSensorNode)
    world = World(bench, g1)
    world.until(lambda: world.clouds)
    world.stamp -= 500 * MS
    world.clouds.clear()
    for _ in range(25):
        world.tick()
    assert {cloud.frame for _, cloud in world.clouds} == {DEPTH_FRAME, LIDAR_FRAME}
    assert all(cloud.t < arrived / 1e9 for arrived, cloud in world.clouds)
    node.trigger_deactivate()
    begin = world.stamp
    world.stamp += 500 * MS
    node.trigger_activate()
    world.clouds.clear()
    world.until(lambda: world.clouds)
    assert min(cloud.t for _, cloud in world.clouds) > begin / 1e9 + 0.4


def test_clouds_become_a_map_and_patches_in_odom(bench: Any, g1: RobotModel, types: tuple[Any, Any]) -> None:
    bench.add(RangeSensorNode)
    mapper = bench.add(TerrainMapperNode)
    world = World(bench, g1)
    world.receive_maps(types)
    # the first of each is of a map that no cloud has reached
    world.until(lambda: len(world.maps) > 5 and any(message.patches for message in world.patches))
    message = world.maps[-1]
    assert (message.header.frame_id, message.layers) == (topics.ODOM_FRAME, ["elevation", "variance", "age"])
    elevation, n = layer_of(message, "elevation"), 150
    ahead = elevation[n // 2 + 25 : n // 2 + 50, n // 2 - 15 : n // 2 + 15]  # 0.5 to 1 m ahead
    assert elevation.shape == (n, n) and np.isfinite(ahead).mean() > 0.9
    assert np.sqrt(np.nanmean(ahead**2)) < 0.015
    world.until(lambda: len(world.maps) > 20)
    first, last = (stamp_ns(world.maps[i].header.stamp) for i in (0, -1))
    stamps = {round(1e9 * cloud.t) for _, cloud in world.clouds if cloud.frame == DEPTH_FRAME}
    pictures = {stamp for stamp in stamps if first <= stamp <= last}
    unmapped = pictures - {stamp_ns(each.header.stamp) for each in world.maps}
    assert len(unmapped) < 0.2 * len(pictures)  # none but those of which a state was lost
    world.drift = 0.5  # the ground goes with the feet
    world.maps.clear()
    world.until(lambda: len(world.maps) > 3)
    ahead = layer_of(world.maps[-1], "elevation")[n // 2 + 25 : n // 2 + 50, n // 2 - 15 : n // 2 + 15]
    assert np.nanmedian(ahead) == pytest.approx(0.5, abs=0.015)
    world.driver.publish(String(data=topics.HELD))
    bench.wait(lambda: not mapper._law.map.known.any())


def test_a_given_map_is_published_without_clouds(bench: Any, g1: RobotModel, types: Any, tmp_path: Path) -> None:
    save_given_map(tmp_path / "map.yaml", terrain_heights(terrain_named("flight")))
    mapper = bench.add(TerrainMapperNode, given_map=str(tmp_path / "map.yaml"))
    world = World(bench, g1, listens=False)
    world.drift = 0.5
    world.receive_maps(types)
    world.until(lambda: len(world.maps) > 2 and world.patches)
    elevation, n = layer_of(world.maps[-1], "elevation"), 150
    assert elevation[n // 2 + 40, n // 2] == pytest.approx(0.5, abs=0.02)
    assert elevation[n // 2 + 60, n // 2] == pytest.approx(0.65, abs=0.02)  # the first tread, 1.2 m ahead
    mapper.publish_diagnostics()
    assert mapper.message == "given map"


def test_points_of_no_known_state_or_frame_are_refused(bench: Any, g1: RobotModel) -> None:
    mapper = bench.add(TerrainMapperNode, reliable=False, depth_frame="camera")
    publisher = bench.world.create_publisher(PointCloud2, topics.DEPTH_POINTS, SENSOR)
    bench.wait(publisher.get_subscription_count)
    message = cloud_message(MS, PointCloud(0.0, DEPTH_FRAME, np.zeros((3, 3))))

    def refused() -> bool:  # also of a sensor whose clock stands still
        publisher.publish(message)
        return bool(mapper.counters[f"refused {topics.DEPTH_POINTS}"])

    bench.wait(refused)
    assert mapper._stateless > 5
    assert "no odom, joint_states, contacts within 0.02 s of the points" in mapper.values["last refusal"]
    world = World(bench, g1)
    world.until(lambda: mapper._joints.newest == world.stamp)
    publisher.publish(cloud_message(world.stamp, PointCloud(0.0, "gaze", np.zeros((3, 3)))))
    bench.wait(lambda: "'gaze' instead of 'camera', parameter depth_frame" in mapper.values["last refusal"])
    publisher.publish(cloud_message(world.stamp, PointCloud(0.0, "camera", np.zeros((3, 3)))))
    bench.wait(lambda: mapper._clouds)


def test_single_points_without_a_state_are_only_counted(bench: Any, g1: RobotModel) -> None:
    mapper = bench.add(TerrainMapperNode, reliable=False)
    publisher = bench.world.create_publisher(PointCloud2, topics.DEPTH_POINTS, SENSOR)
    bench.wait(publisher.get_subscription_count)
    world = World(bench, g1)
    world.until(lambda: mapper._joints.newest == world.stamp)

    def send(stamp: int) -> None:
        publisher.publish(cloud_message(stamp, PointCloud(0.0, DEPTH_FRAME, np.zeros((3, 3)))))

    send(world.stamp)
    bench.wait(lambda: mapper._clouds == 1)
    send(world.stamp + 500 * MS)
    bench.wait(lambda: mapper._stateless == 1)
    mapper.publish_diagnostics()
    assert mapper.values["points without a state"] == "1"
    assert mapper.counters[f"refused {topics.DEPTH_POINTS}"] == 0


def test_states_are_those_of_the_stamp(bench: Any, g1: RobotModel) -> None:
    """Poses and angles between two ticks, contacts of the nearer one; none in a hole, though states are around it.

    The drivers have subtracted the encoder offsets that they publish.
    """
    mapper = bench.add(TerrainMapperNode)
    world = World(bench, g1)
    zero = np.zeros(g1.nj)
    offsets = world.bench.world.create_publisher(JointState, topics.ENCODER_OFFSETS, LATCHED)
    offsets.publish(world._joints.encode(MS, zero + 0.03, zero, zero))
    world.until(lambda: mapper._joints.newest == world.stamp)
    before, first = world.state, world.stamp
    q = before.q + 0.1 * np.eye(g1.nq)[2] + 0.1 * np.eye(g1.nq)[10]
    swing = structs.replace(before.contacts[1], active=False)
    world.state = structs.replace(before, q=q, contacts=(before.contacts[0], swing))
    world.tick()
    bench.wait(lambda: mapper._joints.newest == world.stamp)
    for share, contacts in ((0.0, (True, True)), (0.3, (True, True)), (0.6, (True, False)), (1.0, (True, False))):
        posture = mapper._posture(mapper._around(first + round(share * 10 * MS)))
        np.testing.assert_allclose(posture.q, before.q + share * (q - before.q), atol=1e-6)
        assert posture.contacts == contacts
    hole = world.stamp + 100 * MS
    world.stamp += 190 * MS
    world.tick()
    bench.wait(lambda: mapper._joints.newest == world.stamp)
    for stamp in (hole, world.stamp - 250 * MS):
        assert None in mapper._around(stamp).values()
    for stamp in (world.stamp, world.stamp - 200 * MS):
        assert mapper._posture(mapper._around(stamp)) is not None


def test_the_mapper_reports_its_work_while_it_is_active(bench: Any, g1: RobotModel) -> None:
    """A report of at least every 8 ms; a stamp that is repeated or goes back is reported at once."""
    mapper = bench.add(TerrainMapperNode)
    world, times = World(bench, g1, listens=False), list[int]()
    bench.world.create_subscription(Header, topics.PERCEPTION_TIME, lambda m: times.append(stamp_ns(m.stamp)), EVENT)
    world.until(lambda: times and times[-1] == world.stamp)
    begin = times[-1]
    for ahead in (1, 7, 8, 8, 9, -500):
        mapper._progress.report(begin + ahead * MS)
    bench.wait(lambda: times[-1] == begin - 500 * MS)
    assert times[times.index(begin) + 1 :] == [begin + ahead * MS for ahead in (8, 8, -500)]
    mapper.trigger_deactivate()
    bench.wait(lambda: times[-1] == IDLE)
    mapper.trigger_activate()
    world.until(lambda: times[-1] == world.stamp)


def test_states_that_arrive_while_a_cloud_is_processed_are_kept(bench: Any, g1: RobotModel) -> None:
    """Otherwise the next clouds are lost, and plans are made on a map that is a period older."""
    mapper = bench.add(TerrainMapperNode)
    world, reported = World(bench, g1, listens=False), list[int]()
    world.until(lambda: mapper._joints.newest == world.stamp)
    spin, world.bench.spin = world.bench.spin, lambda seconds: None
    first = world.stamp
    for _ in range(20):
        world.tick()
    world.bench.spin = spin
    mapper._progress.report = reported.append
    bench.wait(lambda: mapper._joints.newest == mapper._odometry.newest == world.stamp)
    between = range(first, world.stamp, 10 * MS)
    assert all(None not in mapper._around(stamp + 5 * MS).values() for stamp in between)
    assert reported == [stamp + 10 * MS for stamp in between]


def test_a_malformed_state_is_refused_under_its_own_topic(bench: Any, g1: RobotModel) -> None:
    mapper = bench.add(TerrainMapperNode, reliable=False, depth_frame="camera")
    publisher = bench.world.create_publisher(PointCloud2, topics.DEPTH_POINTS, SENSOR)
    world = World(bench, g1)
    world.state = structs.replace(world.state, q=np.zeros(g1.nq))
    world.until(lambda: mapper.counters[f"refused {topics.ODOM}"] and publisher.get_subscription_count())
    bench.wait(lambda: None not in mapper._around(world.stamp).values())
    before = mapper.counters[f"refused {topics.ODOM}"]
    publisher.publish(cloud_message(world.stamp, PointCloud(0.0, DEPTH_FRAME, np.zeros((3, 3)))))
    bench.wait(lambda: mapper.counters[f"refused {topics.ODOM}"] > before)
    assert "pose.orientation: quaternion" in mapper.values["last refusal"]
    assert not mapper.counters[f"refused {topics.DEPTH_POINTS}"]


def test_feet_are_followed_without_clouds(bench: Any, g1: RobotModel) -> None:
    mapper = bench.add(TerrainMapperNode)
    world = World(bench, g1, listens=False)
    world.until(lambda: mapper._law.t > 0.0)
    first = mapper._law.t
    world.drift = 0.2
    world.until(lambda: mapper._law.t >= first + 0.2)
    assert mapper._law.reference == pytest.approx(0.2, abs=1e-3)
    world.stamp -= 500 * MS  # a new run
    world.drift = -0.1
    world.until(lambda: mapper._law.reference == pytest.approx(-0.1, abs=1e-3))
    assert mapper._law.t < first


def test_without_the_types_the_mapper_says_what_builds_them(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def absent() -> Any:
        raise MessageError("no grid_map_msgs/msg/GridMap: build them")

    monkeypatch.setattr("planners.nodes.terrain_mapper.grid_map_type", absent)
    mapper = bench.add(TerrainMapperNode)
    mapper.publish_diagnostics()
    assert mapper.active and "no grid_map_msgs/msg/GridMap" in mapper.message and mapper.level == b"\x01"
