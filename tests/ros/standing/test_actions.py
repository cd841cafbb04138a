"""Actions and services with types of this project, on the real graph."""

import math
from typing import Any

import pytest
from rclpy.action.client import ActionClient
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from bridge.launch.graph import Graph
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.interfaces import interface
from models.nodes.qos import SENSOR
from tests.ros.conftest import Eyes

try:
    SetMode, Command = (interface("poise_interfaces", "srv", name) for name in ("SetMode", "Command"))
    ExecuteMotion, WalkTo = (interface("poise_interfaces", "action", name) for name in ("ExecuteMotion", "WalkTo"))
    Follow = interface("control_msgs", "action", "FollowJointTrajectory")
except PoiseError as _error:
    pytest.skip(str(_error), allow_module_level=True)

pytestmark = [pytest.mark.ros, pytest.mark.graph, pytest.mark.usefixtures("eyes")]

ABORTED, CANCELED, SUCCEEDED = 6, 5, 4
"""action_msgs/GoalStatus."""


class User:
    """Somebody with an ordinary node."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self._clients: dict[str, Any] = {}

    def call(self, kind: Any, name: str, **request: Any) -> Any:
        return self.graph.ask(kind, name, kind.Request(**request), 20.0)

    def send(self, kind: Any, name: str, goal: Any, feedback: list[Any] | None = None) -> Any:
        """Send a goal; returns its handle once it is accepted."""
        if name not in self._clients:
            client = self._clients[name] = ActionClient(self.graph.node, kind, name)
            self.graph.wait_for(client.server_is_ready, 20.0, f"offering {name}")
            self.graph.spin(0.5)  # until the server has discovered its client
        client = self._clients[name]
        received: list[Any] = [] if feedback is None else feedback
        future = client.send_goal_async(goal, feedback_callback=lambda message: received.append(message.feedback))
        self.graph.wait_for(future.done, 20.0, f"accepting a goal of {name}")
        assert future.result().accepted
        return future.result()

    def posture(self, joint: str) -> float:
        """Reference posture of a joint [rad]."""
        received: list[Any] = []
        node = self.graph.node
        listener = node.create_subscription(JointState, topics.POSTURE, received.append, SENSOR)
        self.graph.wait_for(lambda: bool(received), 10.0, "publishing its posture")
        node.destroy_subscription(listener)
        return float(received[-1].position[list(received[-1].name).index(joint)])

    def result(self, handle: Any, timeout: float = 120.0) -> tuple[int, Any]:
        """State and result of a goal."""
        future = handle.get_result_async()
        self.graph.wait_for(future.done, timeout, "at the end of the goal")
        return future.result().status, future.result().result


@pytest.fixture(scope="module")
def user(running: Eyes) -> User:
    return User(running.graph)


def test_modes_and_words_are_answered_with_the_reason(user: User) -> None:
    answer = user.call(SetMode, "set_mode", mode="fly")
    assert not answer.success and answer.message == "unknown mode 'fly'; known: off, damp, stand, walk"
    answer = user.call(SetMode, "set_mode", mode="off")
    assert not answer.success and "the robot would drop" in answer.message
    answer = user.call(Command, "command", text="dance")
    assert not answer.success and "unknown command 'dance'" in answer.message


def test_a_motion_is_played_to_its_end(user: User) -> None:
    feedback: list[Any] = []
    status, result = user.result(user.send(ExecuteMotion, "execute_motion", ExecuteMotion.Goal(motion="bow"), feedback))
    assert status == SUCCEEDED and result.success, result
    states = [message.state for message in feedback]  # a fast planner is done before the first feedback
    assert set(states) - {"requested"} == {"running"} and states == sorted(states)
    assert feedback[-1].elapsed > 1.0


def test_an_unknown_motion_is_aborted_with_the_reason(user: User) -> None:
    status, result = user.result(user.send(ExecuteMotion, "execute_motion", ExecuteMotion.Goal(motion="dance")))
    assert status == ABORTED and "unknown command 'dance'" in result.message


def test_a_word_that_walks_is_no_motion(user: User) -> None:
    status, result = user.result(user.send(ExecuteMotion, "execute_motion", ExecuteMotion.Goal(motion="forward")))
    assert status == ABORTED and "'forward' is not a motion" in result.message
    assert user.graph.mode == "stand"


def begun(user: User, motion: str) -> Any:
    """A motion that runs."""
    feedback: list[Any] = []
    handle = user.send(ExecuteMotion, "execute_motion", ExecuteMotion.Goal(motion=motion), feedback)
    user.graph.wait_for(lambda: bool(feedback) and feedback[-1].state == "running", 60.0, f"doing {motion}")
    return handle


@pytest.mark.slow
def test_a_newer_motion_begins_when_the_older_one_has_ended(user: User) -> None:
    first = begun(user, "wave")
    second = user.send(ExecuteMotion, "execute_motion", ExecuteMotion.Goal(motion="bow"))
    status, result = user.result(first)
    assert status == ABORTED and result.message == "replaced by a newer goal"
    status, result = user.result(second)
    assert status == SUCCEEDED and result.success, result


def test_a_motion_that_somebody_else_stops_is_not_done(user: User) -> None:
    handle = begun(user, "wave")
    user.graph.send("stop")
    status, result = user.result(handle)
    assert status == ABORTED and result.message == "stopped by another client"


def test_a_motion_is_cancelled_and_the_robot_stands(user: User) -> None:
    handle = begun(user, "squat")
    handle.cancel_goal_async()
    status, result = user.result(handle)
    assert status == CANCELED and "holds its posture" in result.message
    user.graph.wait_for(lambda: user.graph.mode == "stand", 20.0, "standing")


def walk(x: float) -> Any:
    goal = WalkTo.Goal()
    goal.goal.header.frame_id = "odom"
    goal.goal.pose.position.x, goal.goal.pose.orientation.w = x, 1.0
    return goal


@pytest.mark.slow
def test_it_walks_to_a_pose_and_a_newer_goal_replaces_it(user: User) -> None:
    feedback: list[Any] = []
    first = user.send(WalkTo, "walk_to", walk(3.0))
    user.graph.wait_for(lambda: user.graph.mode == "walk", 30.0, "walking")
    second = user.send(WalkTo, "walk_to", walk(0.4), feedback)
    status, result = user.result(first)
    assert status == ABORTED and result.message == "replaced by a newer goal; mode 'stand'"
    status, result = user.result(second, 240.0)
    assert status == SUCCEEDED and result.success, result
    assert feedback[-1].distance < 0.1 and any(message.route.startswith("running") for message in feedback)
    assert user.graph.mode == "stand"


@pytest.mark.slow
def test_a_walk_is_cancelled_where_it_is(user: User) -> None:
    feedback: list[Any] = []
    handle = user.send(WalkTo, "walk_to", walk(3.0), feedback)
    user.graph.wait_for(lambda: bool(feedback) and feedback[-1].route.startswith("running"), 60.0, "walking")
    handle.cancel_goal_async()
    status, result = user.result(handle)
    assert status == CANCELED and result.message == "cancelled; mode 'stand'"
    assert user.graph.mode == "stand"


def trajectory(user: User, name: str, position: float) -> Any:
    goal = Follow.Goal()
    goal.trajectory = JointTrajectory(joint_names=[name])
    for time, value in ((0.0, 0.0), (2.0, position)):
        point = JointTrajectoryPoint(positions=[value], velocities=[0.0])
        point.time_from_start.sec = int(time)
        goal.trajectory.points.append(point)
    return goal


@pytest.mark.slow
def test_moveit_finds_its_action_and_receives_the_reason_of_a_refusal(user: User) -> None:
    name = "joint_trajectory_controller/follow_joint_trajectory"
    status, result = user.result(user.send(Follow, name, trajectory(user, "tail_joint", 0.1)))
    assert (
        status == ABORTED and result.error_code == Follow.Result.INVALID_JOINTS and "tail_joint" in result.error_string
    )
    status, result = user.result(user.send(Follow, name, trajectory(user, "waist_yaw_joint", math.pi)))
    assert (
        status == ABORTED
        and result.error_code == Follow.Result.INVALID_GOAL
        and "waist_yaw_joint" in result.error_string
    )
    feedback: list[Any] = []
    status, result = user.result(user.send(Follow, name, trajectory(user, "torso_yaw", 0.2), feedback))
    assert status == SUCCEEDED and result.error_code == Follow.Result.SUCCESSFUL, result
    assert feedback[-1].desired.positions[0] == pytest.approx(0.2, abs=0.02)
    back = trajectory(user, "waist_yaw_joint", -0.2)
    back.trajectory.points[0].positions[0] = 0.2
    feedback.clear()
    handle = user.send(Follow, name, back, feedback)
    user.graph.wait_for(lambda: bool(feedback) and feedback[-1].desired.positions[0] < 0.15, 60.0, "on its way")
    handle.cancel_goal_async()
    status, result = user.result(handle)
    assert status == CANCELED and "holds its posture" in result.error_string
    user.graph.spin(2.5)  # longer than the trajectory would have taken
    assert user.posture("waist_yaw_joint") > -0.15  # it stopped on its way
