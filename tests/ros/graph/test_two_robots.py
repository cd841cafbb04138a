"""Two robots in one world over ROS 2 in lockstep, each with its graph in its own processes and namespace."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock

from bridge.launch.world import Inhabitant, WorldGraph
from bridge.record.run_file import read_run
from bridge.ros.environment import free_domain
from models.nodes import topics
from models.nodes.odometry import OdometryCodec, velocity_to_twist
from models.nodes.qos import COMMAND, EVENT, SENSOR

pytestmark = [pytest.mark.ros, pytest.mark.slow]

NAMES = ("robot_1", "robot_2")
OF_ALL = {"/parameter_events", "/rosout", "/clock"}
"""Topics outside the robots' namespaces: rclpy's and the world's."""


class Pair:
    """What the tests see of two robots."""

    def __init__(self, world: WorldGraph) -> None:
        self.world = world
        self.graphs = [world.graphs[name] for name in NAMES]
        self.truth: dict[str, np.ndarray] = {}
        self.velocities = {}
        for name, graph in zip(NAMES, self.graphs, strict=True):
            graph.node.create_subscription(
                Odometry, topics.GROUND_TRUTH, lambda data, name=name: self._on_truth(name, data), SENSOR, raw=True
            )
            self.velocities[name] = graph.node.create_publisher(Twist, topics.CMD_VEL, COMMAND)

    def _on_truth(self, name: str, data: bytes) -> None:
        self.truth[name] = OdometryCodec().decode(data)[1]

    def places(self) -> dict[str, np.ndarray]:
        """True position of each base (3,)."""
        self.truth.clear()
        self.world.wait_for(lambda: len(self.truth) == len(NAMES), 20.0, "publishing where they are")
        return {name: pose[:3].copy() for name, pose in self.truth.items()}

    def poise(self, *arguments: str) -> tuple[int, str]:
        """Exit code and output of the command line, in a process of its own."""
        line = [sys.executable, "-c", "from bridge.cli import app; app()", *arguments]
        process = subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        self.world.wait_for(lambda: process.poll() is not None, 60.0, "answering the command line")
        return process.returncode, process.communicate()[0]

    def drive(self, velocities: dict[str, tuple[float, float, float]]) -> None:
        """Command a velocity of each."""
        for name, velocity in velocities.items():
            self.velocities[name].publish(velocity_to_twist(velocity))

    def walk(self, velocities: dict[str, tuple[float, float, float]], least: float) -> None:
        """Have some walk for at least so far each, then stand [m]."""
        start = self.places()
        for name in velocities:
            assert self.world.graphs[name].call("mode/walk")[0]
        self.world.wait_for(lambda: all(self.world.graphs[n].mode == "walk" for n in velocities), 20.0, "in mode walk")

        def there() -> bool:
            self.drive(velocities)
            return all(np.linalg.norm(self.truth[name][:2] - start[name][:2]) > least for name in velocities)

        self.world.wait_for(there, 120.0, f"{least} m away")
        for name in velocities:
            assert self.world.graphs[name].call("mode/stand")[0]
        self.world.wait_for(lambda: all(graph.mode == "stand" for graph in self.graphs), 60.0, "standing again")


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Pair]:
    log = tmp_path_factory.mktemp("pair") / "log"
    os.environ["ROS_LOG_DIR"] = str(log.parent)
    robots = {name: Inhabitant("g1") for name in NAMES}
    with WorldGraph(robots, lockstep=True, domain_id=free_domain(), log=log, say=lambda text: None) as world:
        world.wait_standing(120.0)
        yield Pair(world)
        pids = list(world.pids.values())
    assert set(world.exit_codes.values()) == {0} and len(world.exit_codes) == 7
    assert not [pid for pid in pids if Path(f"/proc/{pid}").exists()]


def test_each_has_all_of_its_topics_and_services_in_its_namespace(pair: Pair) -> None:
    node = pair.graphs[0].node
    names = {name for name, _ in node.get_topic_names_and_types()} - OF_ALL
    names |= {name for name, _ in node.get_service_names_and_types()}
    for robot in NAMES:
        expected = {"joint_states", "clock", "tf", "diagnostics", "mode/walk", "reset"}
        assert {f"/{robot}/{name}" for name in expected} <= names
    assert not [name for name in names if not name.startswith(tuple(f"/{robot}/" for robot in NAMES))]
    assert node.count_publishers("/clock") == 1
    assert node.count_publishers("/robot_2/clock") == 1
    places = pair.places()
    assert places["robot_2"][1] - places["robot_1"][1] == pytest.approx(1.5, abs=0.02)


