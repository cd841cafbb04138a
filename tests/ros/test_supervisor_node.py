"""The supervisor's node beside a world of a few topics: what it publishes, and when it holds its tongue."""

import os
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist, TwistStamped
from msgspec.structs import replace
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, LaserScan
from std_msgs.msg import Bool, Empty, String
from std_srvs.srv import Trigger

from controllers.commands.command_signature import Signer, read_key, write_key
from controllers.nodes.supervisor import SupervisorNode
from models.nodes import topics
from models.nodes.messages import JointStateCodec, set_stamp
from models.nodes.odometry import OdometryCodec, velocity_to_twist
from models.nodes.perception import scan_to_message
from models.nodes.qos import COMMAND, EVENT, LATCHED, SENSOR
from models.robot_model import RobotModel
from models.scan import Scan
from models.status import ControlStatus, EstimatorStatus, GaitStatus, NodeStatus, RouteState, RouteStatus
from models.types import SolveStatus
from tests.ros.conftest import StatusTopic
from tests.support import standing

pytestmark = pytest.mark.ros


class World:
    """Drivers that say what they do, and ears for the mode."""

    def __init__(self, bench: Any) -> None:
        self.bench = bench
        self.modes: list[str] = []
        self.roll, self.tick, self.silent, self.lag = 0.0, 0, False, 0
        self.twist = np.zeros(6)
        node = bench.world
        node.create_subscription(String, topics.MODE, lambda message: self.modes.append(message.data), LATCHED)
        self._drivers = node.create_publisher(String, topics.DRIVER_STATE, LATCHED)
        self._clients: dict[str, Any] = {}

    def robot(self, g1: RobotModel) -> None:
        """Publish what an upright robot publishes, a hundred times a second; ``roll`` lays it down.

        ``silent`` leaves out all but the clock, as for one who has not found the other topics yet; ``lag`` [ns] makes
        their stamps old.
        """
        node, joints, odom = self.bench.world, JointStateCodec(g1), OdometryCodec()
        description = node.create_publisher(String, topics.ROBOT_DESCRIPTION, LATCHED)
        description.publish(String(data=g1.urdf.read_text(encoding="utf-8")))
        topic = node.create_publisher(JointState, topics.JOINT_STATES, SENSOR)
        odometry = node.create_publisher(Odometry, topics.ODOM, SENSOR)
        command = node.create_publisher(JointState, topics.POSTURE, SENSOR)
        clock = node.create_publisher(Clock, topics.CLOCK, SENSOR)
        q, zero = g1.standing_configuration(), np.zeros(g1.nj)

        def publish() -> None:
            self.tick += 1
            stamp = 10_000_000 * self.tick
            q[3:7] = np.sin(0.5 * self.roll), 0.0, 0.0, np.cos(0.5 * self.roll)
            time = Clock()
            set_stamp(time.clock, stamp)
            clock.publish(time)
            if self.silent:
                return
            odometry.publish(odom.encode(stamp - self.lag, replace(standing(g1, q=q), v=np.append(self.twist, zero))))
            for publisher in (topic, command):
                publisher.publish(joints.encode(stamp - self.lag, q[7:], zero, zero))

        self._timer = node.create_timer(0.01, publish)

    def drivers(self, state: str) -> None:
        """Publish a driver state."""
        self._drivers.publish(String(data=state))

    def call(self, service: str) -> tuple[bool, str]:
        """Call a Trigger service."""
        if service not in self._clients:
            self._clients[service] = self.bench.world.create_client(Trigger, service)
            self.bench.wait(self._clients[service].service_is_ready)
            self.bench.spin(0.2)
        future = self._clients[service].call_async(Trigger.Request())
        self.bench.wait(future.done)
        return future.result().success, future.result().message


@pytest.fixture
def world(bench: Any) -> World:
    return World(bench)


