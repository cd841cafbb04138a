"""Nodes as ROS 2 courses print them, beside a graph: each has a visible effect, or a refusal that says why."""

import math
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from bridge.launch.graph import Graph
from bridge.launch.world import Inhabitant, WorldGraph
from bridge.ros.environment import free_domain
from models.nodes.interfaces import interface, missing_types
from tests.ros.conftest import Eyes

pytestmark = [pytest.mark.ros, pytest.mark.graph]

FOLDER = Path(__file__).parents[2] / "examples" / "textbook"
ANSWER_TIME = 60.0
"""Longest wait for an effect [s]: other programs may use the processor."""


class Robot:
    """What a student sees of one robot."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.joints: dict[str, float] = {}
        graph.node.create_subscription(JointState, "joint_states", self._on_joints, 10)

    def _on_joints(self, message: JointState) -> None:
        self.joints = dict(zip(message.name, message.position, strict=True))

    def until(self, condition: Callable[[], bool], what: str) -> None:
        """Wait for an effect."""
        self.graph.wait_for(condition, ANSWER_TIME, what)


@contextmanager
def program(name: str, log: Path, namespace: str = "") -> Iterator[Callable[[], str]]:
    """A textbook node in a process; yields what reads its output."""
    command = [sys.executable, str(FOLDER / f"{name}.py"), "--ros-args", "-r", f"__ns:=/{namespace}"]
    with log.open("wb") as output:
        process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT)
    try:
        yield log.read_text
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(30.0)


@pytest.fixture(scope="module")
def robot(eyes: Eyes) -> Robot:
    seen = Robot(eyes.graph)
    seen.until(lambda: bool(seen.joints), "publishing joint states")
    return seen


def yaw(eyes: Eyes) -> float:
    """True heading of the base [rad]."""
    x, y, z, w = eyes.truth[-1][3:7]
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def test_every_textbook_node_is_short() -> None:
    files = sorted(FOLDER.glob("*.py"))
    assert len(files) >= 8
    assert {
        path.name: len(path.read_text().splitlines()) for path in files if len(path.read_text().splitlines()) >= 40
    } == {}


def test_joint_commands_at_50_hz_move_an_arm(robot: Robot, eyes: Eyes, tmp_path: Path) -> None:
    before, place = robot.joints["left_elbow_joint"], eyes.truth[-1][:3].copy()
    with program("arm_commands", tmp_path / "log"):
        robot.until(lambda: abs(robot.joints["left_elbow_joint"] - before) > 0.3, "moving the elbow")
    assert np.linalg.norm(eyes.truth[-1][:3] - place) < 0.05  # it balances meanwhile
    robot.until(lambda: robot.graph.standing, "standing")


def test_the_imu_logger_logs_an_upright_robot(robot: Robot, tmp_path: Path) -> None:
    with program("imu_logger", tmp_path / "log") as output:
        robot.until(lambda: "roll" in output(), "logging")
    words = next(line for line in output().splitlines() if "roll" in line).split()
    assert all(abs(float(words[words.index(name) + 1])) < 0.05 for name in ("roll", "pitch", "yaw"))


@pytest.mark.skipif(bool(missing_types()), reason=missing_types() or "built")
def test_a_plan_to_a_target_is_executed(robot: Robot, tmp_path: Path) -> None:
    before = dict(robot.joints)
    with program("plan_client", tmp_path / "log") as output:
        robot.until(lambda: "accepted: left_hand gets there" in output(), "answering")
        robot.until(lambda: max(abs(robot.joints[name] - before[name]) for name in before) > 0.2, "reaching")
    robot.until(lambda: robot.graph.mode == "stand", "standing")


def test_the_humanoid_controller_waves(robot: Robot, tmp_path: Path) -> None:
    """The graph waves on the same word: the trajectory is executed, or refused with the reason."""
    lowest = [math.inf, -math.inf]

    def waved() -> bool:
        angle = robot.joints["right_shoulder_roll_joint"]
        lowest[:] = min(lowest[0], angle), max(lowest[1], angle)
        return lowest[1] - lowest[0] > 0.3

    with program("humanoid_controller", tmp_path / "log") as output:
        robot.until(lambda: robot.graph.node.count_subscribers("humanoid_commands") > 1, "subscribing")
        robot.graph.spin(0.5)
        robot.graph.send("wave")
        robot.until(lambda: "waving with 29 joints" in output(), "receiving the command")
        robot.until(waved, "waving")
    robot.until(lambda: robot.graph.standing, "standing")


@pytest.mark.skipif(bool(missing_types()), reason=missing_types() or "built")
def test_words_become_velocities_and_two_integers_are_added(robot: Robot, eyes: Eyes, tmp_path: Path) -> None:
    words = robot.graph.node.create_publisher(String, "text", 10)
    adder = interface("example_interfaces", "srv", "AddTwoInts")
    client = robot.graph.node.create_client(adder, "add_two_ints")
    heading = yaw(eyes)
    with program("text_commander", tmp_path / "log"):
        robot.until(client.service_is_ready, "offering add_two_ints")
        robot.graph.spin(0.5)
        answer = client.call_async(adder.Request(a=2, b=3))
        robot.until(answer.done, "adding")
        assert answer.result().sum == 5
        words.publish(String(data="spin"))
        robot.until(lambda: abs(yaw(eyes) - heading) > 0.5, "turning")
        words.publish(String(data="stop"))
        robot.until(lambda: robot.graph.mode == "stand", "standing")


def test_a_scan_in_an_unknown_frame_is_refused_by_name(robot: Robot, eyes: Eyes, tmp_path: Path) -> None:
    with program("fake_scan", tmp_path / "log"):
        eyes.refusal("supervisor", "scan", lambda: None, "header.frame_id: 'laser_frame' instead of")


def test_the_scan_reader_walks_and_its_end_ends_in_a_stand(robot: Robot, eyes: Eyes, tmp_path: Path) -> None:
    start = eyes.truth[-1][:2].copy()
    with program("scan_reader", tmp_path / "log"):
        robot.until(lambda: float(np.linalg.norm(eyes.truth[-1][:2] - start)) > 0.4, "walking")
    robot.until(lambda: robot.graph.mode == "stand", "standing")


@pytest.mark.slow
def test_the_same_nodes_serve_two_robots_in_two_namespaces(tmp_path: Path) -> None:
    names = ("robot_1", "robot_2")
    robots = {name: Inhabitant("g1") for name in names}
    with WorldGraph(robots, domain_id=free_domain(), log=tmp_path / "graph.log", say=lambda text: None) as world:
        world.wait_standing(180.0)
        seen = {name: Robot(world.graphs[name]) for name in names}
        world.wait_for(lambda: all(each.joints for each in seen.values()), ANSWER_TIME, "publishing")
        before = {name: each.joints["left_elbow_joint"] for name, each in seen.items()}
        with (
            program("arm_commands", tmp_path / "log_1", "robot_1"),
            program("arm_commands", tmp_path / "log_2", "robot_2"),
        ):
            world.wait_for(
                lambda: all(abs(seen[name].joints["left_elbow_joint"] - before[name]) > 0.3 for name in names),
                180.0,
                "moving",
            )
        world.wait_for(lambda: all(graph.standing for graph in world.graphs.values()), ANSWER_TIME, "standing")
