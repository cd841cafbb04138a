"""Nodes under test in this process, beside a node that plays the rest of the graph; and the real graph, watched."""

import gc
import os
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
import yaml
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from bridge.launch.graph import Graph
from bridge.ros.environment import free_domain, join_graph
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.odometry import OdometryCodec
from models.nodes.qos import COMMAND, EVENT, SENSOR
from models.nodes.status import StatusMessage, status_to_message
from models.robot_model import RobotModel
from models.status import Status

STAMP = 12_345_678_901
"""Of made-up messages [ns]."""


class Bench:
    """Executor with nodes under test and ``world``, which plays everybody else.

    Args:
        context: ROS context of its own.
    """

    def __init__(self, context: Context) -> None:
        self.context = context
        self.world = Node("world", context=context)
        self._nodes: list[Any] = []
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self.world)

    def add(
        self, kind: Callable[..., Any], *, active: bool = True, configured: bool = True, **parameters: object
    ) -> Any:
        """Create a node, configured, and activated when ``active``."""
        arguments = ["--ros-args"]
        for name, value in parameters.items():
            arguments += ["-p", f"{name}:={value}"]
        node = kind(context=self.context, cli_args=arguments)
        self._nodes.append(node)
        self._executor.add_node(node)
        if configured:
            node.trigger_configure()
        if configured and active:
            node.trigger_activate()
        return node

    def remove(self, node: Any) -> None:
        """Destroy a node under test."""
        self._nodes.remove(node)
        self._executor.remove_node(node)
        node.destroy_node()

    def spin(self, duration: float) -> None:
        """Serve callbacks for a time [s]."""
        end = time.monotonic() + duration
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.01)

    def wait(self, condition: Callable[[], object], timeout: float = 10.0) -> None:
        """Serve callbacks until a condition holds."""
        end = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < end, "it did not happen in time"
            self._executor.spin_once(timeout_sec=0.01)

    def close(self) -> None:
        """Destroy every node."""
        for node in list(self._nodes):
            self.remove(node)
        self._executor.remove_node(self.world)
        self.world.destroy_node()
        self._executor.shutdown()


