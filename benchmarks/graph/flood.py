"""Processes that overload the graph or the machine until they are killed; few imports, so that they start fast."""

import itertools
import time
from collections.abc import Callable

import rclpy
from std_msgs.msg import String
from std_srvs.srv import Trigger

from models.nodes import topics
from models.nodes.qos import EVENT

START_TIME = 2.0  # of such a process [s]
DISCOVERY_TIME = 0.5  # between joining the graph and being discovered [s]


def texts(rate: float) -> None:
    """Say nonsense on ``humanoid_commands`` at a rate [Hz]."""
    rclpy.init()
    publisher = rclpy.create_node("flood").create_publisher(String, topics.HUMANOID_COMMANDS, EVENT)
    _at(rate, lambda: publisher.publish(String(data="nonsense")))


def services(rate: float) -> None:
    """Call ``reset_faults``, which changes nothing while there are none, at a rate [Hz], and wait for no answer."""
    rclpy.init()
    client = rclpy.create_node("flood").create_client(Trigger, "reset_faults")

    def call() -> None:
        client.remove_pending_request(client.call_async(Trigger.Request()))

    _at(rate, call)


def burn() -> None:
    """Use a core."""
    for _ in itertools.count():
        pass


def _at(rate: float, act: Callable[[], object]) -> None:
    time.sleep(DISCOVERY_TIME)
    began = time.monotonic()
    for number in itertools.count(1):
        act()
        time.sleep(max(began + number / rate - time.monotonic(), 0.0))
