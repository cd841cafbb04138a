"""Subscribers as textbooks write them, with a depth and nothing else: they receive, and sleeping ones delay none."""

import json
import os
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
        eyes.graph.wait_for(lambda: set(log.read_text().split()) >= set(STATES), 60.0, "receiving")
        yield process
    finally:
        process.kill()
        process.wait()


def test_every_state_arrives_and_subscribers_that_stop_reading_do_not_delay_the_control_path(
    eyes: Eyes, tmp_path: Path, undisturbed: None
) -> None:
    timeouts = int(eyes.reports["/robot_driver"]["driver timeouts"])
    with textbook(eyes, tmp_path / "sleep", "sleep"), textbook(eyes, tmp_path / "stop") as stopped:
        stopped.send_signal(signal.SIGSTOP)
        begin = eyes.stamp
        # a writer that keeps all would be full after 5000 messages, one in each millisecond, and wait
        eyes.graph.wait_for(lambda: eyes.stamp - begin > 6 * 10**9, 60.0, "going on")
    eyes.graph.spin(0.3)  # until the next report
    assert int(eyes.reports["/robot_driver"]["driver timeouts"]) == timeouts
