"""Subscribers as textbooks write them, with a depth and nothing else: they receive, and sleeping ones delay none."""

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.ros.conftest import Eyes

pytestmark = [pytest.mark.ros, pytest.mark.graph]

#: Type of each state topic that a standing robot publishes
STATES = {
    "joint_states": "sensor_msgs/JointState",
    "imu/data_raw": "sensor_msgs/Imu",
    "imu/data": "sensor_msgs/Imu",
    "foot/left/wrench": "geometry_msgs/WrenchStamped",
    "foot/right/wrench": "geometry_msgs/WrenchStamped",
    "odom": "nav_msgs/Odometry",
    "contacts": "std_msgs/UInt8MultiArray",
    "external_wrench": "geometry_msgs/WrenchStamped",
    "scan": "sensor_msgs/LaserScan",
    "clock": "rosgraph_msgs/Clock",
    "balance_controller/posture": "sensor_msgs/JointState",
    "ground_truth/odom": "nav_msgs/Odometry",
    "ground_truth/joint_states": "sensor_msgs/JointState",
}
#: Prints each topic at its first message; after the last, callbacks sleep with the argument ``sleep``
TEXTBOOK = """
import json, sys, time
from importlib import import_module
import rclpy

rclpy.init()
node = rclpy.create_node("textbook")
states, received = json.loads(sys.argv[1]), set()

def receive(topic):
    if topic not in received:
        received.add(topic)
        print(topic, flush=True)
    elif received == set(states) and "sleep" in sys.argv:
        time.sleep(3600.0)

for topic, kind in states.items():
    package, name = kind.split("/")
    kind = getattr(import_module(package + ".msg"), name)
    node.create_subscription(kind, topic, lambda message, topic=topic: receive(topic), 10)
rclpy.spin(node)
"""


@contextmanager
def textbook(eyes: Eyes, log: Path, *words: str) -> Iterator[subprocess.Popen[bytes]]:
    """A process with default subscribers to all states, once each has received a message."""
    command = [sys.executable, "-c", TEXTBOOK, json.dumps(STATES), *words]
    with log.open("wb") as output:
        # its processor time is not the matter here: 5000 messages a second take most of a core
        process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT, preexec_fn=lambda: os.nice(19))
    try:
        eyes.graph.spin(1.0)
        eyes.graph.wait_for(lambda: set(log.read_text().split()) >= set(STATES), 60.0, "receiving")
        yield process
    finally:
        process.kill()
        process.wait()


def test_every_state_reaches_a_default_subscriber(eyes: Eyes, tmp_path: Path) -> None:
    with textbook(eyes, tmp_path / "log"):
        pass


@pytest.mark.parametrize("how", ["sleep", "stop"])
def test_a_subscriber_that_stops_reading_does_not_delay_the_control_path(
    eyes: Eyes, tmp_path: Path, undisturbed: None, how: str
) -> None:
    drivers = eyes.reports["/robot_driver"]
    timeouts, stamps = int(drivers["driver timeouts"]), len(eyes.truth)
    with textbook(eyes, tmp_path / "log", how) as process:
        if how == "stop":
            process.send_signal(signal.SIGSTOP)
        eyes.graph.spin(8.0)  # a writer that keeps all would be full after 5000 messages, and wait
    assert len(eyes.truth) > stamps + 100
    assert int(eyes.reports["/robot_driver"]["driver timeouts"]) == timeouts


def test_no_node_offers_best_effort(root: Path) -> None:
    """The reference lists what each publisher offers, and another test holds it to the code."""
    topics = (root / "docs/reference.md").read_text(encoding="utf-8").partition("## Services")[0]
    assert not re.findall(r"^\| `([^`]+)` \| [^|]+ \| best effort", topics, re.MULTILINE)
