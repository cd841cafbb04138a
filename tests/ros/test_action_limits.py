"""Limits of the actions are parameters of their node, and a failure names the limit."""

import asyncio
import math
from collections import deque
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.action.client import ActionClient
from std_msgs.msg import String

from bridge.nodes.action_server import ActionServerNode, FollowJointTrajectory, WalkTo, track_motion
from bridge.nodes.action_server import ExecuteMotion as MotionAction
from bridge.ros.goals import Action, ActionsConfig, Outcome, RobotClient, Turn
from models.config import default_config
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.interfaces import interface
from models.nodes.qos import LATCHED
from models.status import MotionState, MotionStatus, RouteState, RouteStatus, SupervisorStatus
from models.types import CommandReply, Mode
from tests.ros.conftest import StatusTopic

try:
    ExecuteMotion = interface("poise_interfaces", "action", "ExecuteMotion")
except PoiseError as _error:
    pytest.skip(str(_error), allow_module_level=True)

pytestmark = pytest.mark.ros


def test_a_goal_waits_for_its_answer_as_long_as_the_parameter_says(bench: Any) -> None:
    node = bench.add(ActionServerNode, answer_timeout=0.2)
    bench.world.create_publisher(String, topics.MODE, LATCHED).publish(String(data="stand"))
    bench.wait(lambda: node._turns.robot.mode == "stand")
    client = ActionClient(bench.world, ExecuteMotion, "execute_motion")
    bench.wait(client.server_is_ready)
    bench.spin(0.2)
    sent = client.send_goal_async(ExecuteMotion.Goal(motion="wave"))
    bench.wait(sent.done)
    ended = sent.result().get_result_async()
    bench.wait(ended.done, 4.0)  # less than the packaged answer_timeout
    result = ended.result().result
    assert not result.success and "service command is not available" in result.message
    client.destroy()


def test_a_limit_out_of_range_is_refused_by_name(bench: Any) -> None:
    with pytest.raises(Exception, match="answer_timeout"):
        bench.add(ActionServerNode, answer_timeout=-1.0)


def test_a_walk_that_does_not_stop_fails_with_the_time_waited() -> None:
    async def set_mode(mode: str) -> CommandReply:
        return CommandReply(True, "stand: requested")

    async def until(condition: Callable[[], bool], timeout: float) -> bool:
        return condition()

    config = default_config(ActionsConfig, "bridge", "actions")
    robot: Any = SimpleNamespace(mode="walk", route=[], config=config, begin=list, set_mode=set_mode, until=until)
    robot.routes_begun = 0
    handle: Any = SimpleNamespace(request=SimpleNamespace(goal=None))
    turn: Any = SimpleNamespace(ended="replaced")
    outcome = asyncio.run(WalkTo(robot, None, list).run(handle, turn))
    assert not outcome.success and outcome.message.startswith("replaced; the robot did not stop")
    assert outcome.message.endswith(f"within {config.stand_timeout:g} s")


@pytest.mark.parametrize(
    ("states", "ended"),
    [
        ("running done", Outcome(True, "completed")),
        ("refused", Outcome(False, "wave 2: too far")),
        ("refused/other running done", Outcome(True, "completed")),
        ("running refused done", Outcome(True, "completed")),  # another client's
        ("running running done", Outcome(False, "replaced by a motion of another client")),
        ("running ended done", Outcome(False, "too far")),
    ],
)
def test_a_motion_of_another_client_is_not_taken_for_that_of_the_goal(states: str, ended: Outcome) -> None:
    robot: Any = object.__new__(RobotClient)
    robot.config, robot.motion, coming = default_config(ActionsConfig, "bridge", "actions"), deque(), []
    robot.stops, robot.mode, robot._looks = 0, "motion", 1
    for each in states.split():
        state, _, of = each.partition("/")
        coming.append(MotionStatus(MotionState(state), request="" if of else "wave 2", reason="too far"))

    async def turn() -> None:
        robot._on_motion(coming.pop(0))

    robot.turn = turn
    handle: Any = SimpleNamespace(is_cancel_requested=False)
    assert (
        asyncio.run(track_motion(handle, robot, cast(Turn, SimpleNamespace(ended="")), lambda _: None, planned=True))
        == ended
    )


