"""Nodes as ROS 2 courses print them, beside one robot or two: each has a visible effect, or a refusal that says why."""

import math
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from bridge.launch.graph import Graph
from bridge.launch.world import Inhabitant, WorldGraph
from bridge.ros.environment import free_domain
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.interfaces import interface, missing_types
from models.nodes.odometry import OdometryCodec
from models.nodes.qos import LATCHED, SENSOR

pytestmark = [pytest.mark.ros, pytest.mark.graph]

FOLDER = Path(__file__).parents[3] / "examples" / "textbook"
needs_types = pytest.mark.skipif(bool(missing_types()), reason=missing_types() or "built")
START_TIME, ANSWER_TIME = 300.0, 180.0
"""Longest waits for standing robots and for an effect [s]: other programs may use the processor."""


class Robot:
    """What a student sees of one robot."""

    def __init__(self, graph: Graph, namespace: str = "") -> None:
        self.graph, self.namespace = graph, namespace
        self.joints: dict[str, float] = {}
        self.truth = np.full(7, np.nan)
        self.refusals = ""
        listen = graph.node.create_subscription
        self._subscriptions = (
            listen(JointState, "joint_states", self._on_joints, 10),
            listen(Odometry, topics.GROUND_TRUTH, self._on_truth, SENSOR, raw=True),
            listen(DiagnosticStatus, topics.REFUSALS, self._on_refusal, LATCHED),
        )

    def close(self) -> None:
        """Destroy the subscriptions."""
        for subscription in self._subscriptions:
            self.graph.node.destroy_subscription(subscription)

    def _on_joints(self, message: JointState) -> None:
        self.joints = dict(zip(message.name, message.position, strict=True))

    def _on_truth(self, data: bytes) -> None:
        self.truth = OdometryCodec().decode(data)[1]

    def _on_refusal(self, message: DiagnosticStatus) -> None:
        self.refusals += f"{message.message}\n{message.values}\n"

    @property
    def yaw(self) -> float:
        """True heading of the base [rad]."""
        x, y, z, w = self.truth[3:7]
        return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


class Robots(list[Robot]):
    """The robots of one graph, or of several in one world."""

    def __init__(self, running: Graph | WorldGraph) -> None:
        graphs = running.graphs if isinstance(running, WorldGraph) else {"": running}
        super().__init__(Robot(graph, name) for name, graph in graphs.items())
        self._running = running
        self.until(lambda robot: bool(robot.joints) and not np.isnan(robot.truth).any(), "publishing")

    def spin(self, duration: float) -> None:
        """Serve callbacks for a time [s]."""
        self._running.spin(duration)

    def until(self, condition: Callable[[Robot], bool], what: str) -> None:
        """Wait until a condition has held of each robot once."""
        left = list(self)

        def each() -> bool:
            left[:] = [robot for robot in left if not condition(robot)]
            return not left

        self._running.wait_for(each, ANSWER_TIME, what)

    def until_standing(self) -> None:
        """Wait until all stand."""
        self._running.wait_for(lambda: all(robot.graph.standing for robot in self), ANSWER_TIME, "standing")

    @contextmanager
    def program(self, name: str, folder: Path) -> Iterator[Callable[[Robot], str]]:
        """The same textbook node for each robot, in its namespace.

        Yields a function that returns the output of a robot's node.
        """
        logs = {robot: folder / f"{name}{robot.namespace}" for robot in self}
        with ExitStack() as ending:
            for robot, log in logs.items():
                command = [sys.executable, str(FOLDER / f"{name}.py"), "--ros-args", "-r", f"__ns:=/{robot.namespace}"]
                with log.open("wb") as output:
                    process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT)
                ending.callback(process.wait, 30.0)
                ending.callback(process.send_signal, signal.SIGINT)
            yield lambda robot: logs[robot].read_text()


def repeat(graph: Graph, act: Callable[[], object], done: Callable[[], bool], what: str) -> None:
    """Act, again every 10 s, until a condition is met: what is sent before discovery is lost."""
    for _ in range(9):
        act()
        with suppress(PoiseError):
            return graph.wait_for(done, 10.0, what)
    graph.wait_for(done, 10.0, what)


@pytest.fixture(scope="module", params=["one", pytest.param("two", marks=pytest.mark.slow)])
def robots(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robots]:
    """The robot of this folder, or two in their namespaces."""
    if request.param == "one":
        graph = request.getfixturevalue("running").graph
        graph.wait_standing(START_TIME)
        one = Robots(graph)
        yield one
        for robot in one:
            robot.close()
        return
    log = tmp_path_factory.mktemp("graph") / "log"
    os.environ["ROS_LOG_DIR"] = str(log.parent)
    pair = {name: Inhabitant("g1") for name in ("robot_1", "robot_2")}
    with WorldGraph(pair, domain_id=free_domain(), log=log, say=lambda text: None) as world:
        world.wait_standing(START_TIME)
        yield Robots(world)
    assert set(world.exit_codes.values()) <= {0}


def test_every_textbook_node_is_short() -> None:
    files = sorted(FOLDER.glob("*.py"))
    assert len(files) >= 8
    assert {
        path.name: len(path.read_text().splitlines()) for path in files if len(path.read_text().splitlines()) >= 40
    } == {}


