"""A process of the graph ends with an exit code that tells the truth."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from bridge.ros.environment import graph_environment

pytestmark = pytest.mark.ros

NODE = """
import os, signal, sys
from rclpy.node import Node
from models.nodes.spin import run

class Trouble(Node):
    def __init__(self):
        super().__init__("trouble")
        self.create_timer(0.1, self.act)

    def act(self):
        {act}

    def trigger_shutdown(self):
        print("shut down", flush=True)

sys.exit(run([Trouble], []))
"""


@pytest.mark.parametrize(
    ("act", "code"), [("raise ValueError('a bug')", 1), ("os.kill(os.getpid(), signal.SIGTERM)", 0)]
)
def test_exit_code(ros_domain_id: int, act: str, code: int) -> None:
    environment = {**os.environ, **graph_environment()}
    ended = subprocess.run(
        [sys.executable, "-c", NODE.format(act=act)], capture_output=True, text=True, timeout=60, env=environment
    )
    assert ended.returncode == code
    assert "shut down" in ended.stdout
    assert ("ValueError: a bug" in ended.stderr) == (code == 1)
