"""Service ``plan_motion`` of the planner's node, beside a world that plays controller and supervisor."""

from typing import Any

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from models.errors import PoiseError
from models.nodes import topics
from models.nodes.interfaces import interface
from models.nodes.messages import JointStateCodec, trajectory_from_message
from models.nodes.odometry import OdometryCodec
from models.nodes.qos import EVENT, LATCHED, SENSOR
from models.robot_model import RobotModel
from models.trajectory import validate_trajectory
from planners.nodes.motion_planner import MotionPlannerNode
from tests.support import standing

try:
    PlanMotion = interface("poise_interfaces", "srv", "PlanMotion")
except PoiseError as _error:
    pytest.skip(str(_error), allow_module_level=True)

from models.status import MotionState, MotionStatus
from tests.ros.conftest import StatusTopic

pytestmark = pytest.mark.ros


class World:
    """A planner, and publishers of the topics that it reads."""

    def __init__(self, bench: Any, robot: RobotModel) -> None:
        self.bench, self.robot, world = bench, robot, bench.world
        self.published: list[Any] = []
        self.mode = world.create_publisher(String, topics.MODE, LATCHED)
        self.state = StatusTopic(world, topics.MOTION_STATUS)
        self.posture = world.create_publisher(JointState, topics.POSTURE, SENSOR)
        self.odom = world.create_publisher(Odometry, topics.ODOM, SENSOR)
        world.create_subscription(JointTrajectory, topics.MOTION_TRAJECTORY, self.published.append, EVENT)
        self.client = world.create_client(PlanMotion, topics.PLAN_MOTION)
        self.node = bench.add(MotionPlannerNode)
        for publisher in (self.mode, self.state, self.posture, self.odom):
            bench.wait(lambda publisher=publisher: publisher.get_subscription_count() >= 1)
        bench.wait(self.client.service_is_ready)
        bench.spin(0.2)

    def stand(self) -> None:
        """Say that the robot stands, and how."""
        self.mode.publish(String(data="stand"))
        self.hold(self.robot.posture("stand"))

    def hold(self, posture: Any, *, speed: float = 0.0, time: float = 0.0) -> None:
        """Publish the posture (nj,) [rad] of a time [s], in which each joint moves with a speed [rad/s]."""
        zero = np.zeros(self.robot.nj)
        self.posture.publish(JointStateCodec(self.robot).encode(1 + round(time * 1e9), posture, zero + speed, zero))
        self.bench.spin(0.3)

    def ask(self, place: tuple[float, float, float], frame_id: str = "base_link", **more: Any) -> Any:
        """Future of a request."""
        request = PlanMotion.Request(**{"frame": "left_hand", **more})
        request.target.header.frame_id = frame_id
        position = request.target.pose.position
        position.x, position.y, position.z = place
        return self.client.call_async(request)

    def answer(self, future: Any) -> Any:
        """Response of a request."""
        self.bench.wait(future.done, 30.0)
        return future.result()


PLACE = (0.25, 0.25, 0.15)
"""That the left hand of a G1 reaches, in base_link [m]."""


def test_refusals_name_their_reason(bench: Any, g1: RobotModel) -> None:
    world = World(bench, g1)
    assert "no plans in mode 'unknown'" in world.answer(world.ask(PLACE)).message
    world.mode.publish(String(data="stand"))
    bench.spin(0.2)
    assert "no posture" in world.answer(world.ask(PLACE)).message
    world.stand()
    assert "'tail' cannot be moved" in world.answer(world.ask(PLACE, frame="tail")).message
    assert "no odometry" in world.answer(world.ask(PLACE, "odom")).message
    assert "duration: -1.0 s" in world.answer(world.ask(PLACE, duration=-1.0)).message
    turned = PlanMotion.Request(frame="left_hand")
    turned.target.header.frame_id, turned.target.pose.orientation.z = "base_link", 1.0
    assert "use_orientation is false" in world.answer(world.client.call_async(turned)).message
    assert "missed by" in world.answer(world.ask((2.0, 0.0, 0.0))).message
    assert world.node.counters[f"refused {topics.PLAN_MOTION}"] == 7 and not world.published
    world.mode.publish(String(data="walk"))
    bench.spin(0.2)
    assert "no plans in mode 'walk'" in world.answer(world.ask(PLACE)).message


def test_a_plan_is_one_that_the_controller_takes(bench: Any, g1: RobotModel) -> None:
    world = World(bench, g1)
    world.stand()
    answer = world.answer(world.ask(PLACE))
    assert answer.success and not world.published, answer.message
    trajectory = trajectory_from_message(answer.trajectory)
    validate_trajectory(trajectory, g1, start_q=np.array(g1.posture("stand")))
    assert trajectory.joint_names == g1.joint_names
    assert trajectory.velocities is not None and not trajectory.velocities[-1].any()
    assert answer.trajectory.header.frame_id == "" and answer.trajectory.header.stamp.sec == 0
    world.odom.publish(OdometryCodec().encode(1, standing(g1)))
    bench.spin(0.2)
    pose = standing(g1).q
    there = tuple(float(pose[i] + PLACE[i]) for i in range(3))  # the base is level, at that place in odom
    again = world.answer(world.ask(there, "odom"))
    assert again.success, again.message
    np.testing.assert_allclose(
        trajectory_from_message(again.trajectory).positions[-1], trajectory.positions[-1], atol=1e-3
    )


def test_a_request_to_execute_is_answered_with_the_state_of_the_motion(
    bench: Any, g1: RobotModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    world = World(bench, g1)
    world.stand()
    future = world.ask(PLACE, execute=True)
    bench.wait(lambda: world.published, 30.0)
    bench.spin(0.2)
    assert not future.done()
    assert "another plan" in world.answer(world.ask(PLACE)).message  # and the node goes on meanwhile
    world.state.publish(MotionStatus(MotionState.RUNNING))
    assert world.answer(future).success and len(world.published[0].points) > 50
    refused = world.ask(PLACE, execute=True)
    bench.wait(lambda: len(world.published) == 2, 30.0)
    world.state.publish(MotionStatus(MotionState.REFUSED, reason="start jump"))
    answer = world.answer(refused)
    assert not answer.success and answer.message == "refused by the controller: start jump"
    monkeypatch.setattr("planners.nodes.motion_planner.BEGIN_TIMEOUT", 0.3)
    silent = world.answer(world.ask(PLACE, execute=True))
    assert not silent.success and "did not confirm" in silent.message


@pytest.mark.parametrize("speed, time", [(0.0, 0.1), (0.5, 1.1)])
def test_a_motion_is_planned_from_a_posture_at_rest_or_after_a_second(
    bench: Any, g1: RobotModel, speed: float, time: float
) -> None:
    world, posture = World(bench, g1), g1.posture("stand").copy()
    requests = bench.world.create_publisher(String, topics.MOTION_REQUEST, EVENT)
    bench.wait(lambda: requests.get_subscription_count() >= 1)
    world.hold(posture, speed=0.5)
    requests.publish(String(data="wave 1"))
    world.hold(posture, speed=0.5, time=0.05)
    assert not world.published
    posture[g1.joint_index("right_elbow_joint")] += 0.2
    world.hold(posture, speed=speed, time=time)
    bench.wait(lambda: world.published, 30.0)
    np.testing.assert_allclose(trajectory_from_message(world.published[0]).positions[0], posture, atol=0.01)
    world.hold(posture, time=2.0)
    assert len(world.published) == 1
