"""``poise up`` as a user starts it: Ctrl-C ends it with exit code 0, nothing is left; lockstep repeats bit for bit."""

import itertools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
import yaml
from nav_msgs.msg import Odometry
from std_msgs.msg import String
from typer.testing import CliRunner

from bridge.cli import app
from bridge.launch import graph as launch
from bridge.launch.graph import Graph
from bridge.launch.layout import process_specs
from bridge.launch.parameters import node_parameters, ros_arguments
from bridge.ros import environment
from bridge.ros.environment import claim_graph, free_domain, graph_environment
from bridge.ros.processes import ProcessSpec
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.odometry import OdometryCodec
from models.nodes.qos import EVENT, LATCHED, SENSOR

pytestmark = [pytest.mark.ros, pytest.mark.graph]


@pytest.fixture
def up(tmp_path: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A launcher in a process of its own, as soon as it says that the robot is up."""
    output = tmp_path / "output"
    code = (
        "import sys; from pathlib import Path; from bridge.launch.graph import up;"
        f"sys.exit(up('g1', domain_id={free_domain()}, log=Path({str(tmp_path / 'log')!r})))"
    )
    with output.open("wb") as stream:
        process = subprocess.Popen([sys.executable, "-c", code], stderr=stream)
    end = time.monotonic() + 90.0
    while b"is up" not in output.read_bytes():
        assert process.poll() is None, output.read_text()
        assert time.monotonic() < end, output.read_text()
        time.sleep(0.1)
    assert b"starting" in output.read_bytes()
    yield process
    process.kill()


def _wait_gone(processes: list[psutil.Process], timeout: float) -> list[psutil.Process]:
    return psutil.wait_procs(processes, timeout=timeout)[1]


def test_it_stays_on_loopback_and_ctrl_c_ends_everything(up: subprocess.Popen[bytes]) -> None:
    children = psutil.Process(up.pid).children(recursive=True)
    assert len(children) == 4
    sockets = [socket for child in children for socket in child.net_connections("inet")]
    assert {socket.laddr.ip for socket in sockets if socket.laddr} == {"127.0.0.1"}
    before = set(Path("/dev/shm").iterdir())
    mapped = {Path(m.path) for child in children for m in child.memory_maps() if m.path.startswith("/dev/shm/fastrtps")}
    assert mapped == set()  # nothing of this graph lies in shared memory, so nothing can be left there
    up.send_signal(signal.SIGINT)
    assert up.wait(timeout=15.0) == 0
    assert _wait_gone(children, 1.0) == []
    assert not {path for path in set(Path("/dev/shm").iterdir()) - before if "fastrtps" in path.name}


def test_a_second_graph_in_the_domain_starts_nothing(tmp_path: Path) -> None:
    domain = free_domain()
    with closing(claim_graph("g1", domain, "")):
        children = psutil.Process().children()
        with pytest.raises(PoiseError, match=f"already running in ROS domain {domain}: g1, process {os.getpid()}"):
            Graph("talos", domain_id=domain, log=tmp_path / "log").__enter__()
        with pytest.raises(PoiseError, match="already running"):
            launch.Graph("g1", domain_id=domain, namespace="/").open()
        assert psutil.Process().children() == children and not (tmp_path / "log").exists()
        claim_graph("g1", domain, "/robot_1").close()
    claim_graph("g1", domain, "").close()


@pytest.mark.slow
def test_a_killed_launcher_takes_its_processes_along(up: subprocess.Popen[bytes]) -> None:
    children = psutil.Process(up.pid).children(recursive=True)
    up.kill()
    assert _wait_gone(children, 10.0) == []


def test_wrong_robot_is_refused_by_name(tmp_path: Path) -> None:
    with (
        pytest.raises(PoiseError, match="refused to configure"),
        Graph("unknown_robot", domain_id=free_domain(), log=tmp_path / "log", say=lambda text: None),
    ):
        pass
    assert "unknown_robot" in (tmp_path / "log").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "line",
    [
        *("up --robot unknown_robot", "up --robots robot_1=g1,robot_2=unknown_robot", "rehearse --robot unknown_robot"),
        *("demo --robot unknown_robot", "demo --scene stairs --robot unknown_robot"),
    ],
)
def test_an_unknown_robot_starts_nothing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, line: str) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("bridge.launch.graph.up", lambda *_, **__: 0)
    monkeypatch.setattr("bridge.launch.world.up_world", lambda *_, **__: 0)
    result = CliRunner().invoke(app, line.split())
    assert result.exit_code == 2 and result.output.startswith("unknown robot 'unknown_robot'; known: g1")
    assert len(result.output.splitlines()) == 1 and list(tmp_path.iterdir()) == []


def test_parameters_for_unknown_nodes_are_refused() -> None:
    with pytest.raises(PoiseError, match="unknown nodes: no_such_node"):
        Graph("g1", parameters={"no_such_node": {}})


@pytest.mark.parametrize(
    ("driver", "lockstep", "priorities"),
    [
        ({}, False, (0, 0)),  # simulated time waits: every process gets its share of the cores
        ({"real_time": "strict"}, False, (40, 30)),
        ({"plant": "unitree"}, False, (40, 30)),  # the time of a real robot does not wait
        ({"real_time": "strict"}, True, (0, 0)),
    ],
)
def test_real_time_priority_is_for_time_that_does_not_wait(
    driver: dict[str, object], lockstep: bool, priorities: tuple[int, int], tmp_path: Path
) -> None:
    given = node_parameters(process_specs(), "g1", lockstep, tmp_path, {"robot_driver": driver})
    found = [given[name].get("realtime.priority", 0) for name in ("balance_controller", "supervisor")]
    assert tuple(found) == priorities


def test_what_cannot_be_built_is_said_and_the_signals_are_given_back(capfd: pytest.CaptureFixture[str]) -> None:
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    assert launch.up("g1", parameters={"no_such_node": {}}) == 1
    assert "unknown nodes: no_such_node" in capfd.readouterr().err
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


PLAIN = """
import sys, time, rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String
rclpy.init()
node, received = rclpy.create_node("plain"), []
node.create_subscription(
    String, "mode", lambda message: received.append(message.data),
    QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL),
)
publisher = node.create_publisher(String, "humanoid_commands", 10)
end = time.monotonic() + 20.0
while time.monotonic() < end and not (received and publisher.get_subscription_count()):
    rclpy.spin_once(node, timeout_sec=0.1)
