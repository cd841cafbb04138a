"""Trajectories of a user, as textbooks publish them, are executed while the robot balances."""

from pathlib import Path

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from bridge.record.mcap_log import DESCRIPTION, ROBOT, TYPES, McapLog
from bridge.record.run_file import read_run
from models.nodes import topics
from models.nodes.messages import JointCommandCodec, JointStateCodec, set_stamp, trajectory_to_message
from models.nodes.qos import EVENT
from models.robot_model import RobotModel
from models.types import JointCommand
from models.types import JointTrajectory as Trajectory
from tests.ros.conftest import Eyes

pytestmark = [pytest.mark.ros, pytest.mark.graph]


def point(names: list[str], positions: list[float], seconds: float, frame_id: str = "") -> JointTrajectory:
    """One point, due after a time [s]."""
    message = JointTrajectory(joint_names=names, points=[JointTrajectoryPoint(positions=positions)])
    set_stamp(message.points[0].time_from_start, round(1e9 * seconds))
    message.header.frame_id = frame_id
    return message


def arm(eyes: Eyes, g1: RobotModel, joint: str) -> float:
    """Reference angle of a joint [rad]."""
    return float(JointStateCodec(g1).decode(eyes.posture)[1][g1.joint_index(joint)])


@pytest.mark.parametrize("topic", [topics.JOINT_TRAJECTORY, topics.MOTION_TRAJECTORY])
def test_single_points_at_50_hz_and_a_long_list(eyes: Eyes, g1: RobotModel, topic: str) -> None:
    node, joint = eyes.graph.node, "left_elbow_joint"
    publisher = node.create_publisher(JointTrajectory, topic, EVENT)
    eyes.graph.wait_for(lambda: publisher.get_subscription_count() == 1, 10.0, "matched")
    start = arm(eyes, g1, joint)
    for k in range(1, 51):
        publisher.publish(point([joint], [start - 0.4 * k / 50], 0.0))
        eyes.graph.spin(0.02)
    eyes.graph.wait_for(lambda: abs(arm(eyes, g1, joint) - (start - 0.4)) < 1e-3, 10.0, "where the stream ended")
    posture = JointStateCodec(g1).decode(eyes.posture)[1]
    times = np.linspace(0.01, 1.0, 100)
    path = np.tile(posture, (100, 1))
    path[:, g1.joint_index(joint)] += 0.4 * times
    publisher.publish(trajectory_to_message(Trajectory(g1.joint_names, times, path)))
    eyes.graph.wait_for(lambda: abs(arm(eyes, g1, joint) - start) < 1e-3, 10.0, "where the list ended")
    assert (eyes.graph.mode, eyes.graph.driver_state) == ("stand", "active")
    node.destroy_publisher(publisher)


def test_a_frame_is_no_request_of_a_user(eyes: Eyes, g1: RobotModel) -> None:
    publisher = eyes.graph.node.create_publisher(JointTrajectory, topics.JOINT_TRAJECTORY, EVENT)
    eyes.graph.wait_for(lambda: publisher.get_subscription_count() == 1, 10.0, "matched")
    eyes.motion.clear()
    publisher.publish(point(["left_elbow_joint"], [arm(eyes, g1, "left_elbow_joint")], 0.5, "base_link"))
    eyes.graph.wait_for(lambda: eyes.motion == ["running", "done"], 10.0, "executed")


@pytest.mark.parametrize("old", [True, False])
def test_a_recording_holds_setpoints_and_trajectories(g1: RobotModel, tmp_path: Path, old: bool) -> None:
    """Earlier versions recorded the setpoints under the name that is a user's trajectory now."""
    zero, log = np.zeros(g1.nj), McapLog(tmp_path / "run.mcap")
    setpoint = JointCommandCodec(g1).encode(1000, JointCommand(g1.posture("stand"), zero, zero))
    names = [topics.JOINT_TRAJECTORY] if old else [topics.JOINT_SETPOINTS, topics.JOINT_TRAJECTORY]
    for name in names:
        log.announce(f"/{name}", TYPES[name])
    log.add(f"/{names[0]}", setpoint, 1000)
    if not old:
        log.add(f"/{names[1]}", bytes(serialize_message(point(["left_elbow_joint"], [1.0], 0.5))), 1000)
    log.describe(DESCRIPTION, {ROBOT: "g1"})
    log.close()
    run = read_run(tmp_path / "run.mcap")
    assert list(run.commands) == [1000]
    assert len(run.motions) == (0 if old else 1)