def test_there_is_one_time(pair: Pair) -> None:
    received: dict[str, list[int]] = {}
    subscriptions = []
    for graph, topic in ((pair.graphs[0], "clock"), (pair.graphs[1], "clock"), (pair.graphs[1], topics.CLOCK)):
        kept = received.setdefault(graph.node.resolve_topic_name(topic), [])
        take = lambda m, kept=kept: kept.append(m.clock.sec * 10**9 + m.clock.nanosec)  # noqa: E731
        subscriptions.append((graph.node, graph.node.create_subscription(Clock, topic, take, SENSOR)))
    pair.world.wait_for(lambda: all(len(stamps) > 20 for stamps in received.values()), 20.0, "publishing the time")
    assert len(received) == 3
    assert set.intersection(*map(set, received.values()))
    latest = [stamps[-1] for stamps in received.values()]
    assert max(latest) - min(latest) <= 100_000_000  # [ns] what was on its way
    for node, subscription in subscriptions:
        node.destroy_subscription(subscription)


def test_commands_to_one_leave_the_other_alone(pair: Pair) -> None:
    first, second = pair.graphs
    before = pair.places()["robot_2"]
    code, output = pair.poise("send", "wave", "--namespace", "robot_1")
    assert code == 0, output
    pair.world.wait_for(lambda: first.mode == "motion", 20.0, "waving")
    assert second.mode == "stand"
    pair.world.wait_for(lambda: first.mode == "stand", 60.0, "done")
    assert np.linalg.norm(pair.places()["robot_2"] - before) < 0.005
    assert second.driver_state == topics.ACTIVE


def test_a_second_clock_is_noticed_by_the_supervisor_that_it_concerns(pair: Pair) -> None:
    reported: dict[str, str] = {}
    for graph in pair.graphs:
        graph.node.create_subscription(
            DiagnosticArray, "diagnostics", lambda m: reported.update({s.name: s.message for s in m.status}), EVENT
        )
    publisher = pair.graphs[1].node.create_publisher(Clock, "clock", SENSOR)
    intruder = "'/robot_2/clock' has a second publisher"
    pair.world.wait_for(lambda: intruder in reported.get("/robot_2/supervisor", ""), 20.0, "reporting a second clock")
    assert "second publisher" not in reported["/robot_1/supervisor"]
    pair.graphs[1].node.destroy_publisher(publisher)
    pair.world.spin(0.5)  # they are counted five times a second
    assert pair.graphs[1].call("reset_faults")[0]
    assert pair.graphs[0].mode == pair.graphs[1].mode == "stand"


def test_the_command_line_speaks_to_the_one_that_is_named(pair: Pair) -> None:
    code, output = pair.poise("mode", "walk", "--namespace", "robot_1")
    assert code == 0, output
    pair.world.wait_for(lambda: pair.graphs[0].mode == "walk", 20.0, "in mode walk")
    assert pair.graphs[1].mode == "stand"
    assert pair.graphs[0].call("mode/stand")[0]
    pair.world.wait_for(lambda: pair.graphs[0].mode == "stand", 20.0, "standing")
    code, output = pair.poise("mode", "stand")
    assert code == 2 and "no service mode/stand" in output  # without a namespace there is no robot
    assert "robots are up in /robot_1, /robot_2: give --namespace" in output


def test_a_recording_of_one_is_as_that_of_a_robot_alone(pair: Pair, tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    code, output = pair.poise("record", "--out", str(file), "--seconds", "0.5", "--namespace", "robot_2")
    assert code == 0, output
    assert "/joint_states" in output and "robot_2" not in output
    run = read_run(file)
    assert run.robot.name == "g1" and len(run.joints) >= 500 and run.lost == 0
    base = next(iter(run.truths.values()))[0]
    assert base[1] == pytest.approx(pair.places()["robot_2"][1], abs=0.01)


def test_both_walk_two_metres_at_velocities_of_their_own(pair: Pair) -> None:
    before = pair.places()
    pair.walk({"robot_1": (0.4, 0.0, 0.0), "robot_2": (0.3, 0.0, 0.05)}, 2.0)
    after = pair.places()
    assert after["robot_1"][0] - before["robot_1"][0] > after["robot_2"][0] - before["robot_2"][0]
    for name, graph in zip(NAMES, pair.graphs, strict=True):
        assert after[name][2] > 0.7  # [m] and stands
        assert (graph.mode, graph.driver_state) == ("stand", topics.ACTIVE)


def test_a_reset_of_one_leaves_the_other_standing(pair: Pair) -> None:
    first, second = pair.graphs
    before = pair.places()["robot_2"]
    assert first.call("reset")[0]
    pair.world.wait_for(lambda: first.driver_state == topics.HELD, 20.0, "held again")
    pair.world.spin(1.0)
    after = pair.places()
    assert np.linalg.norm(after["robot_1"][:2]) < 0.05  # [m] where it began
    assert np.linalg.norm(after["robot_2"] - before) < 0.005
    assert (second.mode, second.driver_state) == ("stand", topics.ACTIVE)
