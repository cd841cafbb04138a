"""Faults over ROS: services of the bridge, messages that do not come, and a plan from the release on."""

from collections import Counter
from typing import Any

import pytest
from geometry_msgs.msg import WrenchStamped
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu, JointState, LaserScan
from std_msgs.msg import String
from std_srvs.srv import Trigger

from bridge.nodes.robot_driver import RobotDriver
from models.nodes import topics
from models.nodes.cdr import stamp_of
from models.nodes.qos import STATE

pytestmark = pytest.mark.ros


class World:
    """Counts the bridge's messages and calls its services."""

    def __init__(self, bench: Any) -> None:
        self.bench, self.seen, self.stamps = bench, Counter[str](), list[int]()
        hear = bench.world.create_subscription
        left, right = topics.FOOT_WRENCHES
        kinds = {topics.IMU_RAW: Imu, topics.JOINT_STATES: JointState, left: WrenchStamped, right: WrenchStamped}
        qos = STATE  # as in lockstep: none is lost but those that a fault keeps
        for name, kind in kinds.items():
            hear(kind, name, lambda _, name=name: self.seen.update([name]), qos)
        hear(JointState, topics.JOINT_STATES, lambda data: self.stamps.append(stamp_of(data)), qos, raw=True)
        self.clients: dict[str, Any] = {}

    def call(self, name: str) -> tuple[bool, str]:
        if name not in self.clients:
            self.clients[name] = self.bench.world.create_client(Trigger, name)
            self.bench.wait(self.clients[name].service_is_ready)
            self.bench.spin(0.2)
        future = self.clients[name].call_async(Trigger.Request())
        self.bench.wait(future.done)
        return future.result().success, future.result().message

    def ticks(self, bridge: RobotDriver, count: int) -> dict[str, int]:
        """Messages by topic that come while the bridge runs so many ticks."""
        self.bench.spin(0.1)
        self.seen.clear()
        for _ in range(count):
            bridge.publish_tick(0.0)
            self.bench.spin(0.02)
            bridge.step()
        self.bench.spin(0.1)
        return dict(self.seen)


def scenario(bridge: RobotDriver, text: str) -> None:
    assert bridge.set_parameters([Parameter("faults.scenario", value=text)])[0].successful


def test_services_inject_what_the_parameter_says_and_clear_it(bench: Any) -> None:
    world, bridge = World(bench), bench.add(RobotDriver, lockstep=True)
    every = {topics.IMU_RAW: 6, topics.JOINT_STATES: 6, **dict.fromkeys(topics.FOOT_WRENCHES, 6)}
    assert world.ticks(bridge, 6) == every
    scenario(bridge, "[{target: imu, kind: off, end: 0.004}, {target: 'foot:left', kind: slow, rate: 500}]")
    accepted, reported = world.call("faults/inject")
    assert accepted and reported == "injected: imu off (until 0.004 s); foot:left slow (rate 500)"
    assert world.ticks(bridge, 6) == {**every, topics.IMU_RAW: 2, topics.FOOT_WRENCHES[0]: 3}
    bridge.before_diagnostics()
    assert bridge.values["faults injected"] == "foot:left slow (rate 500)"
    assert world.call("faults/clear") == (True, "cleared: foot:left slow (rate 500)")
    assert world.ticks(bridge, 6) == every
    bridge.before_diagnostics()
    assert bridge.values["faults injected"] == "no faults"
    scenario(bridge, "{target: joint_states, kind: off, end: 0.002}")
    assert world.call("faults/inject")[0]
    assert world.ticks(bridge, 6) == {**every, topics.JOINT_STATES: 4}
    bridge.drivers.plant.faults.inject("{target: stamps, kind: wrong, offset: -0.005, end: 0.001}")
    world.ticks(bridge, 2)
    assert world.stamps[-1] - world.stamps[-2] == 6_000_000  # [ns]


@pytest.mark.parametrize(
    ("text", "culprit"),
    [
        (" ", "faults.scenario is empty"),
        ("{target: nose, kind: off}", "unknown target 'nose'; known: imu"),
        ("{target: 'joint:tail_joint', kind: off}", "unknown joint 'tail_joint'; known: left_hip_pitch_joint"),
        ("/nowhere/faults.yaml", "cannot be read"),
    ],
)
def test_refusals_carry_the_reason_and_are_counted(bench: Any, text: str, culprit: str) -> None:
    world, bridge = World(bench), bench.add(RobotDriver)
    scenario(bridge, text)
    accepted, reported = world.call("faults/inject")
    assert not accepted and culprit in reported
    assert bridge.counters["refused faults/inject"] == 1 and culprit in bridge.values["last refusal"]
    assert not bridge.drivers.plant.faults.active


def test_lockstep_does_not_wait_for_an_answer_that_no_node_can_give(bench: Any) -> None:
    bridge = bench.add(RobotDriver, lockstep=True)
    bridge.commands.on_mode(String(data="stand"))
    bridge.step()  # the first sample was taken before
    for text, ticks in (
        ("{target: imu, kind: off, end: 0.002}", 2),
        ("{target: joint_states, kind: off, end: 0.002}", 2),
        ("{target: imu.gyro, kind: wrong, value: .nan, end: 0.002}", 2),
        ("{target: stamps, kind: wrong, offset: -0.05, end: 0.002}", 2),
        ("{target: imu.gyro, kind: wrong, value: 1.0, end: 0.002}", 0),
    ):
        bridge.drivers.plant.faults.inject(text)
        free = []
        for _ in range(4):
            bridge.publish_tick(0.0)
            free.append(bridge.answered)
            bridge.step()
        assert free == [True] * ticks + [False] * (4 - ticks)


def test_a_scan_that_is_off_is_not_published(bench: Any) -> None:
    stamps: list[int] = []
    qos = STATE
    bench.world.create_subscription(LaserScan, topics.SCAN, lambda data: stamps.append(stamp_of(data)), qos, raw=True)
    bridge = bench.add(RobotDriver, lockstep=True)
    bench.wait(lambda: bridge._scan._publisher.get_subscription_count() == 1)
    bridge.drivers.plant.faults.inject("{target: scan, kind: off, end: 0.015}")
    for bridge.tick in (1000, 2000, 3000):
        bridge.publish_tick(0.0)
        for _ in range(10):
            bridge.step()
    bench.wait(lambda: stamps)
    bench.spin(0.1)
    assert stamps == [3000 * 1_000_000]  # [ns]


def test_a_plan_waits_for_the_release(bench: Any) -> None:
    bridge = bench.add(RobotDriver, **{"faults.plan": "dead_knee"})
    faults = bridge.drivers.plant.faults
    assert not faults.active
    bridge.drivers.plant.release()
    assert [str(fault) for fault in faults.injected] == ["motor:left_knee_joint off (from 1 s)"]
    bench.remove(bridge)
    bridge = bench.add(RobotDriver, active=False, **{"faults.plan": "headless"})
    assert "unknown scenario 'headless'; known: dead_knee" in bridge.message