@pytest.mark.parametrize(
    ("states", "message"),
    [
        ("refused done", "too far; mode 'stand'"),  # at once
        ("running refused done", "goal reached; mode 'stand'"),  # another client's
        ("running running done", "replaced by a goal of another client"),
    ],
)
def test_a_goal_ends_with_its_own_route(states: str, message: str) -> None:
    robot: Any = object.__new__(RobotClient)
    robot.config, robot.route, robot.motion = default_config(ActionsConfig, "bridge", "actions"), deque(), deque()
    robot.mode, robot._looks, robot._status, goals = "walk", 1, None, list[Any]()
    coming = [RouteStatus(RouteState(state), reason="too far") for state in states.split()]

    async def set_mode(mode: Mode) -> CommandReply:
        robot.mode = mode.value
        return CommandReply(True, "")

    async def turn() -> None:
        robot.gait_ready = True
        if goals:
            robot._on_route(coming.pop(0))

    robot.set_mode, robot.turn, robot.begin = set_mode, turn, list  # no feedback is due
    goal: Any = SimpleNamespace(pose=SimpleNamespace(position=SimpleNamespace(x=0.0, y=0.0)))
    handle: Any = SimpleNamespace(request=SimpleNamespace(goal=goal), is_cancel_requested=False)
    turned = cast(Turn, SimpleNamespace(ended=""))
    outcome = asyncio.run(WalkTo(robot, None, goals.append).run(handle, turned))
    assert outcome == Outcome(message.startswith("goal reached"), message) and goals == [goal]


@pytest.mark.parametrize(
    ("frame", "x", "reason"), [("", 0.0, "instead of 'odom'"), ("map", 0.0, "'map'"), ("odom", math.nan, "x is nan")]
)
def test_a_goal_that_is_no_pose_in_odom_is_refused_beforehand(frame: str, x: float, reason: str) -> None:
    goal = PoseStamped()
    goal.header.frame_id, goal.pose.position.x = frame, x
    refusal = cast(Action, object.__new__(WalkTo)).refusal(SimpleNamespace(goal=goal))
    assert refusal is not None and reason in refusal.message


def test_a_damped_robot_refuses_goals_with_the_reason_and_the_remedy(bench: Any) -> None:
    node = bench.add(ActionServerNode)
    bench.world.create_publisher(String, topics.MODE, LATCHED).publish(String(data="damp"))
    status = SupervisorStatus("g1", Mode.DAMP, 0, "", ("emergency stop",))
    StatusTopic(bench.world, topics.SUPERVISOR_STATUS, LATCHED).publish(status)
    robot = node._turns.robot
    bench.wait(lambda: robot.mode and robot._status)
    reason = "mode 'damp': emergency stop; next: poise mode reset_faults; poise mode stand"
    assert cast(Turn, Turn(node._turns, 0)).ended == reason
    follow = object.__new__(FollowJointTrajectory)
    follow._kind = interface("control_msgs", "action", "FollowJointTrajectory")
    assert follow.result(Outcome(False, reason)).error_code == follow._kind.Result.INVALID_GOAL


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("dance", "unknown command 'dance'; motions: wave, stand"),
        ("wav", "unknown command 'wav': did you mean 'wave'? motions: wave, stand"),
        ("wave", "busy"),
    ],
)
def test_a_refusal_lists_motions_alone(text: str, message: str) -> None:
    async def command(text: str) -> CommandReply:
        return CommandReply(False, "busy")

    robot: Any = SimpleNamespace(command=command, begin=list)
    action = MotionAction(robot, None, ("wave", "stand"))
    handle: Any = SimpleNamespace(request=SimpleNamespace(motion=text))
    assert asyncio.run(action.run(handle, cast(Turn, None))) == Outcome(False, message)


@pytest.mark.parametrize("text", ["stop", "walk forward", "Please stop.", "forward.", "go forward, please"])
def test_words_that_the_robot_would_walk_or_stop_on_are_no_motions(text: str) -> None:
    goal = cast(Action, object.__new__(MotionAction)).refusal(SimpleNamespace(motion=text))
    assert goal is not None and "is not a motion" in goal.message
    assert ("cancel the goal" if "stop" in text.lower() else "walk_to") in goal.message


@pytest.mark.parametrize(("cancelled", "code"), [(True, "SUCCESSFUL"), (False, "INVALID_GOAL")])
def test_no_trajectory_ends_with_a_tolerance_that_was_not_violated(
    monkeypatch: pytest.MonkeyPatch, cancelled: bool, code: str
) -> None:
    async def track(*_: object, **__: object) -> Outcome:
        return Outcome(False, "on its way", cancelled)

    monkeypatch.setattr("bridge.nodes.action_server.track_motion", track)
    follow = interface("control_msgs", "action", "FollowJointTrajectory")
    robot: Any = SimpleNamespace(begin=list, motions_begun=1)
    action = FollowJointTrajectory(robot, follow, cast(Any, None), lambda _: None)
    outcome = asyncio.run(action.run(SimpleNamespace(request=follow.Goal()), cast(Any, None)))
    result = action.result(outcome)
    assert result.error_code == getattr(follow.Result, code) and result.error_string == "on its way"
