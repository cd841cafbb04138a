"""``poise teleop`` in a terminal: keys become velocities and words of the source teleop, and the end is silence."""

import os
import pty
import select
import subprocess
import sys

import pytest
from geometry_msgs.msg import Twist
from std_msgs.msg import String

from models.nodes import topics
from models.nodes.qos import COMMAND, EVENT, LATCHED
from models.status import SupervisorStatus
from models.types import Mode
from tests.ros.conftest import Bench, StatusTopic

pytestmark = pytest.mark.ros

COMMAND_LINE = [sys.executable, "-c", "import sys; sys.argv[1:] = ['teleop']; from bridge.cli import app; app()"]


@pytest.mark.long
def test_keys_in_a_terminal_steer_until_z_is_pressed(bench: Bench) -> None:
    supervisor = StatusTopic(bench.world, topics.SUPERVISOR_STATUS, LATCHED)
    supervisor.publish(SupervisorStatus("g1", Mode.STAND, 0, "", ()))
    word, velocity = topics.source_topics("teleop")
    words: list[str] = []
    twists: list[float] = []
    bench.world.create_subscription(String, word, lambda message: words.append(message.data), EVENT)
    bench.world.create_subscription(Twist, velocity, lambda message: twists.append(message.linear.x), COMMAND)
    terminal, side = pty.openpty()
    process = subprocess.Popen(COMMAND_LINE, stdin=side, stdout=side, stderr=side)
    os.close(side)
    try:
        said = [b""]

        def reported() -> bool:  # its first line about the robot
            if select.select([terminal], [], [], 0.0)[0]:
                said[0] += os.read(terminal, 4096)
            return b"unknown" in said[0]

        bench.wait(reported, 60.0)
        os.write(terminal, b"ww")
        bench.wait(lambda: bool(twists) and twists[-1] == pytest.approx(0.2), 20.0)
        os.write(terminal, b"v")
        bench.wait(lambda: "wave" in words, 20.0)
        bench.wait(lambda: twists[-1] == 0.0, 20.0)
        os.write(terminal, b"w")
        bench.wait(lambda: twists[-1] == pytest.approx(0.1), 20.0)
        os.write(terminal, b"z")
        bench.wait(lambda: process.poll() is not None, 20.0)
        bench.wait(lambda: twists[-1] == 0.0, 5.0)
        assert process.returncode == 0
    finally:
        process.kill()
        process.wait()
        os.close(terminal)


@pytest.mark.long
def test_without_a_terminal_it_says_what_it_needs(ros_domain_id: int) -> None:
    result = subprocess.run(COMMAND_LINE, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=120)
    assert result.returncode == 2 and "needs a terminal" in result.stderr
