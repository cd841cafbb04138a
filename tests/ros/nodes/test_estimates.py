"""What the estimator's node publishes beside the state: covariance, orientation, transforms; and how it coasts."""

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import String

from controllers.nodes.sample_topics import StateTopics
from controllers.nodes.state_estimator import StateEstimatorNode
from controllers.nodes.supervisor import SupervisorNode
from models.constants import GRAVITY
from models.errors import MessageError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.imu import OrientedImuCodec
from models.nodes.messages import ImuCodec, JointStateCodec, WrenchCodec, set_stamp
from models.nodes.qos import EVENT, LATCHED, SENSOR
from models.robot_model import SOLE_FRAMES, RobotModel
from models.types import PushEstimate, RobotState
from tests.ros.delivery import deliver

TFMessage = pytest.importorskip("tf2_msgs.msg", reason="tf2_msgs is not built").TFMessage

pytestmark = pytest.mark.ros


def pose(transform: Any) -> list[float]:
    """Translation and quaternion."""
    t, r = transform.transform.translation, transform.transform.rotation
    return [t.x, t.y, t.z, r.x, r.y, r.z, r.w]


MS = 1_000_000
START = 20
"""Samples averaged for the start."""


class Estimated:
    """A node fed with the samples of a robot that stands still, one tick a millisecond of its stamps."""

    def __init__(self, bench: Any, model: RobotModel, **parameters: object) -> None:
        self.bench, self.model, self.stamp = bench, model, 0
        self.states: list[tuple[RobotState, int]] = []

        def make(**kwargs: Any) -> StateEstimatorNode:
            return StateEstimatorNode(lambda state, stamp: self.states.append((state, stamp)), **kwargs)

        self.node = bench.add(make, start_samples=START, **parameters)
        self._joints, self._imu = JointStateCodec(model), ImuCodec(topics.IMU_FRAME)
        self._feet = [WrenchCodec(frame) for frame in SOLE_FRAMES]
        self.configuration = model.standing_configuration()
        data = model.data()
        pin.framesForwardKinematics(model.pin, data, self.configuration)
        self.imu = data.oMf[model.frame_id("imu")].rotation

    def tick(self, count: int = 1, *, imu: bool = True, feet: bool = True) -> None:
        """Feed the samples of so many ticks, with or without the IMU and the feet."""
        node, zero = self.node, np.zeros(self.model.nj)
        for _ in range(count):
            self.stamp += MS
            if imu:
                force = self.imu.T @ [0.0, 0.0, GRAVITY]
                deliver(node, topics.IMU_RAW, self._imu.encode(self.stamp, np.zeros(3), force))
            for foot, codec in enumerate(self._feet if feet else ()):
                wrench = np.array([0.0, 0.0, 0.5 * self.model.mass * GRAVITY, 0.0, 0.0, 0.0])
                deliver(node, topics.FOOT_WRENCHES[foot], codec.encode(self.stamp, wrench))
            joints = self._joints.encode(self.stamp, self.configuration[7:], zero, zero)
            deliver(node, topics.JOINT_STATES, joints)


