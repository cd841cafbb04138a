"""Trajectories of a user, as textbooks publish them, are executed while the robot balances."""

import numpy as np
import pytest
from trajectory_msgs.msg import JointTrajectory

from models.nodes import topics
from models.nodes.messages import JointStateCodec, trajectory_to_message
from models.robot_model import RobotModel
from models.types import JointTrajectory as Trajectory
from tests.ros.conftest import Eyes
from tests.ros.trajectories import arm, point

pytestmark = [pytest.mark.ros, pytest.mark.graph]


@pytest.mark.parametrize("topic", [topics.JOINT_TRAJECTORY, topics.MOTION_TRAJECTORY])
def test_single_points_at_50_hz_and_a_long_list(eyes: Eyes, g1: RobotModel, topic: str) -> None:
    node, joint = eyes.graph.node, "left_elbow_joint"
    publisher = eyes.publisher(JointTrajectory, topic)
    start = arm(eyes, g1, joint)
    for k in range(1, 51):
        publisher.publish(point([joint], [start - 0.4 * k / 50], 0.0))
        eyes.graph.spin(0.02)
    eyes.graph.wait_for(lambda: abs(arm(eyes, g1, joint) - (start - 0.4)) < 1e-3, 30.0, "where the stream ended")
    posture = JointStateCodec(g1).decode(eyes.posture)[1]
    times = np.linspace(0.01, 1.0, 100)
    path = np.tile(posture, (100, 1))
    path[:, g1.joint_index(joint)] += 0.4 * times
    publisher.publish(trajectory_to_message(Trajectory(g1.joint_names, times, path)))
    eyes.graph.wait_for(lambda: abs(arm(eyes, g1, joint) - start) < 1e-3, 30.0, "where the list ended")
    assert (eyes.graph.mode, eyes.graph.driver_state) == ("stand", "active")
    node.destroy_publisher(publisher)


def test_a_frame_is_no_request_of_a_user(eyes: Eyes, g1: RobotModel) -> None:
    publisher = eyes.publisher(JointTrajectory, topics.JOINT_TRAJECTORY)
    eyes.motion.clear()
    publisher.publish(point(["left_elbow_joint"], [arm(eyes, g1, "left_elbow_joint")], 0.5, "base_link"))
    eyes.graph.wait_for(lambda: eyes.motion == ["running", "done"], 30.0, "executed")
