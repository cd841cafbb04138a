"""The demonstration's observer."""

import threading

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.node import Node
from sensor_msgs.msg import JointState

from bridge.record.observer import Observer
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.messages import JointStateCodec, WrenchCodec
from models.nodes.odometry import OdometryCodec
from models.nodes.qos import SENSOR
from models.robot_model import SOLE_FRAMES, RobotModel
from tests.support import standing

pytestmark = pytest.mark.ros


def test_the_observer_joins_what_it_saw(context: Context, g1: RobotModel) -> None:
    node = Node("plant", context=context)
    odom = node.create_publisher(Odometry, topics.GROUND_TRUTH, SENSOR)
    joints = node.create_publisher(JointState, topics.JOINT_STATES, SENSOR)
    estimate = node.create_publisher(Odometry, topics.ODOM, SENSOR)
    feet = [node.create_publisher(WrenchStamped, topic, SENSOR) for topic in topics.FOOT_WRENCHES]
    odom_codec, joint_codec = OdometryCodec(), JointStateCodec(g1)
    foot_codecs = [WrenchCodec(frame) for frame in SOLE_FRAMES]
    observer = Observer(g1, context)
    with pytest.raises(
        PoiseError, match="no messages on ground_truth/odom, joint_states, foot/left/wrench, foot/right/wrench"
    ):
        observer.recording([])
    q = g1.standing_configuration()
    try:
        for k in range(1, 500):
            stamp = k * 1_000_000
            q[2], values = 0.7 + 1e-6 * k, np.full(g1.nj, 1e-3 * k)
            for foot, publisher in enumerate(feet):
                publisher.publish(foot_codecs[foot].encode(stamp, np.full(6, float(k) * (foot + 1))))
            joints.publish(joint_codec.encode(stamp, values, 2.0 * values, 3.0 * values))
            estimate.publish(odom_codec.encode(stamp, standing(g1, q=q)))
            odom.publish(odom_codec.encode(stamp, standing(g1, q=q)))
            threading.Event().wait(0.002)
            if k % 10 == 0:
                observer.poll()
            if k == 250:  # time waits: the same again, which is no reset
                odom.publish(odom_codec.encode(stamp, standing(g1, q=q)))
                threading.Event().wait(0.01)
                observer.poll()
        assert observer.ready
        recording = observer.recording([(0.1, "wave")])
    finally:
        observer.close()
        node.destroy_node()
    assert len(recording.t) > 20 and np.all(np.diff(recording.t) > 0.0)
    inner = slice(2, -2)  # the ends are held, not interpolated
    t = recording.t[inner]
    assert recording.q[inner, 2] == pytest.approx(0.7 + 1e-3 * t, abs=1e-12)
    assert recording.q[inner, 7] == pytest.approx(t) and recording.v[inner, 6] == pytest.approx(2.0 * t)
    assert recording.tau[inner, -1] == pytest.approx(3.0 * t)
    assert recording.wrenches[inner, 1, 5] == pytest.approx(2000.0 * t)
    assert recording.estimate is not None
    assert recording.estimate[inner, 2] == pytest.approx(0.7 + 1e-3 * t, abs=1e-12)
    assert recording.events == ((0.1, "wave"),)


def test_a_robot_without_foot_sensors_is_recorded_without_them(
    context: Context, g1: RobotModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(topics, "foot_wrenches", lambda model: ())
    observer = Observer(g1, context)
    with pytest.raises(PoiseError, match="no messages on ground_truth/odom, joint_states"):
        observer.recording([])
    observer._rows[topics.GROUND_TRUTH] += [(k, np.zeros(13)) for k in range(3)]
    observer._rows[topics.JOINT_STATES] += [(k, np.zeros(3 * g1.nj)) for k in range(3)]
    recording = observer.recording([])
    observer.close()
    assert np.isnan(recording.wrenches).all() and recording.estimate is None
