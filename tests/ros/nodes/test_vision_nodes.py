"""The camera's and the vision node's topics: a ball's bearing, the head after it, and what is refused by name."""

import ctypes.util
import math
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

pytest.importorskip("cv2", reason="the extra 'vision' is not installed")

from geometry_msgs.msg import PointStamped, Vector3Stamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import Bool, String

from bridge.launch.graph import Graph
from bridge.launch.layout import process_specs
from bridge.nodes.camera_node import CameraNode
from bridge.ros.environment import free_domain
from bridge.ros.processes import ProcessSpec
from controllers.nodes.balance_controller import BalanceControllerNode
from controllers.nodes.vision_node import VisionNode
from controllers.vision.gaze import AngleHistory
from models.camera import Pinhole, azimuth_elevation
from models.errors import MessageError, PoiseError
from models.nodes import topics
from models.nodes.interfaces import interface
from models.nodes.messages import JointStateCodec, head_from_message, head_message
from models.nodes.odometry import OdometryCodec
from models.nodes.perception import image_message, info_message, picture_of, pinhole_of
from models.nodes.qos import EVENT, LATCHED, SENSOR
from models.profile import CAMERA_FRAME
from models.robot_model import RobotModel
from models.types import ContactState, RobotState
from planners.nodes.motion_planner import MotionPlannerNode

pytestmark = pytest.mark.ros

MS = 1_000_000

needs_gl = pytest.mark.skipif(ctypes.util.find_library("EGL") is None, reason="EGL is not installed")


def test_pictures_and_intrinsics_go_over_unchanged() -> None:
    picture = np.random.default_rng(1).integers(0, 256, (12, 20, 3), dtype=np.uint8)
    message = image_message(5 * MS, picture)
    assert (message.encoding, message.step, message.header.frame_id) == ("rgb8", 60, CAMERA_FRAME)
    np.testing.assert_array_equal(picture_of(message), picture)
    message.encoding = "bgr8"
    np.testing.assert_array_equal(picture_of(message), picture[..., ::-1])
    camera = Pinhole(320, 240, (277.0, 270.0), (158.0, 121.0))
    assert pinhole_of(info_message(5 * MS, camera)) == camera


@pytest.mark.parametrize(
    ("change", "culprit"),
    [
        ({"encoding": "mono8"}, "encoding: 'mono8'"),
        ({"step": 10}, "data: 720 bytes for 20 x 12 pixels"),
        ({"height": 13}, "data: 720 bytes for 20 x 13 pixels"),
    ],
)
def test_pictures_that_do_not_match_are_refused(change: dict[str, Any], culprit: str) -> None:
    message = image_message(5 * MS, np.zeros((12, 20, 3), dtype=np.uint8))
    for name, value in change.items():
        setattr(message, name, value)
    with pytest.raises(MessageError, match=culprit):
        picture_of(message)


def test_cameras_and_heads_that_are_none_are_refused() -> None:
    with pytest.raises(MessageError, match="k: focal lengths 0"):
        pinhole_of(CameraInfo(width=320, height=240))
    with pytest.raises(MessageError, match="d: the pictures are distorted"):
        pinhole_of(CameraInfo(width=320, height=240, d=[0.1, 0.0, 0.0, 0.0, 0.0]))
    assert head_from_message(JointState(name=["tilt", "pan"], position=[0.1, 0.2])) == (0.2, 0.1)
    for names, culprit in ((["pan"], "name"), (["pan", "pan"], "name"), (["pan", "nod"], "nod")):
        with pytest.raises(MessageError, match=culprit):
            head_from_message(JointState(name=names, position=[0.0] * len(names)))
    with pytest.raises(MessageError, match="position: 1 values"):
        head_from_message(JointState(name=["pan", "tilt"], position=[0.0]))
    with pytest.raises(MessageError, match="tilt: nan rad"):
        head_from_message(JointState(name=["pan", "tilt"], position=[0.0, math.nan]))


