"""The command line's client and the demonstration's observer, against a graph of a few fake topics."""

import fcntl
import math
import os
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import PoseStamped, Twist, WrenchStamped
from msgspec.structs import replace
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Header, String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectoryPoint

from bridge.launch.graph import Graph
from bridge.launch.robot_network import RobotNetwork
from bridge.record.observer import Observer
from bridge.ros import client as client_module
from bridge.ros import walk
from bridge.ros.client import Client, next_step, overview
from bridge.ros.environment import claim_graph, graphs_elsewhere, join_graph
from bridge.ros.processes import ProcessSpec
from controllers.commands.command_signature import Signer, Verifier
from models.errors import CommandError, PoiseError
from models.nodes import topics
from models.nodes.interfaces import interface
from models.nodes.messages import JointStateCodec, WrenchCodec
from models.nodes.odometry import OdometryCodec
from models.nodes.qos import COMMAND, EVENT, LATCHED, SENSOR, STATE
from models.nodes.services import PACKAGE
from models.robot_model import SOLE_FRAMES, RobotModel
from models.status import (
    GaitStatus,
    MotionState,
    MotionStatus,
    RouteState,
    RouteStatus,
    StartStatus,
    SupervisorStatus,
)
from models.types import Mode
from tests.ros.conftest import StatusTopic
from tests.support import standing

pytestmark = pytest.mark.ros


class FakeSupervisor(Node):
    """Waves on command, refuses the rest, and reports that."""

    def __init__(self, context: Context) -> None:
        super().__init__("supervisor", context=context)
        self.refused = self.answered = 0
        self.texts: list[str] = []
        self.create_subscription(String, topics.HUMANOID_COMMANDS, self.on_text, EVENT)
        self.states = StatusTopic(self, topics.MOTION_STATUS)
        self.status = StatusTopic(self, topics.SUPERVISOR_STATUS, LATCHED)
        self.gait = StatusTopic(self, topics.GAIT_STATUS, LATCHED)
        self.mode = self.create_publisher(String, topics.MODE, LATCHED)
        self.mode.publish(String(data="stand"))
        self.create_service(Trigger, "mode/damp", self.on_damp)
        for mode in ("walk", "stand"):
            self.create_service(Trigger, f"mode/{mode}", partial(self.on_mode, mode))
        self.create_subscription(Twist, topics.CMD_VEL, lambda message: None, COMMAND)
        self.odometry, self.speed, self.silent = self.create_publisher(Odometry, topics.ODOM, STATE), 1.0, False
        self.velocity, self.asked = self.create_publisher(Twist, topics.GAIT_VELOCITY, COMMAND), Twist()
        self.commander = self.create_publisher(String, topics.COMMANDER, LATCHED)
        self.factor = self.create_publisher(Float64, topics.REAL_TIME_FACTOR, LATCHED)
        self.record = SupervisorStatus("g1", Mode.STAND, 0, "a velocity of another program", (), holds=("held",))
        self.create_timer(0.05, self.report)

    def on_text(self, message: String) -> None:
        self.texts.append(message.data)
        self.answered += 1
        if message.data == "wave":
            self.states.publish(MotionStatus(MotionState.RUNNING))
        elif message.data == "fly":
            self.refused += 1
        elif message.data == "stop":
            self.states.publish(MotionStatus(MotionState.ENDED, "", "stopped"))
        elif message.data.startswith("forward"):
            self.mode.publish(String(data="walk"))
            self.gait.publish(GaitStatus(True, False, "forward 9 limited to 1.2" if "9" in message.data else ""))

    def on_damp(self, request: Any, response: Any) -> Any:
        response.success, response.message = False, "the robot would drop"
        return response

    def on_mode(self, mode: str, request: Any, response: Any) -> Any:
        self.mode.publish(String(data=mode))
        response.success, response.message = True, mode
        return response

    def report(self) -> None:
        stamp = Time(nanoseconds=int(self.speed * self.get_clock().now().nanoseconds))
        if not self.silent:
            self.odometry.publish(Odometry(header=Header(stamp=stamp.to_msg())))
        self.velocity.publish(self.asked)
        answer = "unknown command 'fly'" if self.texts[-1:] == ["fly"] else f"done: {self.texts[-1:]}"
        self.status.publish(replace(self.record, refused=self.refused, answered=self.answered, answer=answer))


@pytest.fixture
def context(ros_domain_id: int) -> Iterator[Context]:
    join_graph()
    context = Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    yield context
    context.try_shutdown()


@pytest.fixture
def supervisor(context: Context) -> Iterator[FakeSupervisor]:
    executor = SingleThreadedExecutor(context=context)
    node = FakeSupervisor(context)
    executor.add_node(node)
    stop = threading.Event()

    def serve() -> None:
        while not stop.is_set():
            executor.spin_once(timeout_sec=0.02)

    thread = threading.Thread(target=serve)
    thread.start()
    yield node
    stop.set()
    thread.join()
    executor.remove_node(node)
    node.destroy_node()


