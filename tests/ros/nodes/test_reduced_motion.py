"""A motion that is planned smaller than requested: who listens to its status reads how much, and then it runs."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from benchmarks.stability.humanoids import Humanoid
from models.nodes import topics
from models.nodes.messages import JointStateCodec
from models.nodes.qos import EVENT, SENSOR
from models.nodes.status import subscribe_status
from models.proposal.profile_text import write_proposal
from models.proposal.propose import propose
from models.robot_model import RobotModel
from models.status import MotionState, MotionStatus
from planners.nodes.motion_planner import MotionPlannerNode

pytestmark = pytest.mark.ros


def test_a_reduced_motion_is_said_before_its_trajectory(bench: Any, tmp_path: Path) -> None:
    file = write_proposal(propose(Humanoid(arm=0.3).write(tmp_path)), tmp_path / "short.yaml")[0]
    robot, received = RobotModel.load(file), list[MotionStatus]()
    trajectories: list[JointTrajectory] = []
    bench.add(MotionPlannerNode, robot=str(file))
    subscribe_status(bench.world, MotionStatus, topics.MOTION_STATUS, received.append)
    bench.world.create_subscription(JointTrajectory, topics.MOTION_TRAJECTORY, trajectories.append, EVENT)
    posture = bench.world.create_publisher(JointState, topics.POSTURE, SENSOR)
    request = bench.world.create_publisher(String, topics.MOTION_REQUEST, EVENT)
    bench.wait(lambda: posture.get_subscription_count() >= 1 and request.get_subscription_count() >= 1)
    bench.spin(0.3)
    zero = np.zeros(robot.nj)
    posture.publish(JointStateCodec(robot).encode(1, robot.posture("stand"), zero, zero))
    bench.spin(0.3)
    for motion in ("wave", "squat"):
        count = len(trajectories)
        request.publish(String(data=motion))
        bench.wait(lambda count=count: len(trajectories) > count, 30.0)
    bench.spin(0.2)
    assert [(status.state, status.request) for status in received] == [(MotionState.REDUCED, "wave")]
    assert "% of its size" in received[0].reason
