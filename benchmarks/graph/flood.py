"""Processes that overload the graph or the machine until they are killed; few imports for a fast start."""

import itertools
import time
from collections.abc import Callable

import rclpy
from std_msgs.msg import String
from std_srvs.srv import Trigger

from models.nodes import topics
from models.nodes.qos import EVENT

START_TIME = 2.0  # start time of such a process [s]
DISCOVERY_TIME = 0.5  # time between joining the graph and discovery [s]


def texts(rate: float) -> None:
    """Publish an unknown text on ``humanoid_commands`` at a rate [Hz]."""
    rclpy.init()
    publisher = rclpy.create_node("flood").create_publisher(String, topics.HUMANOID_COMMANDS, EVENT)
    _at(rate, lambda: publisher.publish(String(data="nonsense")))


def services(rate: float) -> None:
    """Call ``reset_faults`` at a rate [Hz] without waiting for responses; it has no effect without faults."""
    rclpy.init()
    client = rclpy.create_node("flood").create_client(Trigger, "reset_faults")

    def call() -> None:
        client.remove_pending_request(client.call_async(Trigger.Request()))

    _at(rate, call)


def burn() -> None:
    """Load one core."""
    for _ in itertools.count():
        pass


def _at(rate: float, act: Callable[[], object]) -> None:
    time.sleep(DISCOVERY_TIME)
    began = time.monotonic()
    for number in itertools.count(1):
        act()
        time.sleep(max(began + number / rate - time.monotonic(), 0.0))