def test_the_page_names_every_textbook_node_and_files_that_exist() -> None:
    root = FOLDER.parents[1]
    page = (root / "docs" / "textbook.md").read_text()
    assert [path.name for path in FOLDER.glob("*.py") if f"`{path.name.removesuffix('.py')}" not in page] == []
    assert [name for name in re.findall(r"(?:examples|tests)/[\w/.]+\.py", page) if not (root / name).is_file()] == []


def test_joint_commands_at_50_hz_move_an_arm(robots: Robots, tmp_path: Path) -> None:
    before = {robot: (robot.joints["left_elbow_joint"], robot.truth[:3].copy()) for robot in robots}
    with robots.program("arm_commands", tmp_path):
        robots.until(lambda robot: abs(robot.joints["left_elbow_joint"] - before[robot][0]) > 0.3, "moving the elbow")
    assert all(np.linalg.norm(robot.truth[:3] - before[robot][1]) < 0.05 for robot in robots)  # they balance meanwhile
    robots.until_standing()


def test_the_imu_logger_logs_an_upright_robot(robots: Robots, tmp_path: Path) -> None:
    with robots.program("imu_logger", tmp_path) as output:
        robots.until(lambda robot: "roll" in output(robot), "logging")
    for robot in robots:
        words = next(line for line in output(robot).splitlines() if "roll" in line).split()
        assert all(abs(float(words[words.index(name) + 1])) < 0.05 for name in ("roll", "pitch", "yaw"))


@needs_types
def test_a_plan_to_a_target_is_executed(robots: Robots, tmp_path: Path) -> None:
    before = {robot: dict(robot.joints) for robot in robots}
    with robots.program("plan_client", tmp_path) as output:
        robots.until(lambda robot: "accepted: left_hand reaches the target" in output(robot), "answering")
        robots.until(
            lambda robot: max(abs(angle - before[robot][name]) for name, angle in robot.joints.items()) > 0.2,
            "reaching",
        )
    robots.until_standing()


def test_the_humanoid_controller_waves(robots: Robots, tmp_path: Path) -> None:
    """The graph waves on the same word: the trajectory is executed, or refused with the reason."""
    extremes = {robot: [math.inf, -math.inf] for robot in robots}

    def waved(robot: Robot) -> bool:
        angle, seen = robot.joints["right_shoulder_roll_joint"], extremes[robot]
        seen[:] = min(seen[0], angle), max(seen[1], angle)
        return seen[1] - seen[0] > 0.3

    with robots.program("humanoid_controller", tmp_path) as output:
        robots.until(lambda robot: robot.graph.node.count_subscribers("humanoid_commands") > 1, "subscribing")
        robots.spin(0.5)
        for robot in robots:
            send = partial(robot.graph.send, "wave")
            repeat(robot.graph, send, lambda robot=robot: "waving with 29 joints" in output(robot), "receiving it")
        robots.until(waved, "waving")
    for robot in robots:
        robot.graph.send("stop")
    robots.until_standing()


def test_a_scan_in_an_unknown_frame_is_refused_by_name(robots: Robots, tmp_path: Path) -> None:
    with robots.program("fake_scan", tmp_path):
        robots.until(lambda robot: "header.frame_id: 'laser_frame' instead of" in robot.refusals, "refusing")


def test_the_scan_reader_walks_and_its_end_ends_in_a_stand(robots: Robots, tmp_path: Path) -> None:
    start = {robot: robot.truth[:2].copy() for robot in robots}
    with robots.program("scan_reader", tmp_path):
        robots.until(lambda robot: float(np.linalg.norm(robot.truth[:2] - start[robot])) > 0.2, "walking")
    robots.until_standing()


@needs_types
def test_words_become_velocities_and_two_integers_are_added(robots: Robots, tmp_path: Path) -> None:
    adder = interface("example_interfaces", "srv", "AddTwoInts")
    words = {robot: robot.graph.node.create_publisher(String, "text", 10) for robot in robots}
    clients = {robot: robot.graph.node.create_client(adder, "add_two_ints") for robot in robots}
    heading = {robot: robot.yaw for robot in robots}
    with robots.program("text_commander", tmp_path):
        robots.until(lambda robot: bool(clients[robot].service_is_ready()), "offering add_two_ints")
        for robot, client in clients.items():
            sums: list[int] = []

            def ask(client: Any = client, sums: list[int] = sums) -> None:
                answer = client.call_async(adder.Request(a=2, b=3))
                answer.add_done_callback(lambda done: sums.append(done.result().sum))

            repeat(robot.graph, ask, lambda sums=sums: bool(sums), "adding")
            assert set(sums) == {5}
        for turning in robots:  # one after the other: a word reaches the robot of its namespace alone
            others = {robot: robot.yaw for robot in robots if robot is not turning}
            spin = partial(words[turning].publish, String(data="spin"))
            repeat(turning.graph, spin, lambda turning=turning: abs(turning.yaw - heading[turning]) > 0.3, "turning")
            words[turning].publish(String(data="stop"))
            robots.until_standing()
            assert all(abs(robot.yaw - before) < 0.1 for robot, before in others.items())
