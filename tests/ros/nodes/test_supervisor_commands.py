"""Commands of every source, as the supervisor's node arbitrates, limits and refuses them."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Twist, TwistStamped
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, LaserScan
from std_msgs.msg import Bool, Empty, String

from controllers.commands.command_signature import Signer, read_key, write_key
from controllers.nodes.supervisor import SupervisorNode
from models.nodes import topics
from models.nodes.messages import set_stamp
from models.nodes.odometry import velocity_to_twist
from models.nodes.perception import scan_to_message
from models.nodes.qos import COMMAND, EVENT, LATCHED, SENSOR
from models.nodes.status import subscribe_status
from models.robot_model import RobotModel
from models.scan import Scan
from models.status import GaitStatus, NodeStatus, RouteState, RouteStatus, StartStatus, SupervisorStatus
from tests.ros.conftest import StatusTopic
from tests.ros.supervisor_world import World

pytestmark = pytest.mark.ros


@pytest.fixture
def world(bench: Any) -> World:
    return World(bench)


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
        subscribe_status(node, SupervisorStatus, topics.SUPERVISOR_STATUS, self._on_status, LATCHED)
        bench.wait(lambda: world.modes)
        for publisher in (gait, self.plain, self.teleop, self.stamped, self.word, self.autonomy, self.lock):
            bench.wait(lambda publisher=publisher: publisher.get_subscription_count() >= 1)
        begin = self.node._reports.t
        bench.wait(lambda: self.node._reports.t > begin + 0.6)  # sooner a velocity is one that goes on from before

    def _on_status(self, status: SupervisorStatus) -> None:
        self.status = status

    @property
    def refusal(self) -> str:
        return str(self.node.values.get("last refusal", ""))

    def until(self, velocity: tuple[float, float, float], *sends: tuple[Any, tuple[float, float, float]]) -> None:
        """Have sources repeat their velocities until one reaches the gait."""
        self.asked.clear()

        def reached() -> bool:
            for publisher, value in sends:
                publisher.publish(velocity_to_twist(value))
            self.bench.spin(0.05)
            return bool(self.asked) and self.asked[-1] == velocity

        self.bench.wait(reached)


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
    bench.wait(lambda: sources.status.locks == ("pause",))
    sources.lock.publish(Bool(data=False))
    bench.wait(lambda: sources.status.locks == ())
    sources.autonomy.publish(String(data="stop"))  # everybody may
    bench.wait(lambda: sources.node._law.still)
    sources.until((0.0, 0.0, 0.0))
    assert sources.world.modes[-1] == "walk"


def test_a_stopped_stream_does_not_walk_again_on_the_zero_of_another_source(bench: Any, sources: Sources) -> None:
    ahead, idle = (0.3, 0.0, 0.0), bench.world.create_publisher(Twist, topics.source_topics("autonomy")[1], COMMAND)
    bench.wait(lambda: idle.get_subscription_count() == 1)
    sources.until(ahead, (sources.plain, ahead))
    sources.gait.publish(GaitStatus(ready=True, settled=False))
    bench.wait(lambda: sources.node._reports.gait_active)
    sources.autonomy.publish(String(data="stop"))
    bench.wait(lambda: sources.node._law.still)
    for _ in range(10):
        sources.until((0.0, 0.0, 0.0), (sources.plain, ahead), (idle, (0.0, 0.0, 0.0)))
        assert sources.node._law.still
    sources.until((0.0, 0.0, 0.0), (sources.plain, (0.0, 0.0, 0.0)))
    sources.until(ahead, (sources.plain, ahead))


def test_a_stream_from_before_a_supervisor_that_starts_beside_a_standing_robot_begins_no_walk(
    bench: Any, world: World, g1: RobotModel
) -> None:
    ahead, velocity = velocity_to_twist((0.3, 0.0, 0.0)), bench.world.create_publisher(Twist, topics.CMD_VEL, COMMAND)
    timer = bench.world.create_timer(0.05, lambda: velocity.publish(ahead))
    world.robot(g1)
    world.tick = 1000
    world.drivers(topics.ACTIVE)
    node = bench.add(SupervisorNode, lockstep=True)
    gait = StatusTopic(bench.world, topics.GAIT_STATUS, LATCHED)
    gait.publish(GaitStatus(ready=True, settled=True))
    bench.wait(
        lambda: "send a zero velocity, or pause, before a new velocity" in str(node.values.get("last refusal", ""))
    )
    bench.spin(1.0)
    assert set(world.modes) == {"stand"}
    timer.cancel()
    bench.spin(0.7)
    velocity.publish(ahead)
    bench.wait(lambda: world.modes[-1] == "walk")


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
    assert node._law.holds == ()  # a planner that was never there is not missed
    reports.publish(NodeStatus("motion_planner"))
    bench.spin(0.2)
    assert node._law.holds == ()
    world.speed = 0.1  # at a tenth of real time, the reports of a busy machine are late, too
    bench.spin(0.6)
    assert node._law.holds == ()
    world.speed = 5.0  # nor is it missed at once where simulated time is fast
    reports.publish(NodeStatus("motion_planner"))
    bench.spin(0.2)
    assert node._law.holds == ()
    world.speed = 1.0
    bench.wait(lambda: node._law.holds == ("node 'motion_planner' sends no diagnostics",))
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


def test_a_second_clock_is_reported_and_its_times_are_not_accepted(bench: Any, world: World, g1: RobotModel) -> None:
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
        set_stamp(message.header.stamp, round(10_000_000 * sources.world.tick) + ms * 1_000_000)
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
        scans.publish(scan_to_message(round(10_000_000 * world.tick), seen, 0.05))

    assert world.call("mode/walk")[0]
    sources.until((0.0, 0.0, 0.0), (sources.plain, ahead))  # without a scan it does not walk
    timer = bench.world.create_timer(0.05, scan)
    sources.until(ahead, (sources.plain, ahead))
    ranges[85:96] = 0.5
    sources.until((0.0, 0.0, 0.0), (sources.plain, ahead))
    assert "obstacle" in sources.node._commands.values()["obstacles"]
    bench.wait(lambda: "stopped: obstacle" in sources.status.obstacle)
    sources.until(back, (sources.plain, back))
    halted.clear()
    world.twist[0] = 0.3
    route.publish(RouteStatus(RouteState.RUNNING, 9))
    bench.wait(lambda: halted)
    bench.world.destroy_timer(timer)


def test_a_monitor_of_a_real_robot_ends_a_velocity_and_a_walk_to_a_goal(
    bench: Any, world: World, g1: RobotModel
) -> None:
    sources, ahead, still = Sources(bench, world, g1, look_ahead=False), (0.3, 0.0, 0.0), (0.0, 0.0, 0.0)
    start = StatusTopic(bench.world, topics.START_STATUS, LATCHED)
    route = StatusTopic(bench.world, topics.ROUTE_STATUS)
    halted: list[Empty] = []
    bench.world.create_subscription(Empty, topics.GAIT_STOP, halted.append, EVENT)
    bench.wait(lambda: start.get_subscription_count() == 1 and route.get_subscription_count() == 1)
    assert world.call("mode/walk")[0]
    sources.until(ahead, (sources.plain, ahead))
    hot = StartStatus("stand", holds=("motor temperature of 'left_knee_joint'",))
    start.publish(hot)
    sources.until(still, (sources.plain, ahead))
    sources.gait.publish(GaitStatus(ready=True, settled=True))
    bench.wait(lambda: world.modes[-1] == "stand")
    start.publish(StartStatus("stand"))

    def refused() -> bool:
        sources.plain.publish(velocity_to_twist(ahead))
        bench.spin(0.05)
        return "send a zero velocity, or pause, before a new velocity" in sources.refusal

    bench.wait(refused)
    assert world.modes[-1] == "stand"
    assert world.call("mode/walk")[0]
    route.publish(RouteStatus(RouteState.RUNNING, 9))
    bench.spin(0.2)
    halted.clear()
    start.publish(hot)
    bench.wait(lambda: halted)


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
