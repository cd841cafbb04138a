"""Robots in namespaces of their own, on machines of two networks, joined by a discovery server: no multicast there."""

import shutil
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.ros.cable import staged

pytestmark = [pytest.mark.ros, pytest.mark.slow]

SERVER = "fast-discovery-server"
"""Of Fast DDS; in the wheels it is beside the other programs of the environment."""

ROBOT = '''
"""Part of a graph that other machines may join: says what it has received in its namespace."""
import sys, time

from bridge.ros.environment import join_graph

join_graph(network=True)

import rclpy
from std_msgs.msg import String

name = sys.argv[1]
rclpy.init()
node = rclpy.create_node("part", namespace=name)
received = set()
node.create_subscription(String, "humanoid_commands", lambda message: received.add(message.data), 10)
said = node.create_publisher(String, "chatter", 10)
print("up", flush=True)
end = time.monotonic() + 60.0
while time.monotonic() < end:
    said.publish(String(data=" ".join([name, *sorted(received)])))
    rclpy.spin_once(node, timeout_sec=0.05)
'''

OPERATOR = '''
"""Commands both robots by their namespaces, and prints what each has answered by then."""
import json, sys, time

from bridge.ros.environment import join_graph

join_graph(network=True)

import rclpy
from std_msgs.msg import String

timeout = float(sys.argv[1])
rclpy.init()
node = rclpy.create_node("operator")
robots = ("robot_1", "robot_2")
received = {name: set() for name in robots}
commands = {}
for name in robots:
    node.create_subscription(String, f"/{name}/chatter", lambda m, n=name: received[n].update(m.data.split()), 10)
    commands[name] = node.create_publisher(String, f"/{name}/humanoid_commands", 10)
end = time.monotonic() + timeout
while time.monotonic() < end and not all(f"wave_{name}" in received[name] for name in robots):
    for name, command in commands.items():
        command.publish(String(data=f"wave_{name}"))
    rclpy.spin_once(node, timeout_sec=0.05)
print(json.dumps({name: sorted(texts) for name, texts in received.items()}))
'''

STAGE = '''
"""A robot on each of two machines, an operator on the second, on the first a discovery server if one is named."""
import os, subprocess, sys

from benchmarks.core.cable import FIRST, routed_machines

server, timeout = sys.argv[1:]
python = (sys.executable, "-u")
environment = dict(os.environ)
started = []

def start(*command, **options):
    started.append(subprocess.Popen(command, stdout=subprocess.PIPE, text=True, **options))
    started[-1].stdout.readline()  # it is up

with routed_machines() as (first, second):
    try:
        if server:
            start(*first, server, "--server-id", "0", "--udp-address", FIRST, "--udp-port", "11811")
            environment["ROS_DISCOVERY_SERVER"] = f"{FIRST}:11811"
        start(*first, *python, "robot.py", "robot_1", env=environment)
        start(*second, *python, "robot.py", "robot_2", env=environment)
        operator = [*second, *python, "operator_.py", timeout]
        print(subprocess.run(operator, env=environment, stdout=subprocess.PIPE, text=True, check=True).stdout)
    finally:
        for process in reversed(started):
            process.terminate()
            process.wait(20)
'''


def received(server: str, timeout: float, folder: Path, root: Path) -> Any:
    """What the operator has received from each robot."""
    # operator.py is the name of a module of Python, and the folder comes first on its path.
    scripts = {"robot.py": ROBOT, "operator_.py": OPERATOR, "stage.py": STAGE}
    return staged(scripts, [server, str(timeout)], folder, root)


def test_a_discovery_server_joins_robots_of_two_machines(tmp_path: Path, root: Path) -> None:
    server = shutil.which(SERVER, path=str(Path(sys.executable).parent)) or shutil.which(SERVER)
    if server is None:
        pytest.skip(f"no {SERVER} here")
    found = received(server, 40.0, tmp_path, root)
    # Each answers in its own namespace, and has received nothing that was for the other.
    assert found == {"robot_1": ["robot_1", "wave_robot_1"], "robot_2": ["robot_2", "wave_robot_2"]}


def test_without_it_two_networks_stay_apart(tmp_path: Path, root: Path) -> None:
    """The control: it is the server that joins them."""
    found = received("", 6.0, tmp_path, root)
    assert found == {"robot_1": [], "robot_2": ["robot_2", "wave_robot_2"]}
