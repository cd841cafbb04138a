"""The exit code of a process of the graph is that of its work."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from bridge.ros.environment import free_domain, graph_environment

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


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ("comand_key:=x", "supervisor: unknown parameter 'comand_key': did you mean 'command_key'?"),
        ("period:=fast", "'period' to 'fast' of type 'STRING', expecting type 'DOUBLE'"),
        ("period:=-1.0", "period out of range Min: 0.001, Max: 1.0"),
    ],
)
def test_a_wrong_parameter_is_refused_in_one_line(ros_domain_id: int, given: str, reason: str) -> None:
    command = [sys.executable, "-m", "controllers.nodes.supervisor", "--ros-args", "-p", given]
    ended = subprocess.run(
        command, capture_output=True, text=True, timeout=60, env={**os.environ, **graph_environment()}
    )
    assert ended.returncode == 1
    (line,) = ended.stderr.splitlines()
    assert reason in line


BLOCKED = """
import ctypes
from models.nodes import spin
spin.END_TIME = 1
Trouble.destroy_node = lambda self: ctypes.PyDLL(None).sleep(60)  # in C, with Python's lock held
"""


@pytest.mark.parametrize(
    ("act", "code"), [("raise ValueError('a bug')", 1), ("os.kill(os.getpid(), signal.SIGTERM)", 0)]
)
def test_a_middleware_that_blocks_does_not_keep_a_process_from_its_end(ros_domain_id: int, act: str, code: int) -> None:
    program, end = NODE.format(act=act).rsplit("sys.exit", 1)
    ended = subprocess.run(
        [sys.executable, "-c", f"{program}{BLOCKED}sys.exit{end}"],
        capture_output=True,
        text=True,
        timeout=50,
        env={**os.environ, **graph_environment()},
    )
    assert ended.returncode == code
    assert "shut down" in ended.stdout


POISE = "from bridge.cli import app; app()"
NEIGHBOUR = """
import rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("neighbour")
ends = [node.create_publisher(String, name, 10) for name in ("mode", "humanoid_commands")]
ends += [node.create_subscription(String, "mode", print, 10)]
print("there", flush=True)
rclpy.spin(node)
"""


@pytest.mark.slow
def test_a_graph_ends_beside_a_neighbour_that_was_killed(tmp_path: Path) -> None:
    os.environ["ROS_LOG_DIR"] = str(tmp_path)
    domain = free_domain()
    environment = {**os.environ, **graph_environment(domain_id=domain)}
    for turn in range(50):
        with subprocess.Popen([sys.executable, "-c", NEIGHBOUR], stdout=subprocess.PIPE, env=environment) as neighbour:
            assert neighbour.stdout is not None and neighbour.stdout.readline() == b"there\n"
            command = [sys.executable, "-c", POISE, "up", "--duration", "0.1", "--no-actions"]
            graph = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)
            neighbour.kill()
            assert graph.wait(timeout=120) == 0, turn


def test_where_no_log_can_be_written_a_process_says_so_and_runs(ros_domain_id: int) -> None:
    environment = {**os.environ, **graph_environment(), "ROS_LOG_DIR": "/dev/null/logs"}
    ended = subprocess.run(
        [sys.executable, "-c", NODE.format(act="os.kill(os.getpid(), signal.SIGTERM)")],
        capture_output=True,
        text=True,
        timeout=60,
        env=environment,
    )
    assert ended.returncode == 0
    assert "no log files in /dev/null/logs: Not a directory" in ended.stderr


MAINS = """
import os, signal
from importlib import import_module
from pathlib import Path
from models.nodes import spin

run = spin.run
for module in ("bridge.nodes.robot_driver", "bridge.nodes.control", "controllers.nodes.supervisor"):
    main = import_module(module).main
    def serve(executor, nodes, stop):
        for node in nodes:
            node.trigger_configure()
            node.trigger_activate()
        executor.spin_once(timeout_sec=0.1)
    spin.run = import_module(module).run = lambda factories, args, loop=None: run(factories, args, serve)
    try:
        main([])
    except SystemExit as end:
        assert end.code == 0
    threads = {path.read_text().strip() for path in Path("/proc/self/task").glob("*/comm")}
    print(module, sorted(name for name in threads if name.startswith("dds")), flush=True)
os._exit(0)  # what is left must not decide it
"""


@pytest.mark.long
def test_the_middleware_has_ended_before_the_process_does(ros_domain_id: int) -> None:
    """Its thread that watches the graph would read what the process destroys at its end: one run in twelve crashed."""
    environment = {**os.environ, **graph_environment()}
    ended = subprocess.run(
        [sys.executable, "-c", MAINS], capture_output=True, text=True, timeout=120, env=environment, check=True
    )
    lines = ended.stdout.splitlines()
    assert len(lines) == 3
    assert [line for line in lines if not line.endswith("[]")] == []