def test_angles_are_those_of_the_time_of_the_picture() -> None:
    history = AngleHistory()
    assert history.at(0, 10 * MS) is None
    history.add(100 * MS, 0.0, 1.0)
    history.add(120 * MS, 0.4, 1.2)
    angles = history.at(105 * MS, 10 * MS)
    assert angles is not None
    np.testing.assert_allclose(angles, [0.1, 1.05])
    assert history.at(135 * MS, 10 * MS) is None and history.at(85 * MS, 10 * MS) is None
    history.add(180 * MS, 0.4, 1.2)
    assert history.at(150 * MS, 10 * MS) is None  # a hole, though there are angles on both sides
    history.add(50 * MS, 0.3, 0.3)  # the robot was started anew
    assert history.at(105 * MS, 10 * MS) is None and history.at(50 * MS, 0) is not None


class World:
    """The bridge of a standing TALOS, and what the nodes make of it."""

    def __init__(self, bench: Any, model: RobotModel) -> None:
        self.bench, self.model, self.stamp = bench, model, 1000 * MS
        make, listen = bench.world.create_publisher, bench.world.create_subscription
        self.truth, self.joints = (
            make(Odometry, topics.GROUND_TRUTH, SENSOR),
            make(JointState, topics.GROUND_TRUTH_JOINTS, SENSOR),
        )
        self.head = make(JointState, topics.HEAD_STATE, SENSOR)
        self.target = make(PointStamped, topics.CAMERA_TARGET, EVENT)
        self.bearings: list[np.ndarray] = []
        self.detected: list[bool] = []
        self.sent: list[tuple[float, float]] = []
        listen(Vector3Stamped, topics.VISION_BEARING, self._on_bearing, SENSOR)
        listen(Bool, topics.VISION_DETECTED, lambda message: self.detected.append(message.data), SENSOR)
        listen(JointState, topics.HEAD_COMMAND, lambda message: self.sent.append(head_from_message(message)), EVENT)
        foot = ContactState(active=True, wrench=np.zeros(6))
        zero = np.zeros(model.nj)
        self.state = RobotState(0.0, model.standing_configuration(), np.zeros(model.nv), zero, (foot, foot))
        self._odometry, self._codec = OdometryCodec(), JointStateCodec(model)

    def _on_bearing(self, message: Any) -> None:
        assert message.header.frame_id == CAMERA_FRAME
        self.bearings.append(np.array([message.vector.x, message.vector.y, message.vector.z]))

    def tick(self) -> None:
        """A hundredth of a second of the bridge."""
        self.stamp += 10 * MS
        zero = np.zeros(self.model.nj)
        self.head.publish(head_message(self.stamp, 0.0, 0.0))
        self.truth.publish(self._odometry.encode(self.stamp, self.state))
        self.joints.publish(self._codec.encode(self.stamp, self.state.q[7:], zero, zero))
        self.bench.spin(0.03)

    def show(self, point: list[float]) -> None:
        """Put the ball to a point of W."""
        message = PointStamped()
        message.header.frame_id = topics.ODOM_FRAME
        message.point.x, message.point.y, message.point.z = point
        self.target.publish(message)

    def until(self, condition: Any) -> None:
        for _ in range(300):
            self.tick()
            if condition():
                return
        raise AssertionError("it did not happen in time")


