"""Ends of a topic that do not agree on the quality of service: who reports it, for how long, and what it forbids."""

from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String

from controllers.nodes.supervisor import SupervisorNode
from models.nodes import qos as qos_module
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.qos import EVENT, LATCHED, SENSOR, command
from models.robot_model import RobotModel
from models.status import NodeStatus
from tests.ros.conftest import StatusTopic
from tests.ros.nodes.test_supervisor_node import World

pytestmark = pytest.mark.ros

INPUT, OUTPUT = "joint_states", "mode"
"""Topics of the node under test."""


class Ends(PoiseNode):
    """Listens to one topic and announces another.

    Args:
        qos: Profile of both.
        kwargs: Passed to rclpy.
    """

    def __init__(self, qos: QoSProfile, **kwargs: Any) -> None:
        super().__init__("ends", **kwargs)
        self._profile = qos

    def configure(self) -> None:
        self.listen(String, INPUT, lambda message: None, self._profile)
        self.announce(String, OUTPUT, self._profile)


class Diagnostics:
    """Diagnostics of one node."""

    def __init__(self, bench: Any, name: str) -> None:
        self._name, self.level, self.values = name, b"", dict[str, str]()
        bench.world.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, EVENT)

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        for status in array.status:
            if status.name == self._name:
                self.level, self.values = status.level, {item.key: item.value for item in status.values}

    @property
    def mismatches(self) -> dict[str, str]:
        """Who and which policy, by topic."""
        words = f"{qos_module.INCOMPATIBLE_QOS} "
        return {key.removeprefix(words): value for key, value in self.values.items() if key.startswith(words)}


SLOW = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, deadline=Duration(seconds=1))
FRESH = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.VOLATILE)


@pytest.mark.parametrize(
    ("own", "publisher", "subscriber", "policy"),
    [
        (EVENT, SENSOR, None, "RELIABILITY"),
        (LATCHED, FRESH, None, "DURABILITY"),
        (command(0.02), SLOW, None, "DEADLINE"),
        (SENSOR, None, EVENT, "RELIABILITY"),
        (EVENT, None, LATCHED, "DURABILITY"),
        (SLOW, None, command(0.02), "DEADLINE"),
    ],
)
def test_it_is_reported_while_the_other_end_is_there(
    bench: Any,
    monkeypatch: pytest.MonkeyPatch,
    own: QoSProfile,
    publisher: QoSProfile | None,
    subscriber: QoSProfile | None,
    policy: str,
) -> None:
    monkeypatch.setattr(qos_module, "SETTLE_TIME", 0.3)
    world, said = bench.world, Diagnostics(bench, "/ends")
    bench.add(lambda **kwargs: Ends(own, **kwargs))
    bench.wait(lambda: said.level == DiagnosticStatus.OK)
    assert said.mismatches == {}
    if publisher is not None:
        other = world.create_publisher(String, INPUT, publisher)
        expected = {INPUT: f"publisher: {policy}"}
    else:
        other = world.create_subscription(String, OUTPUT, lambda message: None, subscriber)
        expected = {OUTPUT: f"subscriber: {policy}"}
    bench.wait(lambda: said.mismatches == expected and said.level == DiagnosticStatus.WARN)
    bench.spin(0.5)  # longer than the node counts mismatches itself: the other end is discovered
    assert said.mismatches == expected
    (world.destroy_publisher if publisher is not None else world.destroy_subscription)(other)
    bench.wait(lambda: said.mismatches == {} and said.level == DiagnosticStatus.OK)


def test_ends_that_agree_are_not_reported(bench: Any) -> None:
    said = Diagnostics(bench, "/ends")
    received: list[String] = []
    publisher = bench.world.create_publisher(String, INPUT, EVENT)
    bench.world.create_subscription(String, OUTPUT, received.append, SENSOR)
    bench.add(lambda **kwargs: Ends(EVENT, **kwargs))
    bench.wait(lambda: publisher.get_subscription_count() == 1 and said.level == DiagnosticStatus.OK)
    bench.spin(0.5)
    assert (said.mismatches, said.level) == ({}, DiagnosticStatus.OK)


def test_what_the_node_has_given_up_is_forgotten(bench: Any) -> None:
    said = Diagnostics(bench, "/ends")
    node = bench.add(lambda **kwargs: Ends(EVENT, **kwargs))
    bench.world.create_publisher(String, INPUT, SENSOR)
    bench.wait(lambda: said.mismatches)
    node.trigger_deactivate()
    node.trigger_cleanup()
    bench.wait(lambda: not said.mismatches)


@pytest.fixture
def damped(bench: Any, g1: RobotModel) -> tuple[World, SupervisorNode]:
    """A supervisor beside an upright, damped robot, whose latched fault is reset and whose checks have passed."""
    world = World(bench)
    world.robot(g1)
    world.drivers(topics.DAMPED)
    node = bench.add(SupervisorNode, lockstep=True, preflight_time=0.3)
    bench.wait(lambda: world.modes == ["damp"])
    assert world.call("reset_faults")[0]
    bench.wait(lambda: node._law.preflight == ())
    return world, node


def test_arming_is_refused_naming_topic_and_policy(
    bench: Any, damped: tuple[World, SupervisorNode], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(qos_module, "SETTLE_TIME", 0.3)
    world, law = damped[0], damped[1]._law
    other = bench.world.create_publisher(String, topics.DRIVER_STATE, FRESH)
    bench.wait(lambda: law.preflight)
    accepted, reason = world.call("mode/stand")
    assert not accepted
    assert "'driver_state' has incompatible QoS: publisher: DURABILITY, reports supervisor" in reason
    bench.world.destroy_publisher(other)
    bench.wait(lambda: not law.preflight)
    assert world.call("mode/stand")[0]


@pytest.mark.slow
def test_any_node_may_report_it_and_only_needed_topics_count(bench: Any, damped: tuple[World, SupervisorNode]) -> None:
    law = damped[1]._law
    reports = StatusTopic(bench.world, topics.NODE_STATUS)
    bench.wait(lambda: reports.get_subscription_count() >= 1)

    def report(*found: str) -> None:
        reports.publish(NodeStatus("drivers", found, ("publisher",) * len(found), ("DEADLINE",) * len(found)))

    for topic in topics.needed_topics(damped[1].model):
        report("scan", topic)
        bench.wait(lambda topic=topic: any(f"'{topic}' has incompatible QoS" in finding for finding in law.preflight))
        assert len(law.preflight) == 1 and "reports drivers" in law.preflight[0]
    report("scan")
    bench.wait(lambda: not law.preflight)


def test_of_those_who_hear_nothing_only_drivers_count(bench: Any, damped: tuple[World, SupervisorNode]) -> None:
    law = damped[1]._law
    reports = StatusTopic(bench.world, topics.NODE_STATUS)
    bench.wait(lambda: reports.get_subscription_count() >= 1)
    found = topics.needed_topics(damped[1].model)
    reports.publish(NodeStatus("bridge", found, ("subscriber",) * len(found), ("RELIABILITY",) * len(found)))
    bench.wait(lambda: law.preflight)
    assert [f"'{topics.JOINT_SETPOINTS}' has incompatible QoS" in finding for finding in law.preflight] == [True]