def test_no_mode_before_the_drivers_have_told_their_state(bench: Any, world: World) -> None:
    bench.add(SupervisorNode)
    bench.spin(0.8)
    assert world.modes == []
    world.drivers(topics.ACTIVE)
    bench.wait(lambda: world.modes)
    assert world.modes[0] == "stand"  # never off: the drivers would drop a robot that stands


def test_a_robot_that_has_fallen_is_not_armed(bench: Any, world: World, g1: RobotModel) -> None:
    world.robot(g1)
    world.drivers(topics.DAMPED)
    bench.add(SupervisorNode, lockstep=True, preflight_time=0.6)
    bench.wait(lambda: world.modes)
    assert world.call("reset_faults")[0]
    bench.wait(lambda: world.call("mode/stand")[0])
    bench.spin(0.05)  # the drivers still say 'damped': they are being armed
    assert world.modes[-1] == "stand"
    world.drivers(topics.ACTIVE)
    bench.spin(0.2)
    assert world.call("mode/damp")[0]
    world.drivers(topics.DAMPED)
    assert "have not been repeated" in world.call("mode/stand")[1]
    bench.wait(lambda: world.call("mode/stand")[0])  # upright, it may
    world.drivers(topics.ACTIVE)
    bench.wait(lambda: world.modes[-1] == "stand")
    world.roll = 1.5
    bench.wait(lambda: world.modes[-1] == "damp")
    world.drivers(topics.DAMPED)
    assert world.call("reset_faults")[0]

    def refused() -> bool:
        accepted, reason = world.call("mode/stand")
        assert not accepted
        return "base tilted by 1.50 rad" in reason

    bench.wait(refused)


def test_a_robot_that_falls_after_the_checks_is_not_armed(bench: Any, world: World, g1: RobotModel) -> None:
    world.robot(g1)
    world.drivers(topics.OFF)
    bench.add(SupervisorNode, lockstep=True, preflight_time=0.1)
    passed: list[str] = []
    bench.world.create_subscription(
        DiagnosticArray,
        "/diagnostics",
        lambda array: passed.extend(v.value for s in array.status for v in s.values if v.key == "preflight"),
        EVENT,
    )
    bench.wait(lambda: passed and passed[-1] == "passed")
    world.roll = 1.5
    bench.spin(0.05)  # less than a check takes
    accepted, reason = world.call("mode/stand")
    assert not accepted
    assert "base tilted by 1.50 rad" in reason


@pytest.mark.parametrize(
    ("status", "overruns", "culprit"),
    [
        ("optimal", 20, "overran its time budget in 20 ticks in a row"),
        ("damped", 0, "no usable torques"),
        ("splendid", 0, "no usable torques"),
    ],
)
def test_what_the_controller_reports_damps(
    bench: Any, world: World, g1: RobotModel, status: str, overruns: int, culprit: str
) -> None:
    world.robot(g1)
    world.drivers(topics.ACTIVE)
    node = bench.add(SupervisorNode, lockstep=True)
    reports = StatusTopic(bench.world, topics.CONTROL_STATUS)
    fine = ControlStatus(active=True, solve=SolveStatus.OPTIMAL, overruns=0, joint_fault="")
    bench.wait(lambda: world.modes and reports.get_subscription_count() == 1)
    reports.publish(replace(fine, overruns=19))
    bench.spin(0.3)
    reports.publish(replace(fine, active=False, solve=SolveStatus.DAMPED))  # of an idle controller
    bench.spin(0.3)
    assert world.modes == ["stand"]
    reports.publish(replace(fine, overruns=overruns), solve=status)
    bench.wait(lambda: world.modes[-1] == "damp")
    assert culprit in world.call("mode/stand")[1]
    assert node.counters[f"refused {topics.CONTROL_STATUS}"] == (status == "splendid")


