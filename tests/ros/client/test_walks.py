"""Walks and reaching that the command line requests, and how they end."""

import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import PoseStamped, Twist
from msgspec.structs import replace
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.node import Node
from std_msgs.msg import Float64, String
from trajectory_msgs.msg import JointTrajectoryPoint

from bridge.ros import walk
from bridge.ros.client import Client, overview
from models.errors import CommandError, PoiseError
from models.nodes import topics
from models.nodes.interfaces import interface
from models.nodes.odometry import OdometryCodec
from models.nodes.qos import COMMAND, EVENT, LATCHED, SENSOR
from models.nodes.services import PACKAGE
from models.robot_model import RobotModel
from models.status import GaitStatus, MotionState, MotionStatus, RouteState, RouteStatus
from models.types import Mode
from tests.ros.client.fake_supervisor import FakeSupervisor
from tests.ros.conftest import StatusTopic
from tests.support import standing

pytestmark = pytest.mark.ros


def test_a_walk_that_is_held_is_reported(supervisor: FakeSupervisor) -> None:
    with Client() as client:
        client.robot()
        reply = walk.walk(client, (0.2, 0.0, 0.0), 5.0)
    assert not reply.accepted and reply.reason.startswith("the walk was held after 0.0 s: held; base at x ")


def test_the_fall_that_ended_a_walk_is_reported(supervisor: FakeSupervisor) -> None:
    supervisor.record = replace(supervisor.record, holds=())

    def fall() -> None:
        supervisor.mode.publish(String(data="damp"))
        supervisor.record = replace(supervisor.record, mode=Mode.DAMP, fallen=True, faults=("base tilted by 62 deg",))

    with Client() as client:
        client.robot()
        supervisor.create_timer(2.0, fall)
        reply = walk.walk(client, (0.2, 0.0, 0.0), 60.0)
    assert not reply.accepted and reply.reason.startswith("the walk was ended: base tilted by 62 deg; in simulation")
    assert "'poise reset'" in reply.reason and reply.reason.endswith("; mode 'damp'")


def test_another_program_that_ended_a_walk_is_no_fault(supervisor: FakeSupervisor) -> None:
    supervisor.record = replace(supervisor.record, holds=())
    with Client() as client:
        client.robot()
        supervisor.create_timer(2.0, lambda: supervisor.mode.publish(String(data="stand")))
        reply = walk.walk(client, (0.2, 0.0, 0.0), 60.0)
    assert (reply.accepted, reply.reason) == (False, "the walk was ended by another client; mode 'stand'")


@pytest.mark.parametrize(
    ("commander", "changes", "reason"),
    [
        ("plain", {}, ""),
        ("teleop", {}, "'teleop' is in command"),
        ("none", {"locks": ("pause",)}, "commands are locked out by 'pause': publish false on locks/pause"),
        ("plain", {"obstacle": "stopped: no scan"}, "stopped: no scan"),
        ("none", {"refusal": "cmd_vel: stopped"}, "the supervisor refused cmd_vel: stopped; end other, which"),
        ("none", {"refusal": "scan: of old"}, "end other, which also publishes on /cmd_vel"),
    ],
)
def test_a_walk_that_the_robot_does_not_follow_is_reported(
    context: Context, supervisor: FakeSupervisor, commander: str, changes: dict[str, Any], reason: str
) -> None:
    supervisor.record = replace(supervisor.record, holds=(), **changes)
    supervisor.asked.linear.x = 0.0 if reason else 0.2
    supervisor.commander.publish(String(data=commander))
    other = Node("other", context=context)
    other.create_publisher(Twist, topics.CMD_VEL, COMMAND)
    with Client() as client:
        client.wait(lambda: "locks" not in changes or bool(client.status and client.status.locks), 10.0)
        reply = walk.walk(client, (0.2, 0.0, 0.0), 0.5)
    assert reply.accepted is not bool(reason) and reason in reply.reason
    other.destroy_node()


@pytest.mark.long
def test_a_walk_that_the_ground_blocks_says_why_and_where(supervisor: FakeSupervisor) -> None:
    supervisor.record = replace(supervisor.record, holds=())
    supervisor.asked.linear.x = 0.2
    supervisor.commander.publish(String(data="plain"))
    supervisor.restraints = "forward 9 limited to 1.2", "stopped: a kerb"
    place = "base at x 0.00 m, y 0.00 m, heading 0.00 rad; mode 'stand'"
    with Client() as client:
        reply = walk.walk(client, (0.2, 0.0, 0.0), 0.5)
        assert (reply.accepted, reply.reason) == (
            False,
            f"stopped: a kerb (after 0.5 s); {place}",
        )
        free = supervisor.create_timer(
            1.0, lambda: supervisor.gait.publish(GaitStatus(True, False, "limited", "", "no map"))
        )
        reply = walk.walk(client, (0.2, 0.0, 0.0), 3.0)
        assert (reply.accepted, reply.reason) == (
            True,
            f"walked for 3 s; limited; stopped: a kerb on the way; no map; {place}",
        )
        free.cancel()


