"""A reliable message that gets lost on its way comes again at once, not at the middleware's leisure of up to 3 s."""

import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from bridge.ros.environment import graph_environment, participant

pytestmark = pytest.mark.ros

READER = """
import time, rclpy
from std_msgs.msg import String
from models.nodes.qos import LATCHED, SENSOR
from models.nodes.spin import make_executor
rclpy.init()
node = rclpy.create_node("reader")
node.create_subscription(String, "flood", lambda message: None, SENSOR)
node.create_subscription(String, "mode", lambda message: print(message.data, time.monotonic(), flush=True), LATCHED)
executor = make_executor()
executor.add_node(node)
while rclpy.ok():
    executor.spin_once(timeout_sec=0.2)
"""

WRITER = """
import sys, time, rclpy
from std_msgs.msg import String
from models.nodes.qos import LATCHED, SENSOR
rclpy.init()
node = rclpy.create_node("writer")
flood, mode = node.create_publisher(String, "flood", SENSOR), node.create_publisher(String, "mode", LATCHED)
while mode.get_subscription_count() < 1 or flood.get_subscription_count() < 1:
    time.sleep(0.05)
print("ready", flush=True)
for line in sys.stdin:
    for _ in range(12000):
        flood.publish(String(data="x" * 100))
    mode.publish(String(data="damp"))
    print("sent", flush=True)
"""

LATEST = 0.5
"""From the moment on in which the reader can receive again [s]."""


def _process(code: str, domain_id: int) -> subprocess.Popen[str]:
    environment = {**os.environ, **graph_environment(domain_id=domain_id)}
    pipe = subprocess.PIPE
    return subprocess.Popen([sys.executable, "-c", code], env=environment, stdin=pipe, stdout=pipe, text=True)


def test_a_mode_that_was_lost_arrives_soon(ros_domain_id: int) -> None:
    """While the reader stands still, more arrives than its socket holds: what comes after that is lost."""
    reader, writer = _process(READER, ros_domain_id), _process(WRITER, ros_domain_id)
    try:
        assert reader.stdout and writer.stdout and writer.stdin
        assert writer.stdout.readline() == "ready\n"
        time.sleep(0.5)
        for _ in range(3):
            os.kill(reader.pid, signal.SIGSTOP)
            print("now", file=writer.stdin, flush=True)
            assert writer.stdout.readline() == "sent\n"
            os.kill(reader.pid, signal.SIGCONT)
            again = time.monotonic()
            word, at = reader.stdout.readline().split()
            assert word == "damp"
            assert float(at) - again < LATEST
    finally:
        for process in (reader, writer):
            os.kill(process.pid, signal.SIGCONT)
            process.kill()
            process.wait()
            process.stdin.close()  # type: ignore[union-attr]
            process.stdout.close()  # type: ignore[union-attr]


def test_sockets_have_room_for_the_description_of_a_whole_graph(ros_domain_id: int) -> None:
    """All participants describe their endpoints to a newcomer at once; what overflows comes again a second later."""
    granted = min(8_000_000, int(Path("/proc/sys/net/core/rmem_max").read_text()))
    with participant("newcomer"):
        sizes = []
        for file in Path("/proc/self/fd").iterdir():
            with suppress(OSError), socket.socket(fileno=os.dup(int(file.name))) as held:
                if held.type == socket.SOCK_DGRAM and held.getsockname()[0] == "127.0.0.1":
                    sizes.append(held.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF))
    assert max(sizes) >= granted