@needs_gl
def test_a_ball_becomes_a_bearing_and_the_head_is_sent_after_it(bench: Any, talos: RobotModel) -> None:
    world = World(bench, talos)
    camera = bench.add(CameraNode, robot="talos")
    vision = bench.add(VisionNode, robot="talos", follow=True)
    world.until(lambda: world.detected)
    assert not any(world.detected) and camera.message == "drawing" and not world.bearings
    world.show([2.07, 0.7, 1.9])
    world.until(lambda: world.sent)
    azimuth, elevation = azimuth_elevation(world.bearings[-1])
    assert azimuth == pytest.approx(math.atan2(0.7, 2.0), abs=0.02)
    assert elevation == pytest.approx(math.atan2(0.262, 2.1), abs=0.02)
    pan, tilt = world.sent[-1]
    assert pan == pytest.approx(azimuth, abs=0.03) and tilt == pytest.approx(-elevation, abs=0.03)
    world.show([math.nan, 0.0, 0.0])
    bench.wait(lambda: camera.counters[f"refused {topics.CAMERA_TARGET}"] == 1)
    assert "is not finite" in camera.values["last refusal"]
    other = bench.world.create_publisher(Image, topics.CAMERA_IMAGE, SENSOR)
    bench.wait(lambda: other.get_subscription_count())
    other.publish(image_message(world.stamp, np.zeros((12, 20, 3), dtype=np.uint8)))
    bench.wait(lambda: vision.counters[f"refused {topics.CAMERA_IMAGE}"] == 1)
    assert "height, width: (12, 20)" in vision.values["last refusal"]