time.sleep(0.5)
publisher.publish(String(data="wave"))
time.sleep(0.5)
print(received)
"""


@pytest.mark.parametrize("discovery", [None, "LOCALHOST"])
def test_a_plain_process_on_this_machine_reaches_the_graph(bench: Any, discovery: str | None) -> None:
    """With nothing of poise in it and nothing set, in both directions."""
    received: list[str] = []
    bench.world.create_subscription(String, topics.HUMANOID_COMMANDS, lambda m: received.append(m.data), EVENT)
    bench.world.create_publisher(String, topics.MODE, LATCHED).publish(String(data="stand"))
    ours = ("FASTRTPS_DEFAULT_PROFILES_FILE", "ROS_AUTOMATIC_DISCOVERY_RANGE")
    environment = {name: value for name, value in os.environ.items() if name not in ours}
    if discovery is not None:
        environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] = discovery
    plain = subprocess.Popen([sys.executable, "-c", PLAIN], env=environment, stdout=subprocess.PIPE, text=True)
    try:
        bench.wait(lambda: plain.poll() is not None, 40.0)
        assert plain.stdout is not None
        assert plain.stdout.read().strip() == "['stand']"
        assert received == ["wave"]
    finally:
        plain.kill()


def test_parameters_of_a_process_keep_their_types_in_its_file(tmp_path: Path) -> None:
    spec = ProcessSpec("module", ("a", "b"))
    values = {"a": {"text": "1", "flag": True, "list": [1.0, 2.0]}, "c": {"x": 1}}
    file = tmp_path / "parameters.yaml"
    assert ros_arguments(spec.nodes, values, "", file) == ["--ros-args", "--params-file", str(file)]
    assert yaml.safe_load(file.read_text()) == {
        "/a": {"ros__parameters": values["a"]}, "/b": {"ros__parameters": {}},
    }  # fmt: skip


def test_environment_stays_on_this_machine_by_default(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("FASTRTPS_DEFAULT_PROFILES_FILE", raising=False)
    monkeypatch.delenv("HOME", raising=False)
    monkeypatch.delenv("ROS_LOG_DIR", raising=False)
    local = graph_environment(domain_id=7)
    assert local["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SYSTEM_DEFAULT"  # as the profile needs it
    assert "127.0.0.1" in Path(local["FASTRTPS_DEFAULT_PROFILES_FILE"]).read_text(encoding="utf-8")
    assert local["ROS_DOMAIN_ID"] == "7"
    assert "ROS_LOG_DIR" in local
    assert "FASTRTPS_DEFAULT_PROFILES_FILE" not in graph_environment(network=True)


def test_a_domain_with_a_participant_is_not_free(monkeypatch: pytest.MonkeyPatch) -> None:
    """A participant of a graph on loopback, where no socket is bound to the multicast port."""
    taken = free_domain()
    code = (
        "import rclpy; from rclpy.node import Node; rclpy.init(); kept = Node('here');"
        "print('here', flush=True); input()"
    )
    variables = {**os.environ, **graph_environment(domain_id=taken)}
    with subprocess.Popen(
        [sys.executable, "-c", code], env=variables, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"here\n"
        monkeypatch.setattr(environment, "_domains", itertools.count(taken - 1))
        assert free_domain() != taken
        monkeypatch.setattr(environment, "_domains", itertools.repeat(taken - 1))
        with pytest.raises(PoiseError, match="every ROS domain is in use"):
            free_domain()
        process.communicate(b"\n", timeout=30.0)


def _lockstep_run(log: Path, until: float) -> dict[int, np.ndarray]:
    """True base pose and twist by stamp, of a run of the graph in lockstep up to a time [s]."""
    rows: dict[int, np.ndarray] = {}
    codec = OdometryCodec()

    def on_truth(data: bytes) -> None:
        stamp, pose, twist = codec.decode(data)
        rows[stamp] = np.concatenate([pose, twist])

    parameters = {"robot_driver": {"seed": 5}}
    with Graph(
        "g1", lockstep=True, domain_id=free_domain(), parameters=parameters, log=log, say=lambda text: None
    ) as graph:
        graph.node.create_subscription(Odometry, topics.GROUND_TRUTH, on_truth, SENSOR, raw=True)
        graph.wait_for(lambda: bool(rows) and max(rows) >= until * 1e9, 60.0, "stepping")
        assert graph.driver_state == "active"
    return rows


@pytest.mark.slow
def test_lockstep_over_ros_is_bit_identical(tmp_path: Path) -> None:
    first, second = (_lockstep_run(tmp_path / f"log{i}", until=2.0) for i in range(2))
    common = sorted(first.keys() & second.keys())
    assert len(common) > 100
    for stamp in common:
        np.testing.assert_array_equal(first[stamp], second[stamp])
