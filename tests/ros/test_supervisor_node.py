"""The supervisor's node beside a world of a few topics: what it publishes, and when it holds its tongue."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger

from controllers.nodes.supervisor import SupervisorNode
from models.nodes import topics
from models.nodes.messages import JointStateCodec, set_stamp
from models.nodes.odometry import OdometryCodec
from models.nodes.qos import EVENT, LATCHED, SENSOR
from models.robot_model import RobotModel
from tests.support import standing

pytestmark = pytest.mark.ros


class World:
    """Drivers that say what they do, and ears for the mode."""

    def __init__(self, bench: Any) -> None:
        self.bench = bench
        self.modes: list[str] = []
        self.roll, self.tick, self.silent = 0.0, 0, False
        node = bench.world
        node.create_subscription(String, topics.MODE, lambda message: self.modes.append(message.data), LATCHED)
        self._drivers = node.create_publisher(String, topics.DRIVER_STATE, LATCHED)
        self._clients: dict[str, Any] = {}

    def robot(self, g1: RobotModel) -> None:
        """Publish what an upright robot publishes, a hundred times a second; ``roll`` lays it down.

        ``silent`` leaves out all but the clock, as for one who has not found the other topics yet.
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
            odometry.publish(odom.encode(stamp, standing(g1, q=q)))
            for publisher in (topic, command):
                publisher.publish(joints.encode(stamp, q[7:], zero, zero))

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
        ("optimal", "20", "overran its time budget in 20 ticks in a row"),
        ("damped", "0", "no usable torques"),
        ("splendid", "0", "no usable torques"),
    ],
)
def test_what_the_controller_reports_damps(
    bench: Any, world: World, g1: RobotModel, status: str, overruns: str, culprit: str
) -> None:
    world.robot(g1)
    world.drivers(topics.ACTIVE)
    node = bench.add(SupervisorNode, lockstep=True)
    reports = bench.world.create_publisher(DiagnosticArray, "/diagnostics", EVENT)

    def report(message: str, count: str) -> None:
        told = DiagnosticStatus(name="/balance_controller", message=message)
        told.values = [KeyValue(key=topics.OVERRUNS, value=count)]
        reports.publish(DiagnosticArray(status=[told]))

    bench.wait(lambda: world.modes and reports.get_subscription_count() == 1)
    report("optimal", "19")
    bench.spin(0.3)
    report("idle in mode 'off'", "0")
    bench.spin(0.3)
    assert world.modes == ["stand"]
    report(status, overruns)
    bench.wait(lambda: world.modes[-1] == "damp")
    assert culprit in world.call("mode/stand")[1]
    assert node.counters["refused /diagnostics"] == (status == "splendid")


def test_a_number_that_is_too_long_is_refused_and_the_supervisor_lives(
    bench: Any, world: World, g1: RobotModel
) -> None:
    world.robot(g1)
    world.drivers(topics.ACTIVE)
    node = bench.add(SupervisorNode, lockstep=True)
    reports = bench.world.create_publisher(DiagnosticArray, "/diagnostics", EVENT)
    bench.wait(lambda: world.modes and reports.get_subscription_count() == 1)
    digits = "9" * 5000
    told = DiagnosticStatus(name="/balance_controller", message="optimal")
    told.values = [KeyValue(key=topics.OVERRUNS, value=digits)]
    reports.publish(DiagnosticArray(status=[told]))
    bench.wait(lambda: node.counters["refused /diagnostics"] == 1)
    told = DiagnosticStatus(name="/state_estimator", values=[KeyValue(key=topics.COASTING, value=digits)])
    reports.publish(DiagnosticArray(status=[told]))
    bench.wait(lambda: node.counters["refused /diagnostics"] == 2)
    assert node.active


def test_a_drop_out_that_goes_on_damps_and_one_that_ends_does_not(bench: Any, world: World, g1: RobotModel) -> None:
    world.robot(g1)
    world.drivers(topics.ACTIVE)
    node = bench.add(SupervisorNode, lockstep=True)
    reports = bench.world.create_publisher(DiagnosticArray, "/diagnostics", EVENT)

    def report(since: str) -> None:
        told = DiagnosticStatus(name="/state_estimator", values=[KeyValue(key=topics.COASTING, value=since)])
        reports.publish(DiagnosticArray(status=[told]))

    def now() -> str:
        return str(10_000_000 * world.tick)

    bench.wait(lambda: world.modes and reports.get_subscription_count() == 1)
    report(str(10_000_000 * world.tick + 10**9))  # it begins in a second: not yet a drop-out
    bench.spin(0.2)
    report("")
    bench.spin(0.3)
    assert world.modes == ["stand"]
    report(now())
    bench.wait(lambda: world.modes[-1] == "damp")
    assert "no usable samples of the IMU" in world.call("mode/stand")[1]
    assert node.counters["refused /diagnostics"] == 0
    report("a while ago")
    bench.wait(lambda: node.counters["refused /diagnostics"] == 1)


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
    bench.add(SupervisorNode, lockstep=True)
    phase = bench.world.create_publisher(String, topics.GAIT_PHASE, LATCHED)
    text = bench.world.create_publisher(String, topics.HUMANOID_COMMANDS, EVENT)
    asked: list[tuple[float, float, float]] = []

    def hear(message: Twist) -> None:
        asked.append((message.linear.x, message.linear.y, message.angular.z))

    bench.world.create_subscription(Twist, topics.GAIT_VELOCITY, hear, EVENT)
    bench.wait(lambda: world.modes and phase.get_subscription_count() == 1 and text.get_subscription_count() == 1)
    bench.spin(0.2)
    accepted, reason = world.call("mode/walk")
    assert not accepted
    assert "no gait planner" in reason
    phase.publish(String(data=topics.GAIT_SETTLED))
    bench.spin(0.1)
    text.publish(String(data="left"))
    bench.wait(lambda: asked)
    assert world.modes[-1] == "walk"
    assert asked == [(0.0, pytest.approx(0.15), 0.0)]
    accepted, _ = world.call("mode/stand")  # before the planner has said anything about this walk
    assert accepted
    bench.wait(lambda: len(asked) == 2)
    assert asked[1] == (0.0, 0.0, 0.0)
    for word in ("stand", "single left", "finish"):
        phase.publish(String(data=word))
        bench.spin(0.1)
        assert world.modes[-1] == "walk"
    phase.publish(String(data=topics.GAIT_SETTLED))
    bench.wait(lambda: world.modes[-1] == "stand")
    phase.publish(String(data=topics.GAIT_ABSENT))
    bench.spin(0.1)
    assert "no gait planner" in world.call("mode/walk")[1]