def test_a_drop_out_that_goes_on_damps_and_one_that_ends_does_not(bench: Any, world: World, g1: RobotModel) -> None:
    world.robot(g1)
    world.drivers(topics.ACTIVE)
    node = bench.add(SupervisorNode, lockstep=True)
    reports = StatusTopic(bench.world, topics.ESTIMATOR_STATUS)
    bench.wait(lambda: world.modes and reports.get_subscription_count() == 1)
    reports.publish(EstimatorStatus(10_000_000 * world.tick + 10**9))  # it begins in a second: not yet a drop-out
    bench.spin(0.2)
    reports.publish(EstimatorStatus(None))
    bench.spin(0.3)
    assert world.modes == ["stand"]
    reports.publish(EstimatorStatus(10_000_000 * world.tick))
    bench.wait(lambda: world.modes[-1] == "damp")
    assert "no usable samples of the IMU" in world.call("mode/stand")[1]
    assert node.counters[f"refused {topics.ESTIMATOR_STATUS}"] == 0
    reports.publish(EstimatorStatus(None), coasting_since="a while ago")
    bench.wait(lambda: node.counters[f"refused {topics.ESTIMATOR_STATUS}"] == 1)


@pytest.mark.parametrize("heard", [True, False])
def test_a_standing_robot_is_adopted_however_late_its_topics_are_found(
    bench: Any, world: World, g1: RobotModel, heard: bool
) -> None:
    world.robot(g1)
    world.silent, world.tick = True, 6500  # it has stood for a minute
    world.drivers(topics.ACTIVE)
    node = bench.add(SupervisorNode, lockstep=True, adoption_time=1.0)
    bench.wait(lambda: world.modes)
    bench.spin(0.5)
    assert world.modes == ["stand"]
    world.silent = not heard
    if heard:
        bench.spin(1.0)
        assert world.modes == ["stand"]
    else:
        bench.wait(lambda: world.modes[-1] == "damp")
        assert "state estimate older than" in world.call("mode/stand")[1]
    assert node.active


SECOND = 10**9
"""[ns]."""