def test_commands_are_answered(supervisor: FakeSupervisor) -> None:
    with Client() as client:
        assert client.command("wave").accepted
        reply = client.command("fly")
        assert not reply.accepted and reply.reason == "unknown command 'fly'"
        assert client.mode == "stand"
        assert client.command("forward").reason == "done: ['forward']"  # without a wait for a motion
        assert client.command("forward 9").reason == "done: ['forward 9']; forward 9 limited to 1.2"
        assert client.command("stop").reason == "done: ['stop']"
        reply = client.trigger("mode/damp")
        assert not reply.accepted and reply.reason == "the robot would drop"
    with Client() as client:  # it opens again
        assert client.command("wave").accepted


def test_the_overview_names_the_next_step(supervisor: FakeSupervisor) -> None:
    with Client() as client:
        found = overview(client)
    assert found["robot"].startswith("g1, mode 'stand'") and found["faults"] == "held"
    record = SupervisorStatus("g1", Mode.STAND, 0, "", ())
    for changes, word in (
        ({}, "poise walk"),
        ({"mode": Mode.WALK}, "poise send stop"),
        ({"faults": ("why",)}, "reset_faults"),
        ({"mode": Mode.DAMP, "fallen": True, "faults": ("fallen",)}, "poise reset"),
        ({"mode": Mode.DAMP, "faults": ("why",)}, "reset_faults; poise mode stand"),
        ({"mode": Mode.OFF, "preflight": ("no joint states",)}, "no joint states"),
        ({"mode": Mode.OFF}, "poise mode stand"),
        ({"locks": ("pause",)}, "'pause': publish false on locks/pause"),
    ):
        assert word in next_step(replace(record, **changes))
    assert "no walk before this is over: 91 degC" in next_step(record, StartStatus("stand", holds=("91 degC",)))


def test_a_walk_that_is_held_is_reported(supervisor: FakeSupervisor) -> None:
    with Client() as client:
        client.robot()
        reply = walk.walk(client, (0.2, 0.0, 0.0), 5.0)
    assert not reply.accepted and reply.reason.startswith("the walk was held after 0.0 s: held; mode 'stand'")


