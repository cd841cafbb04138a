"""A robot in a namespace, its driver at 500 Hz: it stands, waves and walks, nothing is outside; the launch file."""

import importlib.util
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from typer.testing import CliRunner

from bridge.cli import app
from bridge.launch.graph import Graph
from bridge.launch.parameters import with_file
from bridge.ros.environment import free_domain
from bridge.ros.namespace import absolute_namespace
from models.errors import ConfigError, PoiseError
from models.nodes import topics
from models.nodes.qos import COMMAND, SENSOR

pytestmark = [pytest.mark.ros, pytest.mark.graph]

OF_RCLPY = {"/parameter_events", "/rosout"}
"""Topics that every node has, wherever it is."""


@pytest.fixture(scope="module")
def graph(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Graph]:
    log = tmp_path_factory.mktemp("namespace") / "log"
    os.environ["ROS_LOG_DIR"] = str(log.parent)
    parameters = {"robot_driver": {"rate": 500.0}}
    with Graph(
        "g1", lockstep=True, domain_id=free_domain(), log=log, namespace="robot_1", parameters=parameters,
        say=lambda text: None,
    ) as graph:  # fmt: skip
        graph.wait_standing(90.0)
        yield graph
    assert set(graph.exit_codes.values()) == {0}


def test_it_stands_and_nothing_of_it_is_outside(graph: Graph) -> None:
    names = {name for name, _ in graph.node.get_topic_names_and_types()} - OF_RCLPY
    names |= {name for name, _ in graph.node.get_service_names_and_types()}
    assert {"/robot_1/joint_states", "/robot_1/clock", "/robot_1/tf", "/robot_1/diagnostics"} <= names
    assert not [name for name in names if not name.startswith("/robot_1/")]


def test_it_waves_and_walks_with_a_driver_of_500_hz(graph: Graph) -> None:
    places: list[float] = []
    node = graph.node
    node.create_subscription(Odometry, topics.GROUND_TRUTH, lambda m: places.append(m.pose.pose.position.x), SENSOR)
    velocity = node.create_publisher(Twist, topics.CMD_VEL, COMMAND)
    graph.send("wave")
    graph.wait_for(lambda: graph.mode == "motion", 60.0, "waving")
    graph.wait_for(lambda: graph.mode == "stand", 120.0, "done waving")
    graph.send("walk")
    graph.wait_for(lambda: graph.mode == "walk", 60.0, "walking")
    start, message = places[-1], Twist()
    message.linear.x = 0.3

    def walked() -> bool:
        velocity.publish(message)
        return places[-1] > start + 0.4

    graph.wait_for(walked, 120.0, "forward")
    assert graph.call("mode/stand")[0]
    graph.wait_for(lambda: graph.standing, 60.0, "standing again")


def test_its_nodes_have_their_parameters_and_answer(graph: Graph) -> None:
    assert graph.call("mode/damp")[0]
    graph.wait_for(lambda: graph.mode == "damp", 5.0, "damped")
    accepted, reason = graph.call("mode/walk")
    assert not accepted and reason


@pytest.mark.parametrize(("given", "name"), [("", ""), ("/", ""), ("robot_1", "/robot_1"), ("/a/b/", "/a/b")])
def test_namespaces_are_made_absolute(given: str, name: str) -> None:
    assert absolute_namespace(given) == name


@pytest.mark.parametrize("given", ["robot 1", "1robot", "a//b"])
def test_wrong_namespaces_are_refused_by_name(given: str) -> None:
    with pytest.raises(PoiseError, match=f"namespace '{given}'"):
        absolute_namespace(given)


@pytest.fixture(scope="module")
def launch_file(root: Path) -> Any:
    """The launch file as a module; ``launch`` itself is imported by what only ``ros2 launch`` calls."""
    spec = importlib.util.spec_from_file_location("launch_file", root / "bridge/launch_files/humanoid.launch.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_launch_file_asks_for_options_that_poise_up_has(
    launch_file: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    given: dict[str, Any] = {}

    def up(robot: str, **options: Any) -> int:
        given.update(options, robot=robot)
        return 0

    monkeypatch.setattr("bridge.launch.graph.up", up)
    values = {name: default for name, (default, _) in launch_file.ARGUMENTS.items()}
    line = launch_file.command(values | {"robot": "talos", "namespace": "robot_1", "network": "True"})
    assert line[0].endswith("lib/bridge/poise")
    result = CliRunner().invoke(app, line[1:])
    assert result.exit_code == 0, result.output
    assert (given["robot"], given["namespace"]) == ("talos", "robot_1")
    assert (given["network"], given["lockstep"]) == (True, False)
    monkeypatch.setenv("ROS_DOMAIN_ID", "1")
    real = {"plant": "unitree", "plant_options": "{network_interface: lo, domain: 3}"}
    result = CliRunner().invoke(app, launch_file.command(values | real)[1:])
    assert result.exit_code == 0, result.output
    assert given["robot_network"].domain == 3
    file = tmp_path / "own.yaml"
    file.write_text("/supervisor: {ros__parameters: {command_key: x, arbitration: {a: 1.0}}}", encoding="utf-8")
    result = CliRunner().invoke(app, launch_file.command(values | {"params_file": str(file)})[1:])
    assert result.exit_code == 0, result.output
    assert given["parameters"]["supervisor"] == {"command_key": "x", "arbitration.a": 1.0}
    with pytest.raises(ValueError, match="network: 'perhaps'"):
        launch_file.command({"network": "perhaps"})


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("supervisor: {auto_stand: false}", "supervisor: expected one mapping, 'ros__parameters'"),
        ("supervisor: {ros__parameters: {robot: talos}}", "supervisor: 'robot' is set by the command line"),
        ("robot_driver: {ros__parameters: {speed: 0.5}}", "robot_driver: 'speed' is set by the command line"),
        ("supervisor: {ros__parameters: {period: 2026-01-01}}", "supervisor: 'period' has no value"),
        ("supervisor: {ros__parameters: {period: }}", "supervisor: 'period' has no value"),
    ],
)
def test_wrong_parameter_files_are_refused_by_name(text: str, reason: str, tmp_path: Path) -> None:
    file = tmp_path / "own.yaml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=f"own.yaml: {reason}"):
        with_file({"robot_driver": {"speed": 1.0}}, file)