def test_an_interrupted_walk_ends_in_a_stand(supervisor: FakeSupervisor, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without it the robot continues to its goal."""

    def interrupt(*_: object) -> bool:
        raise KeyboardInterrupt

    supervisor.record = replace(supervisor.record, holds=())
    routes = StatusTopic(supervisor, topics.ROUTE_STATUS)
    status = RouteStatus(RouteState.RUNNING, 17)
    supervisor.create_subscription(PoseStamped, topics.GOAL_POSE, lambda _: routes.publish(status), EVENT)
    margin = supervisor.create_publisher(Float64, topics.GAIT_CAPTURE_MARGIN, SENSOR)
    supervisor.create_timer(0.05, lambda: margin.publish(Float64()))
    with Client() as client:
        monkeypatch.setattr(walk.RobotClock, "wait", interrupt)
        with pytest.raises(KeyboardInterrupt):
            walk.walk_to(client, (1.0, 0.0, 0.0))
        assert client.wait(lambda: client.mode == "stand", 5.0)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_a_goal_that_is_not_finite_is_refused_before_anything_moves(supervisor: FakeSupervisor, bad: float) -> None:
    with Client() as client:
        with pytest.raises(CommandError, match=r"goal .*heading .* must be finite"):
            walk.walk_to(client, (1.0, 0.0, bad))
        client.robot()
        assert client.mode == "stand"


def test_the_obstacle_that_ended_a_goal_is_named(supervisor: FakeSupervisor) -> None:
    """Also where the supervisor says so only after the end of the goal."""
    supervisor.record = replace(supervisor.record, holds=())
    routes = StatusTopic(supervisor, topics.ROUTE_STATUS)

    def end(_: PoseStamped) -> None:
        routes.publish(RouteStatus(RouteState.ENDED, 3, "stopped"))
        supervisor.record = replace(supervisor.record, obstacle="stopped: obstacle 0.42 m ahead")

    supervisor.create_subscription(PoseStamped, topics.GOAL_POSE, end, EVENT)
    margin = supervisor.create_publisher(Float64, topics.GAIT_CAPTURE_MARGIN, SENSOR)
    supervisor.create_timer(0.05, lambda: margin.publish(Float64()))
    with Client() as client:
        reply = walk.walk_to(client, (1.0, 0.0, 0.0))
    assert (
        not reply.accepted and "goal x 1.00 m, y 0.00 m: ended: stopped; stopped: obstacle 0.42 m ahead" in reply.reason
    )


def test_the_distance_from_the_goal_is_reported_on_the_way(
    supervisor: FakeSupervisor, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(walk, "REPORT_PERIOD", 0.0)
    supervisor.record = replace(supervisor.record, holds=())
    routes, reports = StatusTopic(supervisor, topics.ROUTE_STATUS), list[str]()

    def report(text: str) -> None:
        reports.append(text)
        routes.publish(RouteStatus(RouteState.DONE, 3))

    running = RouteStatus(RouteState.RUNNING, 3)
    supervisor.create_subscription(PoseStamped, topics.GOAL_POSE, lambda _: routes.publish(running), EVENT)
    margin = supervisor.create_publisher(Float64, topics.GAIT_CAPTURE_MARGIN, SENSOR)
    supervisor.create_timer(0.05, lambda: margin.publish(Float64()))
    with Client() as client:
        assert walk.walk_to(client, (0.3, 0.4, 0.0), report=report).accepted
    assert reports[0] == "0.50 m from the goal"


@pytest.mark.long
def test_a_pause_is_named(supervisor: FakeSupervisor, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(walk, "SILENCE", 1.0)
    paused = "time does not advance: poise reset, or ros2 service call /pause"
    supervisor.silent = True
    supervisor.factor.publish(Float64(data=0.0))
    with Client() as client:
        assert paused in overview(client)["next"]
        for move in (partial(walk.walk, seconds=1.0), walk.walk_to):
            with pytest.raises(CommandError, match=f"no message on odom.*{paused}"):
                move(client, (0.2, 0.0, 0.0))
        assert client.mode == "stand"
        with pytest.raises(CommandError, match=f"no service none.*{paused}"):
            client.trigger("none", timeout=0.3)
        StatusTopic(supervisor, topics.START_STATUS, LATCHED)
        client.wait(lambda: not client.paused, 10.0)  # a real robot has no pause
        assert not client.paused


@pytest.mark.parametrize(
    "end",
    [
        MotionStatus(MotionState.DONE),
        MotionStatus(MotionState.REFUSED, "", "too fast"),
        MotionStatus(MotionState.ENDED, "", "stopped"),
    ],
)
def test_a_reach_lasts_until_its_motion_ends(
    supervisor: FakeSupervisor, monkeypatch: pytest.MonkeyPatch, end: MotionStatus
) -> None:
    """The time is that of a slow simulation; the refusal of another motion does not count."""
    try:
        kind = interface(PACKAGE, "srv", "PlanMotion")
    except PoiseError as error:
        pytest.skip(str(error))
    monkeypatch.setattr(walk, "END_TIMEOUT", 0.1)
    supervisor.speed = 0.005

    def plan(request: Any, response: Any) -> Any:
        response.success, response.message = True, "planned"
        response.trajectory.points = [JointTrajectoryPoint()]
        supervisor.states.publish(MotionStatus(MotionState.REFUSED, "fly", "unknown"))
        supervisor.create_timer(0.5, lambda: supervisor.states.publish(end))
        return response

    supervisor.create_service(kind, topics.PLAN_MOTION, plan)
    with Client() as client:
        reply = walk.reach(client, "left_hand", (0.3, 0.2, 0.1), frame_id="base_link")
    assert (reply.accepted, reply.reason) == (end.state is MotionState.DONE, f"planned; {end}")


@pytest.mark.parametrize("reported", [True, False])  # a controller that died reports nothing
def test_a_reach_ends_when_the_robot_is_damped(supervisor: FakeSupervisor, reported: bool) -> None:
    try:
        kind = interface(PACKAGE, "srv", "PlanMotion")
    except PoiseError as error:
        pytest.skip(str(error))

    def damp() -> None:
        if reported:
            supervisor.states.publish(MotionStatus(MotionState.ENDED, "", "mode 'damp'"))
        supervisor.record = replace(supervisor.record, mode=Mode.DAMP, faults=("fallen",))
        supervisor.mode.publish(String(data="damp"))

    def plan(request: Any, response: Any) -> Any:
        response.success, response.message = True, "planned"
        response.trajectory.points = [JointTrajectoryPoint(time_from_start=Duration(sec=1000))]
        supervisor.create_timer(0.5, damp)
        return response

    supervisor.create_service(kind, topics.PLAN_MOTION, plan)
    with Client() as client:
        reply = walk.reach(client, "left_hand", (0.3, 0.2, 0.1), frame_id="base_link")
    assert (reply.accepted, reply.reason) == (False, "planned; ended: mode 'damp'; fallen")


def test_without_a_graph(context: Context, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(walk, "ANSWER_TIMEOUT", 0.3)
    with Client() as client:
        for move in (partial(walk.walk, seconds=1.0), walk.walk_to):
            with pytest.raises(CommandError, match=r"no publisher on odom.*start it with: poise up"):
                move(client, (0.2, 0.0, 0.0))
        with pytest.raises(CommandError, match=r"no subscriber on humanoid_commands.*start it with: poise up"):
            client.send("wave", timeout=0.3)
        with pytest.raises(CommandError, match="no service mode/stand"):
            client.trigger("mode/stand", timeout=0.3)


def test_a_walk_counts_the_time_of_the_robot(context: Context, monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulated time that waits for a busy machine must not cut a walk short; a robot that has gone ends the wait."""
    monkeypatch.setattr(walk, "SILENCE", 0.5)
    odom, codec = Node("plant", context=context).create_publisher(Odometry, topics.ODOM, SENSOR), OdometryCodec()
    robot, sent = standing(RobotModel.load("g1")), 0

    def send() -> bool:
        nonlocal sent
        sent += 1
        odom.publish(codec.encode(sent * 5_000_000, robot))
        return False

    with Client() as client:
        listening = threading.Thread(target=send_for_a_while, args=(send,))
        listening.start()
        clock = walk.RobotClock(client)
        listening.join()
        begin = sent
        assert not clock.wait(send, 0.5)
        assert sent - begin >= 90  # of 5 ms each
        with pytest.raises(CommandError, match="no message on odom for 0"):
            clock.wait(lambda: False, 0.5)


def send_for_a_while(send: Callable[[], bool]) -> None:
    """Send until a subscriber has had time to appear."""
    for _ in range(30):
        send()
        time.sleep(0.02)