@pytest.mark.parametrize(
    ("commander", "changes", "reason"),
    [
        ("plain", {}, ""),
        ("teleop", {}, "'teleop' is in command"),
        ("none", {"locks": ("pause",)}, "commands are locked out by 'pause': publish false on locks/pause"),
        ("plain", {"obstacle": "stopped: no scan"}, "stopped: no scan"),
        ("none", {"refusal": "cmd_vel: stopped"}, "the supervisor refused cmd_vel: stopped; end other, which"),
        ("none", {"refusal": "scan: of old"}, "end other, which publishes on /cmd_vel, too"),
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


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_a_goal_that_is_not_finite_is_refused_before_anything_moves(supervisor: FakeSupervisor, bad: float) -> None:
    with Client() as client:
        with pytest.raises(CommandError, match=r"goal .*heading .* must be finite"):
            walk.walk_to(client, (1.0, 0.0, bad))
        client.robot()
        assert client.mode == "stand"


def test_the_obstacle_that_ended_a_goal_is_named(supervisor: FakeSupervisor) -> None:
    supervisor.record = replace(supervisor.record, holds=(), obstacle="stopped: obstacle 0.42 m ahead")
    routes = StatusTopic(supervisor, topics.ROUTE_STATUS)
    ended = RouteStatus(RouteState.ENDED, 3, "stopped")
    supervisor.create_subscription(PoseStamped, topics.GOAL_POSE, lambda goal: routes.publish(ended), EVENT)
    margin = supervisor.create_publisher(Float64, topics.GAIT_CAPTURE_MARGIN, SENSOR)
    supervisor.create_timer(0.05, lambda: margin.publish(Float64()))
    with Client() as client:
        reply = walk.walk_to(client, (1.0, 0.0, 0.0))
    assert not reply.accepted and "goal ended: stopped; stopped: obstacle 0.42 m ahead" in reply.reason


def test_the_overview_waits_for_the_limit_of_a_walk(supervisor: FakeSupervisor) -> None:
    supervisor.mode.publish(String(data="walk"))
    supervisor.commander.publish(String(data="plain"))
    supervisor.factor.publish(Float64(data=1.0))
    StatusTopic(supervisor, topics.START_STATUS, LATCHED).publish(StartStatus("standing"))
    late = threading.Timer(0.5, lambda: supervisor.gait.publish(GaitStatus(True, False, "stopped: a kerb")))
    late.start()
    with Client() as client:
        client.wait(lambda: bool(client.commander and not math.isnan(client.factor)), 10.0)
        client.driver_state = "active"
        assert overview(client)["walk"] == "stopped: a kerb"
    late.join()


def test_a_pause_is_named(supervisor: FakeSupervisor, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(walk, "SILENCE", 1.0)
    paused = "time stands still: poise reset, or ros2 service call /pause"
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


def test_a_client_with_a_key_signs(supervisor: FakeSupervisor) -> None:
    key = bytes(range(32))
    began = [time.time_ns() - 100_000_000_000]
    verifier = Verifier(key, 30.0, lambda: began.pop() if began else time.time_ns())
    with Client(signer=Signer(key, "teleop")) as client:
        client.command("wave")
    command = verifier.verify(supervisor.texts[-1])
    assert (command.source, command.text) == ("teleop", "wave")


def test_every_subscriber_receives_a_command(supervisor: FakeSupervisor, monkeypatch: pytest.MonkeyPatch) -> None:
    """A node of the user subscribes beside the supervisor, and may be discovered later."""
    monkeypatch.setattr(client_module, "DISCOVERY", 3.0)  # on a busy machine
    code = (
        "import rclpy; from std_msgs.msg import String; rclpy.init(); node = rclpy.create_node('student');"
        "node.create_subscription(String, 'humanoid_commands', lambda m: print(m.data, flush=True), 10);"
        "rclpy.spin(node)"
    )
    student = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    try:
        end = time.monotonic() + 20.0
        while supervisor.count_subscribers(topics.HUMANOID_COMMANDS) < 2:
            assert time.monotonic() < end
            time.sleep(0.05)
        for k in range(3):
            with Client() as client:
                client.send(f"word {k}")
                client.spin(0.5)
    finally:
        student.kill()
        words, _ = student.communicate()
    assert words.split("\n") == ["word 0", "word 1", "word 2", ""]


NAME = """
from bridge.ros.client import Client
with Client() as client:
    print(client.node.get_name())
"""


def test_commands_at_the_same_time_have_nodes_of_different_names(context: Context) -> None:
    with Client() as client:
        other = subprocess.run([sys.executable, "-c", NAME], capture_output=True, text=True, timeout=60, check=True)
        assert other.stdout.startswith("poise_client_") and other.stdout.strip() != client.node.get_name()


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


def test_a_robot_that_is_starting_is_no_reason_to_start_one(context: Context, ros_domain_id: int) -> None:
    with Client(namespace="robot_1") as client:
        starting = rf"poise up \(g1, process {os.getpid()}\) is starting, or does not answer; in need use the robot's"
        with claim_graph("g1", None, "/robot_1"), pytest.raises(CommandError, match=starting):
            client.robot(timeout=0.3)
        with pytest.raises(CommandError, match="start it with: poise up"):
            client.robot(timeout=0.3)


def test_a_graph_in_another_domain_is_named(
    context: Context, ros_domain_id: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))  # without the graphs of others
    other = ros_domain_id + 150  # which no test claims
    with Client(namespace="robot_1") as client, claim_graph("g1_hardware", other, ""):
        named = rf"ROS domain {ros_domain_id}, namespace /robot_1, but in ROS domain {other} \(g1_hardware, process "
        remedy = rf"{os.getpid()}\): export ROS_DOMAIN_ID={other} and leave --namespace out; if none is up"
        with pytest.raises(CommandError, match=named + remedy):
            client.robot(timeout=0.3)
        with claim_graph("g1", None, "/lab/robot_2"):
            here = (
                rf"in ROS domain {ros_domain_id}, namespace /lab/robot_2 \(g1, .*\): give --namespace /lab/robot_2(;|$)"
            )
            assert re.search(here, graphs_elsewhere("/robot_1")) and not graphs_elsewhere("/lab/robot_2")
        with claim_graph("g1", None, "/robot_1"):
            assert not graphs_elsewhere("/robot_1")


@pytest.mark.parametrize("text", ["robot", "-1", "233"])
def test_what_is_no_ros_domain_is_refused_by_name(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", text)
    for use in (lambda: claim_graph("g1", None, ""), RobotNetwork("lo").check, Client().__enter__):
        with pytest.raises(PoiseError, match=f"ROS_DOMAIN_ID: '{text}' is not a ROS domain, 0 to 232; export"):
            use()


def test_a_command_that_looks_for_graphs_does_not_prevent_one(
    ros_domain_id: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    claim_graph("g1", None, "").close()
    file = Path(tempfile.gettempdir()) / f"poise-graph-{ros_domain_id}-{os.getuid()}.lock"
    with file.open() as looking:
        fcntl.flock(looking, fcntl.LOCK_SH)
        monkeypatch.setattr(time, "sleep", lambda _: looking.close())
        claim_graph("g1", None, "").close()


def test_a_request_at_once_is_answered(supervisor: FakeSupervisor) -> None:
    with Client() as client:
        assert client.trigger("mode/damp", at_once=True).reason == "the robot would drop"


def test_enter_takes_a_step_in_a_client_that_has_joined_before(supervisor: FakeSupervisor) -> None:
    supervisor.create_service(Trigger, "start/damp", supervisor.on_damp)
    program = [sys.executable, "-c", "from bridge.cli import app; app()", "start", "damp", "--on-enter"]
    process = subprocess.Popen(program, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdin is not None and process.stdout is not None
    try:
        assert process.stdout.readline().startswith("g1, Enter: damp")
        for _ in range(2):
            process.stdin.write("\n")
            process.stdin.flush()
            began = time.monotonic()
            assert process.stdout.readline() == "the robot would drop\n"
            print(f"answered after {1e3 * (time.monotonic() - began):.0f} ms")
        process.stdin.close()
        assert process.wait(20.0) == 0
    finally:
        process.kill()
        process.wait()


def test_the_launcher_reports_why_a_command_was_refused(supervisor: FakeSupervisor, tmp_path: Path) -> None:
    specs = [ProcessSpec("this", (), True)]
    graph = Graph("g1", specs=specs, activation=["none"], log=tmp_path / "log", say=lambda text: None)
    graph.open()
    try:
        graph.wait_for(lambda: graph.mode == "stand", 10.0, "standing")
        graph.spin(0.5)  # until each has discovered the other
        for text, reason in (("fly", "unknown command 'fly'"), ("wave", "")):
            graph.send(text)
            graph.wait_for(lambda text=text: supervisor.texts[-1:] == [text], 10.0, "received")  # type: ignore[misc]
            graph.spin(0.5)
            assert graph.refusal == reason
    finally:
        graph.close()


def test_enter_needs_no_supervisor(context: Context) -> None:
    node = Node("robot_driver", context=context)
    node.create_service(Trigger, "start/damp", lambda request, response: response)
    program = [sys.executable, "-c", "from bridge.cli import app; app()", "start", "damp", "--on-enter"]
    done = subprocess.run(program, input="", capture_output=True, text=True, timeout=60.0)
    assert done.stdout.startswith("robot without supervisor, Enter: damp"), done.stderr
    node.destroy_node()


def test_robots_in_other_namespaces_are_named(context: Context) -> None:
    node = Node("supervisor", context=context, namespace="robot_2")
    node.create_publisher(String, topics.SUPERVISOR_STATUS, LATCHED)
    with Client() as client, pytest.raises(CommandError, match="are up in /robot_2: give --namespace"):
        client.robot(timeout=1.0)
    with (
        Client(namespace="robot_1") as client,
        pytest.raises(CommandError, match=r"no service /robot_1/mode/stand .*/robot_2"),
    ):
        client.trigger("mode/stand", timeout=1.0)
    node.destroy_node()


def test_without_a_namespace_the_only_robot_is_named(context: Context) -> None:
    node = Node("supervisor", context=context)
    node.create_publisher(String, topics.SUPERVISOR_STATUS, LATCHED)
    with Client(namespace="robot_1") as client, pytest.raises(CommandError, match="are up in /: leave --namespace out"):
        client.robot(timeout=1.0)
    node.destroy_node()


def test_a_robot_that_is_up_lacks_a_service(supervisor: FakeSupervisor) -> None:
    with (
        Client() as client,
        pytest.raises(CommandError, match=r"no service none within 1 s: the robot is up: poise"),
    ):
        client.trigger("none", timeout=1.0)


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


def test_the_observer_joins_what_it_saw(context: Context, g1: RobotModel) -> None:
    node = Node("plant", context=context)
    odom = node.create_publisher(Odometry, topics.GROUND_TRUTH, SENSOR)
    joints = node.create_publisher(JointState, topics.JOINT_STATES, SENSOR)
    estimate = node.create_publisher(Odometry, topics.ODOM, SENSOR)
    feet = [node.create_publisher(WrenchStamped, topic, SENSOR) for topic in topics.FOOT_WRENCHES]
    odom_codec, joint_codec = OdometryCodec(), JointStateCodec(g1)
    foot_codecs = [WrenchCodec(frame) for frame in SOLE_FRAMES]
    observer = Observer(g1, context)
    with pytest.raises(PoiseError, match="ground_truth/odom, joint_states, foot/left/wrench, foot/right/wrench silent"):
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
    with pytest.raises(PoiseError, match="ground_truth/odom, joint_states silent"):
        observer.recording([])
    observer._rows[topics.GROUND_TRUTH] += [(k, np.zeros(13)) for k in range(3)]
    observer._rows[topics.JOINT_STATES] += [(k, np.zeros(3 * g1.nj)) for k in range(3)]
    recording = observer.recording([])
    observer.close()
    assert np.isnan(recording.wrenches).all() and recording.estimate is None
