"""The supervisor's node beside a world of a few topics: what it publishes, and when it holds its tongue."""

from __future__ import annotations

from typing import Any

import pytest
from std_msgs.msg import String
from std_srvs.srv import Trigger

from controllers.nodes.supervisor import SupervisorNode
from models.nodes import topics
from models.nodes.qos import LATCHED

pytestmark = pytest.mark.ros


class World:
    """Drivers that say what they do, and ears for the mode."""

    def __init__(self, bench: Any) -> None:
        self.bench = bench
        self.modes: list[str] = []
        node = bench.world
        node.create_subscription(String, topics.MODE, lambda message: self.modes.append(message.data), LATCHED)
        self._drivers = node.create_publisher(String, topics.DRIVER_STATE, LATCHED)
        self._clients: dict[str, Any] = {}

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
    bench.spin(0.3)
    assert world.modes == []
    world.drivers(topics.ACTIVE)
    bench.wait(lambda: world.modes)
    assert world.modes == ["stand"]  # never off: the drivers would drop a robot that stands


def test_damped_drivers_are_adopted_with_a_latched_fault(bench: Any, world: World) -> None:
    world.drivers(topics.DAMPED)
    bench.add(SupervisorNode)
    bench.wait(lambda: world.modes)
    assert world.modes == ["damp"]
    accepted, reason = world.call("mode/stand")
    assert not accepted
    assert "the drivers were damped when the supervisor started" in reason
    assert world.call("reset_faults")[0]