@pytest.fixture
def bench(ros_domain_id: int, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    """A bench in a ROS domain of its own, on loopback."""
    gc.collect()  # the context of the test before: of 32 participants in one process the next would not be discovered
    gc.freeze()  # else every collection, one with each diagnostics of a node, searches all imported modules
    monkeypatch.setattr(gc, "freeze", lambda: None)  # active nodes would exempt themselves, and only
    monkeypatch.setattr(gc, "unfreeze", lambda: None)  # a search of all modules would find them again
    join_graph()
    context = Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    made = Bench(context)
    yield made
    made.close()
    context.try_shutdown()
    gc.enable()


@pytest.fixture
def values(g1: RobotModel) -> np.ndarray:
    """Made-up values of three kinds for every joint (3, nj)."""
    return np.random.default_rng(1).normal(size=(3, g1.nj))


@pytest.fixture
def barefoot(g1: RobotModel, tmp_path: Path) -> Path:
    """Profile of a G1 without foot sensors."""
    profile = yaml.safe_load(Path(g1.profile.source).read_text(encoding="utf-8"))
    profile["sensors"]["feet"]["fitted"] = False
    path = tmp_path / "barefoot.yaml"
    path.write_text(yaml.safe_dump(profile), encoding="utf-8")
    return path


class StatusTopic:
    """Publisher of status records."""

    def __init__(self, node: Any, topic: str, qos: Any = EVENT) -> None:
        self._publisher = node.create_publisher(StatusMessage, topic, qos)
        self.get_subscription_count = self._publisher.get_subscription_count

    def publish(self, record: Status, **changed: object) -> None:
        """Publish a record; ``changed`` are fields with a value, or of a type, that the record does not have."""
        message = status_to_message(record, "/test", Time())
        for item in message.changed_parameters:
            if item.name in changed:
                item.value = Parameter(item.name, value=changed[item.name]).to_parameter_msg().value
        self._publisher.publish(message)


CONTROL_NODES = ("balance_controller", "state_estimator", "gait_planner", "supervisor", "motion_planner")


class Eyes:
    """What the tests see of the graph.

    Attributes:
        stamp: Stamp of the last true state [ns].
        truth_readers: Nodes of control that have subscribed to the true state.
        control_topics: Topics to which nodes of control have subscribed.
        log: What the processes print; optional.
    """

    def __init__(self, graph: Graph, log: Path | None = None) -> None:
        self.graph, self.log = graph, log
        self.truth: list[np.ndarray] = []
        self.stamp = 0
        self.posture = b""
        self.joints = b""
        self.motion: list[str] = []
        self.reports: dict[str, dict[str, str]] = {}
        self.truth_readers: set[str] = set()
        self.control_topics: set[str] = set()
        listen = graph.node.create_subscription
        listen(Odometry, topics.GROUND_TRUTH, self._on_truth, SENSOR, raw=True)
        listen(JointState, topics.POSTURE, self._on_posture, SENSOR, raw=True)
        listen(String, topics.MOTION_STATE, lambda message: self.motion.append(message.data), EVENT)
        listen(String, topics.MOTION_PLAN_STATE, lambda message: self.motion.append(message.data), EVENT)
        listen(DiagnosticArray, "/diagnostics", self._on_diagnostics, EVENT)
        self.commands = graph.node.create_publisher(JointTrajectory, topics.JOINT_SETPOINTS, COMMAND)
        self.motions = graph.node.create_publisher(JointTrajectory, topics.MOTION_TRAJECTORY, EVENT)

    def _on_truth(self, data: bytes) -> None:
        self.stamp, pose, _ = OdometryCodec().decode(data)
        self.truth.append(pose)

    def _on_posture(self, data: bytes) -> None:
        self.posture = data

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.reports[status.name] = {"message": status.message, **{item.key: item.value for item in status.values}}

    def ask(self, service: str, attempts: int = 3) -> tuple[bool, str]:
        """Answer of a service that can be called twice without harm: under load its reply may get lost."""
        for _ in range(attempts - 1):
            with suppress(PoiseError):
                return self.graph.call(service)
        return self.graph.call(service)

    def publisher(self, kind: type, topic: str) -> Any:
        """A publisher on a topic, once its reader is matched: before, the reader receives nothing."""
        publisher = self.graph.node.create_publisher(kind, topic, EVENT)
        self.graph.wait_for(lambda: publisher.get_subscription_count() > 0, 10.0, f"listening to {topic}")
        self.graph.spin(1.0)
        return publisher

    def note_subscriptions(self) -> None:
        """Add the present subscriptions of the nodes of control to ``truth_readers`` and ``control_topics``."""
        node = self.graph.node
        truth = node.get_subscriptions_info_by_topic(f"/{topics.GROUND_TRUTH}")
        self.truth_readers.update(info.node_name for info in truth if info.node_name in CONTROL_NODES)
        for name in set(CONTROL_NODES) & set(node.get_node_names()):
            self.control_topics.update(topic for topic, _ in node.get_subscriber_names_and_types_by_node(name, "/"))

    def check_truth(self) -> None:
        """Assert that, from the first step to the end of a motion, no node of control has read the true state."""

        def reached(mode: str) -> bool:
            self.note_subscriptions()
            return self.graph.mode == mode

        self.graph.send("bow")
        for mode in ("motion", "stand"):
            self.graph.wait_for(partial(reached, mode), 120.0, mode)
        assert set(CONTROL_NODES) <= set(self.graph.node.get_node_names())
        needed = {f"/{topic}" for topic in (topics.JOINT_STATES, topics.IMU_RAW, topics.MODE)}
        self.graph.wait_for(lambda: reached("stand") and needed <= self.control_topics, 60.0, "subscribing")
        assert self.truth_readers == set()
        assert not [topic for topic in self.control_topics if "truth" in topic]
        for module, pid in self.graph.pids.items():
            linked = "libmujoco" in Path(f"/proc/{pid}/maps").read_text(encoding="utf-8")
            assert linked == (module == "bridge.nodes.robot_driver")

    @contextmanager
    def beside_the_robot(self, kind: type, topic: str) -> Iterator[Any]:
        """A second publisher on a sensor's topic; the fault that the supervisor latches is reset afterwards."""
        publisher = self.graph.node.create_publisher(kind, topic, SENSOR)
        yield publisher
        reported = f"'/{topic}' has a second publisher"
        self.graph.wait_for(lambda: reported in self.reports["/supervisor"]["message"], 5.0, "reporting two publishers")
        self.graph.node.destroy_publisher(publisher)
        self.graph.spin(0.5)  # they are counted five times a second
        assert self.ask("reset_faults")[0]

    def refusal(self, node: str, topic: str, act: Callable[[], object], culprit: str) -> None:
        """Do something until a node reports a new refusal on a topic that names the culprit."""
        key = f"refused {topic}"
        before = int(self.reports.get(f"/{node}", {}).get(key, "0"))

        def refused() -> bool:
            act()
            report = self.reports.get(f"/{node}", {})
            return int(report.get(key, "0")) > before and culprit in report["last refusal"]

        self.graph.wait_for(refused, 5.0, f"refused by {node} with '{culprit}'")


@contextmanager
def standing_graph(folder: Path, **options: Any) -> Iterator[Eyes]:
    """A graph that stands, with options of ``Graph``; all of its processes end with exit code 0."""
    log = folder / "log"
    os.environ["ROS_LOG_DIR"] = str(folder)
    with Graph("g1", domain_id=free_domain(), log=log, say=lambda text: None, **options) as graph:
        seen = Eyes(graph, log)

        def standing() -> bool:
            seen.note_subscriptions()
            return graph.standing

        graph.wait_for(standing, 90.0, "standing")
        graph.wait_for(lambda: bool(seen.posture) and len(seen.reports) >= 5, 10.0, "reporting")
        yield seen
        pids = list(graph.pids.values())
    assert graph.exit_codes == dict.fromkeys(graph.pids, 0)
    assert not [pid for pid in pids if Path(f"/proc/{pid}").exists()]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """The report of a failed test has the warnings and errors of its graph, and the last lines of its log."""
    report = yield
    seen = getattr(item, "funcargs", {}).get("eyes")
    if report.failed and isinstance(seen, Eyes) and seen.log is not None:
        lines = seen.log.read_text(encoding="utf-8", errors="replace").splitlines()
        grave = [line for line in lines[:-40] if "[WARN]" in line or "[ERROR]" in line]
        report.sections.append(("log of the graph", "\n".join(grave[-40:] + lines[-40:])))
    return report


OPTIONS = ("PROCESSES", "PARAMETERS")  #: Variables of a module that ``eyes`` reads


@pytest.fixture(scope="module")
def eyes(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Eyes]:
    """A graph that stands, of the processes and with the parameters that ``PROCESSES`` and ``PARAMETERS`` name."""
    options = {name.lower(): getattr(request.module, name) for name in OPTIONS if hasattr(request.module, name)}
    with standing_graph(tmp_path_factory.mktemp("graph"), **options) as seen:
        yield seen


@pytest.fixture
def undisturbed(eyes: Eyes) -> Iterator[None]:
    """The robot neither moves nor changes its mode meanwhile."""
    eyes.graph.spin(0.05)  # what an earlier test has caused is received
    eyes.truth.clear()
    yield
    begin = eyes.stamp
    eyes.graph.wait_for(lambda: eyes.stamp - begin > 10**8, 20.0, "publishing the truth")
    path = np.array(eyes.truth)[:, :3]
    assert np.ptp(path, axis=0).max() < 0.005  # [m]
    assert (eyes.graph.mode, eyes.graph.driver_state) == ("stand", "active")