@pytest.mark.parametrize(
    ("lag", "silent", "mode"),
    [
        pytest.param(SECOND, False, "stand", id="as if this process lagged behind by a second"),
        pytest.param(SECOND, True, "damp", id="nobody goes on"),
        pytest.param(3600 * SECOND, False, "damp", id="stamps of another clock"),
    ],
)
def test_stamps_that_arrive_late_but_go_on_are_of_somebody_alive(
    bench: Any, world: World, g1: RobotModel, lag: int, silent: bool, mode: str
) -> None:
    world.robot(g1)
    world.drivers(topics.ACTIVE)
    node = bench.add(SupervisorNode, lockstep=True)
    bench.wait(lambda: world.modes and node._reports.complete)
    bench.spin(0.2)
    world.tick += max(200, lag // 10_000_000)
    world.lag, world.silent = lag, silent
    bench.spin(0.5)
    assert world.modes[-1] == mode


def test_a_clock_that_is_read_before_the_rest_after_a_stall_damps_nothing(
    bench: Any, world: World, g1: RobotModel
) -> None:
    world.robot(g1)
    world.drivers(topics.ACTIVE)
    node = bench.add(SupervisorNode, lockstep=True)
    bench.wait(lambda: world.modes and node._reports.complete)
    bench.spin(0.2)
    world.tick, world.silent = world.tick + 15, True  # more than the 0.1 s that damp
    bench.spin(0.03)
    world.silent = False
    bench.spin(0.3)
    assert world.modes == ["stand"]


def test_a_stall_of_the_supervisor_is_no_silent_clock(bench: Any, world: World, g1: RobotModel) -> None:
    world.robot(g1)
    world.drivers(topics.ACTIVE)
    node = bench.add(SupervisorNode, clock_timeout=0.1)
    bench.wait(lambda: world.modes and node._reports.complete)
    for _ in range(3):
        time.sleep(0.3)
        node._update()  # before the messages that arrived meanwhile
        bench.spin(0.1)
    assert world.modes == ["stand"]
    world._timer.cancel()
    bench.wait(lambda: world.modes[-1] == "damp")
    assert "no /clock for 0.1 s" in world.call("mode/stand")[1]


def test_damped_drivers_are_adopted_with_a_latched_fault(bench: Any, world: World) -> None:
    world.drivers(topics.DAMPED)
    bench.add(SupervisorNode)
    bench.wait(lambda: world.modes)
    assert world.modes == ["damp"]
    accepted, reason = world.call("mode/stand")
    assert not accepted
    assert "the drivers were damped when the supervisor started" in reason
    assert world.call("reset_faults")[0]


def test_it_walks_only_with_a_gait_planner_and_stands_once_that_says_so(
    bench: Any, world: World, g1: RobotModel
) -> None:
    world.robot(g1)
    world.drivers(topics.ACTIVE)
    bench.add(SupervisorNode, lockstep=True, look_ahead=False)
    gait = StatusTopic(bench.world, topics.GAIT_STATUS, LATCHED)
    text = bench.world.create_publisher(String, topics.HUMANOID_COMMANDS, EVENT)
    asked: list[tuple[float, float, float]] = []

    def hear(message: Twist) -> None:
        asked.append((message.linear.x, message.linear.y, message.angular.z))

    bench.world.create_subscription(Twist, topics.GAIT_VELOCITY, hear, EVENT)
    bench.wait(lambda: world.modes and gait.get_subscription_count() == 1 and text.get_subscription_count() == 1)
    bench.spin(0.2)
    accepted, reason = world.call("mode/walk")
    assert not accepted
    assert "no gait planner" in reason
    gait.publish(GaitStatus(ready=True, settled=True))
    bench.spin(0.1)
    text.publish(String(data="left"))
    bench.wait(lambda: len(asked) > 5)  # it is repeated
    assert world.modes[-1] == "walk"
    assert set(asked) == {(0.0, 0.15, 0.0)}
    halted: list[Empty] = []
    bench.world.create_subscription(Empty, topics.GAIT_STOP, halted.append, EVENT)
    bench.spin(0.2)
    accepted, _ = world.call("mode/stand")  # before the planner has said anything about this walk
    assert accepted
    bench.wait(lambda: halted)
    asked.clear()
    bench.wait(lambda: asked)
    assert set(asked) == {(0.0, 0.0, 0.0)}
    gait.publish(GaitStatus(ready=True, settled=False))
    bench.spin(0.1)
    assert world.modes[-1] == "walk"
    gait.publish(GaitStatus(ready=True, settled=True))
    bench.wait(lambda: world.modes[-1] == "stand")
    asked.clear()
    gait.publish(GaitStatus(ready=False, settled=True))
    bench.spin(0.1)
    assert "no gait planner" in world.call("mode/walk")[1]
    assert asked == []  # nothing to say to a gait that stands


class Sources:
    """A walking robot, and those who command it."""

    def __init__(self, bench: Any, world: World, g1: RobotModel, **parameters: object) -> None:
        self.bench, self.world, self.commanders = bench, world, [""]
        self.asked: list[tuple[float, float, float]] = []
        world.robot(g1)
        world.tick = 1000
        world.drivers(topics.ACTIVE)
        self.node = bench.add(SupervisorNode, lockstep=True, **parameters)
        node = bench.world
        self.gait = gait = StatusTopic(node, topics.GAIT_STATUS, LATCHED)
        gait.publish(GaitStatus(ready=True, settled=True))
        node.create_subscription(String, topics.COMMANDER, lambda m: self.commanders.append(m.data), LATCHED)
        node.create_subscription(
            Twist, topics.GAIT_VELOCITY, lambda m: self.asked.append((m.linear.x, m.linear.y, m.angular.z)), COMMAND
        )
        word, velocity = topics.source_topics("teleop")
        autonomy = topics.source_topics("autonomy")[0]
        self.plain, self.teleop = (node.create_publisher(Twist, name, COMMAND) for name in (topics.CMD_VEL, velocity))
        self.stamped = node.create_publisher(TwistStamped, topics.CMD_VEL_STAMPED, COMMAND)
        self.word, self.autonomy = (node.create_publisher(String, name, EVENT) for name in (word, autonomy))
        self.lock = node.create_publisher(Bool, f"{topics.LOCKS}/pause", EVENT)
        bench.wait(lambda: world.modes)
        for publisher in (gait, self.plain, self.teleop, self.stamped, self.word, self.autonomy, self.lock):
            bench.wait(lambda publisher=publisher: publisher.get_subscription_count() >= 1)
        bench.spin(0.2)

    @property
    def refusal(self) -> str:
        return str(self.node.values.get("last refusal", ""))

    def until(self, velocity: tuple[float, float, float], *sends: tuple[Any, tuple[float, float, float]]) -> None:
        """Have sources repeat their velocities until the gait is told one."""
        self.asked.clear()

        def told() -> bool:
            for publisher, value in sends:
                publisher.publish(velocity_to_twist(value))
            self.bench.spin(0.05)
            return bool(self.asked) and self.asked[-1] == velocity

        self.bench.wait(told)


@pytest.fixture
def sources(bench: Any, world: World, g1: RobotModel) -> Sources:
    return Sources(bench, world, g1, look_ahead=False)


def test_the_source_of_the_highest_priority_is_in_command(bench: Any, sources: Sources) -> None:
    ahead, left = (0.3, 0.0, 0.0), (0.0, 0.1, 0.0)
    assert sources.world.call("mode/walk")[0]
    bench.wait(lambda: sources.asked)
    assert sources.asked[-1] == (0.0, 0.0, 0.0)  # published even when no source is in command
    sources.until(ahead, (sources.plain, ahead))
    sources.until(left, (sources.plain, ahead), (sources.teleop, left))
    assert sources.commanders[-2:] == ["plain", "teleop"]
    sources.autonomy.publish(String(data="wave"))
    bench.wait(lambda: "'autonomy' is not in command: 'teleop' is" in sources.refusal)
    sources.until(ahead, (sources.plain, ahead))  # teleop has fallen silent
    sources.until((0.0, 0.0, 0.0))
    sources.word.publish(String(data="forward"))
    sources.until(ahead)
    sources.lock.publish(Bool(data=True))
    sources.until((0.0, 0.0, 0.0))
    sources.lock.publish(Bool(data=False))
    sources.autonomy.publish(String(data="stop"))  # everybody may
    bench.wait(lambda: sources.node._law.still)
    sources.until((0.0, 0.0, 0.0))
    assert sources.world.modes[-1] == "walk"


def test_a_velocity_begins_a_walk_that_ends_in_a_stand(bench: Any, sources: Sources) -> None:
    ahead = (0.3, 0.0, 0.0)
    sources.until(ahead, (sources.plain, ahead))
    assert sources.world.modes[-1] == "walk"
    sources.gait.publish(GaitStatus(ready=True, settled=False))
    sources.until((0.0, 0.0, 0.0))  # silent
    bench.spin(0.2)
    assert sources.world.modes[-1] == "walk"
    sources.gait.publish(GaitStatus(ready=True, settled=True))
    bench.wait(lambda: sources.world.modes[-1] == "stand")
    assert sources.node._commands.values()["in command"] == "none"


def test_text_command_is_another_name_of_humanoid_commands(bench: Any, sources: Sources) -> None:
    words = bench.world.create_publisher(String, "text_command", EVENT)
    bench.wait(lambda: words.get_subscription_count() == 1)
    bench.spin(0.2)
    words.publish(String(data="Please go forward."))
    bench.wait(lambda: sources.world.modes[-1] == "walk")


def test_a_second_publisher_and_a_planner_that_falls_silent_are_noticed(
    bench: Any, world: World, g1: RobotModel
) -> None:
    world.robot(g1)
    world.drivers(topics.ACTIVE)
    node = bench.add(SupervisorNode, lockstep=True, heartbeat_timeout=0.4)
    reports = StatusTopic(bench.world, topics.NODE_STATUS)
    bench.wait(lambda: world.modes and reports.get_subscription_count() == 1)
    bench.spin(0.3)
    assert node._law.holds == ()  # a planner that has never been heard of is not missed
    reports.publish(NodeStatus("motion_planner"))
    bench.spin(0.2)
    assert node._law.holds == ()
    bench.wait(lambda: node._law.holds == ("node 'motion_planner' gives no sign of life",))
    reports.publish(NodeStatus("motion_planner"))
    bench.wait(lambda: node._law.holds == ())
    second = bench.world.create_publisher(JointState, topics.JOINT_STATES, SENSOR)
    bench.wait(lambda: node._law.faults)
    (fault,) = node._law.faults
    assert fault.startswith(f"'/joint_states' has a second publisher: node '/world', process {os.getpid()}; end it")
    assert "reset_faults" in fault
    bench.world.destroy_publisher(second)
    bench.wait(lambda: not node._law.faults)  # the robot stands, and the cause has gone
    second = bench.world.create_publisher(JointState, topics.JOINT_STATES, SENSOR)
    bench.wait(lambda: node._law.faults)
    assert world.modes == ["stand"]
    assert world.call("mode/damp")[0]
    assert world.call("reset_faults")[0]
    bench.wait(lambda: "'/joint_states' has a second publisher" in world.call("mode/stand")[1])
    bench.world.destroy_publisher(second)
    bench.wait(lambda: "second publisher" not in world.call("mode/stand")[1])


def test_a_robot_put_back_while_it_is_held_stands_up_anew(bench: Any, world: World, g1: RobotModel) -> None:
    """Else the supervisor takes it for standing and the drivers wait for a mode, for ever."""
    world.robot(g1)
    world.drivers(topics.HELD)
    bench.add(SupervisorNode, lockstep=True, preflight_time=0.2)
    bench.wait(lambda: world.modes[-1:] == ["stand"])
    del world.modes[:]
    world.drivers(topics.HELD)
    bench.wait(lambda: world.modes == ["off", "stand"])


def test_a_second_clock_is_told_and_its_times_are_not_believed(bench: Any, world: World, g1: RobotModel) -> None:
    world.robot(g1)
    world.drivers(topics.ACTIVE)
    node = bench.add(SupervisorNode, lockstep=True)
    bench.wait(lambda: world.modes and node._reports.complete)
    second = bench.world.create_publisher(Clock, topics.CLOCK, SENSOR)
    bench.wait(lambda: second.get_subscription_count() == 1)
    for sec, why in ((3600, "jumps ahead"), (0, "is before")):
        time = Clock()
        time.clock.sec = sec
        bench.wait(lambda time=time, why=why: second.publish(time) or why in node.values.get("last refusal", ""))
        assert 0.0 < node._reports.t < 3600.0
    bench.wait(lambda: len(node._law.faults) == 1 and "'/clock' has a second publisher" in node._law.faults[0])
    assert world.modes == ["stand"]
    bench.world.destroy_publisher(second)


def test_stamped_velocities_are_of_now_and_of_the_base(bench: Any, sources: Sources) -> None:
    assert sources.world.call("mode/walk")[0]

    def send(ms: int, frame_id: str = "base_link") -> None:
        message = TwistStamped(twist=velocity_to_twist((0.0, 0.1, 0.0)))
        set_stamp(message.header.stamp, 10_000_000 * sources.world.tick + ms * 1_000_000)
        message.header.frame_id = frame_id
        sources.stamped.publish(message)

    for ms, frame_id, culprit in (
        (-700, "base_link", "s old"),
        (10**9, "base_link", "s ahead"),
        (0, "odom", "header.frame_id: 'odom'"),
    ):
        send(ms, frame_id)
        bench.wait(lambda culprit=culprit: culprit in sources.refusal)
    bench.spin(0.1)
    assert set(sources.asked) == {(0.0, 0.0, 0.0)}
    send(0)
    bench.wait(lambda: sources.asked[-1] == (0.0, 0.1, 0.0))
    send(-200)
    bench.wait(lambda: "is not after" in sources.refusal)
    bench.wait(lambda: sources.asked[-1] == (0.0, 0.0, 0.0))


def test_an_obstacle_ends_the_way_ahead_and_a_walk_to_a_goal(bench: Any, world: World, g1: RobotModel) -> None:
    sources = Sources(bench, world, g1)
    ahead, back = (0.3, 0.0, 0.0), (-0.2, 0.0, 0.0)
    scans = bench.world.create_publisher(LaserScan, topics.SCAN, SENSOR)
    route = StatusTopic(bench.world, topics.ROUTE_STATUS)
    halted: list[Empty] = []
    bench.world.create_subscription(Empty, topics.GAIT_STOP, halted.append, EVENT)
    bench.wait(lambda: scans.get_subscription_count() == 1 and route.get_subscription_count() == 1)
    ranges = np.full(181, np.inf)

    def scan() -> None:
        seen = Scan(0.01 * world.tick, -0.5 * np.pi, np.pi / 180.0, ranges, 0.05, 10.0)
        scans.publish(scan_to_message(10_000_000 * world.tick, seen, 0.05))

    assert world.call("mode/walk")[0]
    sources.until((0.0, 0.0, 0.0), (sources.plain, ahead))  # without a scan it does not walk
    timer = bench.world.create_timer(0.05, scan)
    sources.until(ahead, (sources.plain, ahead))
    ranges[85:96] = 0.5
    sources.until((0.0, 0.0, 0.0), (sources.plain, ahead))
    assert "obstacle" in sources.node._commands.values()["obstacles"]
    sources.until(back, (sources.plain, back))
    halted.clear()
    world.twist[0] = 0.3
    route.publish(RouteStatus(RouteState.RUNNING, 9))
    bench.wait(lambda: halted)
    bench.world.destroy_timer(timer)


def test_with_a_key_words_are_signed_and_all_but_stop_is_refused_without(
    bench: Any, world: World, g1: RobotModel, tmp_path: Path
) -> None:
    write_key(tmp_path / "key")
    signer = Signer(read_key(tmp_path / "key"), "teleop")
    sources = Sources(bench, world, g1, look_ahead=False, command_key=str(tmp_path / "key"), command_window=0.2)
    bench.spin(0.3)  # what was signed before it started may be a replay
    sources.word.publish(String(data="walk"))
    bench.wait(lambda: "unsigned" in sources.refusal)
    line = signer.sign("walk")
    sources.word.publish(String(data=line))
    bench.wait(lambda: world.modes[-1] == "walk")
    sources.word.publish(String(data=line))
    bench.wait(lambda: "replayed" in sources.refusal)
    sources.plain.publish(velocity_to_twist((0.3, 0.0, 0.0)))
    bench.wait(lambda: "signed word 'velocity FORWARD LEFT TURN'" in sources.refusal)
    sources.word.publish(String(data=signer.sign("velocity 0.2 nan 0")))
    bench.wait(lambda: "is not finite" in sources.refusal)
    sources.word.publish(String(data=signer.sign("velocity 0.2 0.0 0.1")))
    sources.until((0.2, 0.0, 0.1))
    assert sources.commanders[-1] == "teleop"
    sources.autonomy.publish(String(data="stop"))
    bench.wait(lambda: sources.node._law.still)