def test_diagnostics_show_what_is_in_the_newest_picture(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("controllers.nodes.vision_node.SILENCE", math.inf)
    vision = bench.add(VisionNode)
    infos = bench.world.create_publisher(CameraInfo, topics.CAMERA_INFO, SENSOR)
    pictures = bench.world.create_publisher(Image, topics.CAMERA_IMAGE, SENSOR)
    bench.wait(lambda: infos.get_subscription_count() and pictures.get_subscription_count())
    infos.publish(info_message(MS, Pinhole(40, 30, (40.0, 40.0), (19.5, 14.5))))
    bench.wait(lambda: vision._camera is not None)
    picture = np.full((30, 40, 3), 110, dtype=np.uint8)
    for colour, text, shown in (((20, 180, 40), "target", True), ((110, 110, 110), "no target", False)):
        picture[10:20, 10:20] = colour
        pictures.publish(image_message(MS, picture))
        bench.wait(lambda text=text: vision.message == f"{text} in the picture")
        assert ("azimuth [deg]" in vision.values) is shown
    monkeypatch.setattr("controllers.nodes.vision_node.SILENCE", 0.0)
    bench.wait(lambda: vision.publish_diagnostics() or vision.message == "no picture")


def test_without_a_gl_the_camera_says_what_brings_one_and_goes_on(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ctypes.util, "find_library", lambda name: None)
    camera = bench.add(CameraNode)
    camera.publish_diagnostics()
    assert camera.active and "libegl1 libgl1-mesa-dri" in camera.message
    assert camera.level == b"\x01"


def test_a_robot_without_a_head_refuses_to_turn_it_by_name(bench: Any) -> None:
    node = bench.add(BalanceControllerNode)
    publisher = bench.world.create_publisher(JointState, topics.HEAD_COMMAND, EVENT)
    bench.wait(lambda: publisher.get_subscription_count() == 1)
    publisher.publish(head_message(0, 0.1, 0.1))
    bench.wait(lambda: node.counters[f"refused {topics.HEAD_COMMAND}"] == 1)
    assert "no 'head.pan'" in node.values["last refusal"]
    vision = bench.add(VisionNode, active=False, follow=True)
    assert "g1: head" in vision.message


def test_a_target_that_a_turned_camera_sees_is_planned_for_where_it_is(bench: Any, talos: RobotModel) -> None:
    """The reference posture leaves out the head's command, the camera's frame must not."""
    try:
        kind = interface("poise_interfaces", "srv", "PlanMotion")
    except PoiseError as error:
        pytest.skip(str(error))
    node = bench.add(MotionPlannerNode, robot="talos")
    client = bench.world.create_client(kind, topics.PLAN_MOTION)
    make, posture = bench.world.create_publisher, talos.posture("stand")
    head = make(JointState, topics.HEAD_STATE, SENSOR)
    joints, mode = make(JointState, topics.POSTURE, SENSOR), make(String, topics.MODE, LATCHED)
    bench.wait(lambda: client.service_is_ready() and head.get_subscription_count() and joints.get_subscription_count())
    mode.publish(String(data="stand"))
    head.publish(head_message(MS, 0.7, 0.3))
    joints.publish(JointStateCodec(talos).encode(MS, posture, np.zeros(talos.nj), np.zeros(talos.nj)))
    bench.spin(0.3)
    assert talos.profile.head is not None
    q, data = np.concatenate([pin.neutral(talos.pin)[:7], posture]), talos.data()
    for name, angle in ((talos.profile.head.pan, 0.7), (talos.profile.head.tilt, 0.3)):
        q[7 + talos.joint_index(name)] = angle
    pin.framesForwardKinematics(talos.pin, data, q)
    place = data.oMf[talos.frame_id("l_wrist")].translation + np.array([0.08, 0.0, 0.08])  # in base_link

    def end(frame_id: str, point: Any) -> Any:
        request = kind.Request(frame="left_hand")
        request.target.header.frame_id = frame_id
        position = request.target.pose.position
        position.x, position.y, position.z = map(float, point)
        future = client.call_async(request)
        bench.wait(future.done, 60.0)
        assert future.result().success, (future.result().message, node.values)
        return future.result().trajectory.points[-1].positions

    seen = data.oMf[talos.frame_id(CAMERA_FRAME)].actInv(place)
    np.testing.assert_allclose(end(CAMERA_FRAME, seen), end("base_link", place), atol=1e-6)


@needs_gl
@pytest.mark.slow
def test_the_head_of_a_standing_talos_follows_a_ball_over_the_graph(tmp_path: Path, talos: RobotModel) -> None:
    """The whole graph: the ball goes to one side, then to the other, and the head's bearing error becomes small."""
    specs = [*process_specs(camera=True), ProcessSpec("controllers.nodes.vision_node", ("vision_node",))]
    follow = {"vision_node": {"follow": True, "autostart": False}}
    with Graph(
        "talos", lockstep=True, specs=specs, parameters=follow, domain_id=free_domain(), log=tmp_path / "log",
        say=lambda text: None,
    ) as graph:  # fmt: skip
        bearings: list[np.ndarray] = []
        modes: list[str] = []
        heads: list[tuple[float, float]] = []

        def on_bearing(message: Any) -> None:
            bearings.append(np.array([message.vector.x, message.vector.y, message.vector.z]))

        listen = graph.node.create_subscription
        listen(Vector3Stamped, topics.VISION_BEARING, on_bearing, SENSOR)
        listen(JointState, topics.HEAD_STATE, lambda message: heads.append(head_from_message(message)), SENSOR)
        listen(String, topics.MODE, lambda message: modes.append(message.data), LATCHED)
        ball = graph.node.create_publisher(PointStamped, topics.CAMERA_TARGET, EVENT)
        graph.wait_standing(120.0)
        for place in ((2.0, 0.9, 1.8), (2.0, 0.1, 1.4)):  # the second in sight of a camera that looks at the first
            bearings.clear()
            message = PointStamped()
            message.header.frame_id = topics.ODOM_FRAME
            message.point.x, message.point.y, message.point.z = place
            ball.publish(message)
            graph.wait_for(lambda: len(bearings) > 1, 60.0, "seeing the ball")
            graph.wait_for(lambda: math.acos(min(bearings[-1][2], 1.0)) < math.radians(2.0), 60.0, "looking at it")
            assert heads[-1][0] == pytest.approx(math.atan2(place[1], place[0] - 0.07), abs=0.06)
        assert (graph.mode, graph.driver_state) == ("stand", topics.ACTIVE) and set(modes) <= {"off", "damp", "stand"}
    assert set(graph.exit_codes.values()) == {0}
