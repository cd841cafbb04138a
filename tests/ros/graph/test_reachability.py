"""Who reaches the graph: a plain rclpy process on this machine always, another machine only with ``--network``.

The other machine is a network namespace, joined by a pair of virtual interfaces. All of it ends with its processes.
"""

from pathlib import Path
from typing import Any

import pytest

from tests.ros.cable import staged

pytestmark = pytest.mark.ros

NODE = '''
"""Part of a graph: says what it has received, and at which addresses it listens."""
import sys, time

from bridge.ros.environment import join_graph

join_graph(network=sys.argv[1] == "network")

import rclpy
from std_msgs.msg import String

rclpy.init()
node = rclpy.create_node("inside")
received = set()
node.create_subscription(String, "humanoid_commands", lambda message: received.add(message.data), 10)
publisher = node.create_publisher(String, "chatter", 10)
with open("/proc/self/net/udp") as table:
    addresses = sorted({line.split()[1].split(":")[0] for line in list(table)[1:]})
print(" ".join(addresses), flush=True)
end = time.monotonic() + 60.0
while time.monotonic() < end:
    publisher.publish(String(data=" ".join(["up", *sorted(received)])))
    rclpy.spin_once(node, timeout_sec=0.05)
'''

VISITOR = '''
"""A plain rclpy process: commands, and prints what it has received when it is answered, or after a timeout [s]."""
import sys, time

import rclpy
from std_msgs.msg import String

name, timeout = sys.argv[1], float(sys.argv[2])
rclpy.init()
node = rclpy.create_node(name)
received = set()
node.create_subscription(String, "chatter", lambda message: received.update(message.data.split()), 10)
command = node.create_publisher(String, "humanoid_commands", 10)
end = time.monotonic() + timeout
while time.monotonic() < end and name not in received:
    command.publish(String(data=name))
    rclpy.spin_once(node, timeout_sec=0.05)
print(" ".join(sorted(received)))
'''

STAGE = '''
"""Two machines with one cable, in the first a graph and a visitor, in the second another visitor."""
import json, os, subprocess, sys

from benchmarks.core.cable import HERE, two_machines

reach, timeout = sys.argv[1:]
python = (sys.executable, "-u")
node = None
with two_machines() as there:
    try:
        node = subprocess.Popen([*python, "node.py", reach], stdout=subprocess.PIPE, text=True)
        addresses = node.stdout.readline().split()
        plain = {name: value for name, value in os.environ.items() if name != "FASTRTPS_DEFAULT_PROFILES_FILE"}
        peers = {**plain, "ROS_STATIC_PEERS": HERE}  # it need not even search
        visit, pipes = [*python, "visitor.py"], {"stdout": subprocess.PIPE, "text": True}
        far = subprocess.Popen([*there, *visit, "far", timeout], env=peers, **pipes)
        near = subprocess.Popen([*visit, "near", "30"], env=plain, **pipes)
        result = {"near": near.communicate()[0].split(), "far": far.communicate()[0].split()}
        result["exits"] = [near.returncode, far.returncode]  # one that has crashed has received nothing either
        # After that, has the graph received from the one outside?
        late = subprocess.run([*visit, "late", "30"], env=plain, **pipes)
        result |= {"late": late.stdout.split(), "addresses": addresses}
    finally:
        if node is not None:
            node.terminate()  # in order, or its shared memory would stay
            node.wait(20)
print(json.dumps(result))
'''


def reached(reach: str, timeout: float, folder: Path, root: Path) -> Any:
    """What ``STAGE`` prints for a graph of this reach."""
    scripts = {"node.py": NODE, "visitor.py": VISITOR, "stage.py": STAGE}
    return staged(scripts, [reach, str(timeout)], folder, root)


LOOPBACK = "0100007F"
"""127.0.0.1 as the kernel writes it."""


@pytest.mark.long
def test_the_graph_is_reached_from_this_machine_only(tmp_path: Path, root: Path) -> None:
    result = reached("loopback", 3.0, tmp_path, root)
    assert "near" in result["near"]  # received, and answered
    assert (result["far"], result["exits"]) == ([], [0, 0])
    assert "late" in result["late"] and "near" in result["late"] and "far" not in result["late"]
    assert result["addresses"] == [LOOPBACK]


@pytest.mark.long
def test_network_opens_it(tmp_path: Path, root: Path) -> None:
    """The control: the cable carries, and the visitor from outside would have been received."""
    result = reached("network", 30.0, tmp_path, root)
    assert result["exits"] == [0, 0]
    assert "near" in result["near"] and "far" in result["far"], result
    assert "far" in result["late"]
    assert set(result["addresses"]) - {LOOPBACK}