class Controller(PoiseNode):
    """The states that a controller in another process receives."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("controller", **kwargs)
        self.states: list[RobotState] = []

    def configure(self) -> None:
        StateTopics(self, lambda state, stamp: self.states.append(state), SENSOR)


def test_odometry_orientation_and_transforms(bench: Any, robot: RobotModel) -> None:
    received: dict[str, list[bytes]] = {}
    for kind, topic, qos in (
        (Odometry, topics.ODOM, SENSOR),
        (Imu, topics.IMU_DATA, SENSOR),
        (WrenchStamped, topics.EXTERNAL_WRENCH, SENSOR),
        (TFMessage, topics.TF, EVENT),
        (TFMessage, topics.TF_STATIC, LATCHED),
    ):
        received[topic] = []
        bench.world.create_subscription(kind, topic, received[topic].append, qos, raw=True)
    robot_ = Estimated(bench, robot, robot=robot.name)
    estimates = robot_.node._estimates
    for publisher in (estimates._odom, estimates._imu, estimates._transforms._moving, estimates._wrench):
        bench.wait(lambda publisher=publisher: publisher.get_subscription_count() == 1)
    robot_.tick(START + 200)
    bench.wait(lambda: all(received.values()))

    odometry = deserialize_message(received[topics.ODOM][-1], Odometry)
    covariance, twist = (np.reshape(each.covariance, (6, 6)) for each in (odometry.pose, odometry.twist))
    for matrix in (covariance, twist):
        np.testing.assert_array_equal(matrix, matrix.T)
        assert np.linalg.eigvalsh(matrix).min() > 0.0
    assert covariance[3, 3] < 0.02**2  # roll [rad^2]

    _, sample = OrientedImuCodec(topics.IMU_FRAME).decode(received[topics.IMU_DATA][-1])
    rotation = pin.Quaternion(np.array(sample.orientation)).matrix()
    assert np.linalg.norm(pin.log3(rotation.T @ robot_.imu)) < 0.02  # [rad]
    assert 0.0 < sample.covariance[0, 0] < 0.02**2
    assert sample.accel == pytest.approx(robot_.imu.T @ [0.0, 0.0, GRAVITY], abs=0.05)

    _, wrench = WrenchCodec(topics.ODOM_FRAME).decode(received[topics.EXTERNAL_WRENCH][-1])
    np.testing.assert_array_equal(wrench, 0.0)  # no push

    base, footprint = deserialize_message(received[topics.TF][-1], TFMessage).transforms
    assert (base.header.frame_id, base.child_frame_id) == ("odom", "base_link")
    assert (footprint.header.frame_id, footprint.child_frame_id) == ("base_link", "base_footprint")
    np.testing.assert_allclose(pose(base), robot_.configuration[:7], atol=0.01)
    where = pin.XYZQUATToSE3(np.array(pose(base))) * pin.XYZQUATToSE3(np.array(pose(footprint)))
    np.testing.assert_allclose(where.translation, 0.0, atol=0.01)  # the soles stand on z = 0
    np.testing.assert_allclose(where.rotation, np.eye(3), atol=1e-3)
    assert {
        each.child_frame_id for each in deserialize_message(received[topics.TF_STATIC][0], TFMessage).transforms
    } >= set(SOLE_FRAMES)


def test_a_controller_in_another_process_gets_the_wrenches_that_the_estimator_judged(bench: Any) -> None:
    name = "g1_hardware"  # without foot sensors
    robot = Estimated(bench, RobotModel.load(name), robot=name, lockstep=True)
    controller = bench.add(Controller, robot=name)
    joints = JointStateCodec(robot.model).encode(MS, robot.configuration[7:], *np.zeros((2, robot.model.nj)))
    estimates = robot.node._estimates
    sources = (estimates._odom, *(publisher for publisher, _ in estimates._reactions))
    bench.wait(lambda: all(each.get_subscription_count() == 1 for each in sources))
    deliver(controller, topics.JOINT_STATES, joints)
    robot.tick(feet=False)
    bench.wait(lambda: controller.states)
    for judged, received in zip(robot.states[0][0].contacts, controller.states[0].contacts, strict=True):
        assert judged.wrench.any()
        np.testing.assert_array_equal(received.wrench, judged.wrench)


def test_every_topic_has_its_rate(bench: Any, g1: RobotModel, monkeypatch: pytest.MonkeyPatch) -> None:
    robot = Estimated(bench, g1, odom_rate=200.0, imu_rate=100.0, tf_rate=50.0, covariance_rate=20.0, push_rate=10.0)
    robot.tick(START)
    estimates, law = robot.node._estimates, robot.node._stack.estimator
    counts = dict.fromkeys(("_odom", "_contacts", "_imu", "_transforms", "_wrench"), 0)
    for name in counts:

        def count(*data: object, name: str = name) -> None:
            counts[name] += 1

        monkeypatch.setattr(getattr(estimates, name), "publish", count)
    computed: list[int] = []
    covariance = law.odometry_covariance
    monkeypatch.setattr(law, "odometry_covariance", lambda: (computed.append(1), covariance())[1])
    robot.tick(1000)
    assert counts == {"_odom": 200, "_contacts": 200, "_imu": 100, "_transforms": 50, "_wrench": 10}
    assert len(computed) == 20
    assert len(robot.states) == 1001


def test_a_push_is_published(bench: Any, g1: RobotModel, monkeypatch: pytest.MonkeyPatch) -> None:
    received: list[bytes] = []
    bench.world.create_subscription(WrenchStamped, topics.EXTERNAL_WRENCH, received.append, SENSOR, raw=True)
    robot = Estimated(bench, g1)
    robot.tick(START)
    bench.wait(lambda: robot.node._estimates._wrench.get_subscription_count() == 1)
    push = PushEstimate(np.array([60.0, 0.0, -1.0]), np.array([0.0, 7.0, 0.0]), True, np.array([6.0, 0.0, 0.0]))
    monkeypatch.setattr(type(robot.node._stack.estimator), "push", property(lambda law: push))
    robot.tick(20)
    bench.wait(lambda: received)
    _, wrench = WrenchCodec(topics.ODOM_FRAME).decode(received[-1])
    np.testing.assert_array_equal(wrench, [60.0, 0.0, -1.0, 0.0, 7.0, 0.0])
    robot.node.before_diagnostics()
    assert robot.node.values["push [N]"] == "60.0 0.0 -1.0"
    assert robot.node.values["impulse of the push [N.s]"] == "6.0 0.0 0.0"


def test_no_orientation_without_the_imu(bench: Any, g1: RobotModel, monkeypatch: pytest.MonkeyPatch) -> None:
    robot = Estimated(bench, g1)
    robot.tick(START + 20)
    sent: list[object] = []
    monkeypatch.setattr(robot.node._estimates._imu, "publish", sent.append)
    robot.tick(10, imu=False)
    sent.clear()
    robot.tick(50, imu=False)
    assert sent == []
    robot.tick(50)
    assert len(sent) == 5


def test_the_plant_that_asks_again_gets_the_same_state(bench: Any, g1: RobotModel) -> None:
    robot = Estimated(bench, g1, lockstep=True)
    robot.tick(3)
    zero = np.zeros(g1.nj)
    again = JointStateCodec(g1).encode(robot.stamp, robot.configuration[7:], zero, zero)
    deliver(robot.node, topics.JOINT_STATES, again)
    (*_, before, last) = robot.states
    assert len(robot.states) == 4
    assert last[1] == before[1] == robot.stamp
    assert last[0] is before[0]


def test_a_silent_imu_is_bridged_and_reported_as_is_its_return(bench: Any, g1: RobotModel) -> None:
    reports: list[dict[str, str]] = []

    def hear(array: DiagnosticArray) -> None:
        for status in array.status:
            reports.append({"message": status.message, **{item.key: item.value for item in status.values}})

    bench.world.create_subscription(DiagnosticArray, "/diagnostics", hear, EVENT)
    robot = Estimated(bench, g1, diagnostics_period=10.0)
    bench.spin(0.3)
    robot.tick(START + 100)
    last_good = robot.stamp
    reports.clear()
    height = robot.states[-1][0].q[2]
    robot.states.clear()
    robot.tick(30, imu=False)
    bench.wait(lambda: reports)
    assert len(robot.states) == 27  # the first of it is waited for in vain
    since = int(reports[0]["coasting since [ns]"])
    assert last_good <= since <= last_good + 6 * MS  # a sample serves for up to 5 ms
    reports.clear()
    robot.tick(10)
    bench.wait(lambda: reports)
    assert reports[0]["coasting since [ns]"] == ""
    assert int(reports[0]["invalid imu"]) > 5
    assert reports[0]["drop-outs"] == "1"
    assert int(reports[0]["ticks with a silent sensor"]) > 5
    assert robot.states[-1][0].q[2] == pytest.approx(height, abs=0.002)
    robot.tick(5, imu=False)
    assert robot.node.counters["drop-outs"] == 1  # short enough to wait for the timer


def test_estimator_and_supervisor_together_bridge_20_ms_and_damp_at_100_ms(bench: Any, g1: RobotModel) -> None:
    modes: list[str] = []
    bench.world.create_subscription(String, topics.MODE, lambda message: modes.append(message.data), LATCHED)
    drivers = bench.world.create_publisher(String, topics.DRIVER_STATE, LATCHED)
    clock = bench.world.create_publisher(Clock, topics.CLOCK, SENSOR)
    posture, codec = bench.world.create_publisher(JointState, topics.POSTURE, SENSOR), JointStateCodec(g1)
    robot = Estimated(bench, g1)

    def tell_time() -> None:
        """The time, and the sign of life of a controller."""
        message = Clock()
        set_stamp(message.clock, robot.stamp)
        clock.publish(message)
        posture.publish(codec.encode(robot.stamp, *np.zeros((3, g1.nj))))

    bench.world.create_timer(0.02, tell_time)
    robot.tick(START + 50)
    drivers.publish(String(data=topics.ACTIVE))
    supervisor = bench.add(SupervisorNode, lockstep=True)
    bench.wait(lambda: modes)
    bench.spin(0.3)
    robot.tick(20, imu=False)
    bench.spin(0.2)
    robot.tick(10)
    bench.spin(0.2)
    assert modes == ["stand"]
    for _ in range(5):
        robot.tick(20, imu=False)
        bench.spin(0.1)
    bench.wait(lambda: modes[-1] == "damp")
    (fault,) = supervisor._law.faults
    assert fault.startswith("no usable samples of the IMU")


def test_a_start_without_the_imu_waits(bench: Any, g1: RobotModel) -> None:
    robot = Estimated(bench, g1)
    robot.tick(START - 5)
    robot.tick(20, imu=False)  # the first two late ones still count
    robot.tick(START - 2)
    assert robot.states == []
    robot.tick(3)
    assert robot.states


def test_a_robot_without_foot_sensors(bench: Any, barefoot: Path) -> None:
    model = RobotModel.load(barefoot)
    robot = Estimated(bench, model, robot=str(barefoot))
    robot.tick(START + 50, feet=False)
    assert len(robot.states) == 51
    assert robot.node._samples.assembler.whole
    assert robot.node._samples.assembler.silent == 0
    robot.node.before_diagnostics()
    assert robot.node.values["foot sensors"] == "(absent, absent)"
    assert topics.sensor_topics(model) == (topics.JOINT_STATES, topics.IMU_RAW)


def test_without_the_type_of_tf_the_rest_goes_on(bench: Any, g1: RobotModel, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*name: str) -> None:
        raise MessageError("tf2_msgs is not installed")

    monkeypatch.setattr("controllers.nodes.estimate_topics.interface", refuse)
    robot = Estimated(bench, g1)
    robot.tick(START + 100)
    assert robot.states
    assert "tf2_msgs is not installed" in robot.node.values[topics.TF]


def test_imu_data_without_orientation_is_refused() -> None:
    raw = ImuCodec(topics.IMU_FRAME).encode(1, np.zeros(3), np.zeros(3))
    with pytest.raises(MessageError, match="no orientation"):
        OrientedImuCodec(topics.IMU_FRAME).decode(raw)


def test_samples_of_before_a_reset_are_no_part_of_the_start(bench: Any, g1: RobotModel) -> None:
    robot = Estimated(bench, g1)
    drivers = bench.world.create_publisher(String, topics.DRIVER_STATE, LATCHED)
    robot.tick(START - 5)
    drivers.publish(String(data=topics.HELD))
    bench.wait(lambda: not robot.node._first)
    robot.tick(START - 5)
    assert robot.states == []
