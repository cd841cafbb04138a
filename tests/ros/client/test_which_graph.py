"""Which graph a command finds, and what is said where it finds none."""

import fcntl
import os
import re
import tempfile
import time
from pathlib import Path

import pytest
from rclpy.context import Context
from rclpy.node import Node
from std_msgs.msg import String

from bridge.launch.robot_network import RobotNetwork
from bridge.ros.client import Client
from bridge.ros.environment import claim_graph, graphs_elsewhere
from models.errors import CommandError, PoiseError
from models.nodes import topics
from models.nodes.qos import LATCHED
from tests.ros.client.fake_supervisor import FakeSupervisor

pytestmark = pytest.mark.ros


def test_a_robot_that_is_starting_is_no_reason_to_start_one(context: Context, ros_domain_id: int) -> None:
    with Client(namespace="robot_1") as client:
        starting = rf"poise up \(g1, process {os.getpid()}\) is starting, or does not answer; use the remote"
        with claim_graph("g1", None, "/robot_1"), pytest.raises(CommandError, match=starting):
            client.robot(timeout=0.3)
        with pytest.raises(CommandError, match="start it with: poise up"):
            client.robot(timeout=0.3)


def test_a_graph_in_another_domain_is_named(
    context: Context, ros_domain_id: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))  # without the graphs of others
    other = ros_domain_id + 150  # which no test claims
    with Client(namespace="robot_1") as client, claim_graph("g1_hardware", other, ""):
        named = rf"ROS domain {ros_domain_id}, namespace /robot_1, but in ROS domain {other} \(g1_hardware, process "
        remedy = rf"{os.getpid()}\): export ROS_DOMAIN_ID={other} and leave --namespace out; if none is up"
        with pytest.raises(CommandError, match=named + remedy):
            client.robot(timeout=0.3)
        with claim_graph("g1", None, "/lab/robot_2"):
            here = (
                rf"in ROS domain {ros_domain_id}, namespace /lab/robot_2 \(g1, .*\): give --namespace /lab/robot_2(;|$)"
            )
            assert re.search(here, graphs_elsewhere("/robot_1")) and not graphs_elsewhere("/lab/robot_2")
        with claim_graph("g1", None, "/robot_1"):
            assert not graphs_elsewhere("/robot_1")


@pytest.mark.parametrize("text", ["robot", "-1", "233"])
def test_what_is_no_ros_domain_is_refused_by_name(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", text)
    for use in (lambda: claim_graph("g1", None, ""), RobotNetwork("lo").check, Client().__enter__):
        with pytest.raises(PoiseError, match=f"ROS_DOMAIN_ID: '{text}' is not a ROS domain, 0 to 232; export"):
            use()


def test_a_command_that_looks_for_graphs_does_not_prevent_one(
    ros_domain_id: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    claim_graph("g1", None, "").close()
    file = Path(tempfile.gettempdir()) / f"poise-graph-{ros_domain_id}-{os.getuid()}.lock"
    with file.open() as looking:
        fcntl.flock(looking, fcntl.LOCK_SH)
        monkeypatch.setattr(time, "sleep", lambda _: looking.close())
        claim_graph("g1", None, "").close()


def test_robots_in_other_namespaces_are_named(context: Context) -> None:
    node = Node("supervisor", context=context, namespace="robot_2")
    node.create_publisher(String, topics.SUPERVISOR_STATUS, LATCHED)
    with Client() as client, pytest.raises(CommandError, match="are up in /robot_2: give --namespace"):
        client.robot(timeout=1.0)
    with (
        Client(namespace="robot_1") as client,
        pytest.raises(CommandError, match=r"no service /robot_1/mode/stand .*/robot_2"),
    ):
        client.trigger("mode/stand", timeout=1.0)
    node.destroy_node()


def test_without_a_namespace_the_only_robot_is_named(context: Context) -> None:
    node = Node("supervisor", context=context)
    node.create_publisher(String, topics.SUPERVISOR_STATUS, LATCHED)
    with Client(namespace="robot_1") as client, pytest.raises(CommandError, match="are up in /: leave --namespace out"):
        client.robot(timeout=1.0)
    node.destroy_node()


def test_a_robot_that_is_up_lacks_a_service(supervisor: FakeSupervisor) -> None:
    with (
        Client() as client,
        pytest.raises(CommandError, match=r"no service none within 1 s: the robot is up: poise"),
    ):
        client.trigger("none", timeout=1.0)
