"""Estimator and controller as nodes, beside a world of a few topics: what comes too early, too late, or twice."""

import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from msgspec.structs import replace
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from controllers.nodes import motion_topics
from controllers.nodes.balance_controller import BalanceControllerNode
from controllers.nodes.state_estimator import StateEstimatorNode
from controllers.stack import ControlStack
from models.nodes import realtime, topics
from models.nodes.base import ALARM_PERIOD
from models.nodes.messages import JointStateCodec, trajectory_to_message
from models.nodes.qos import EVENT, LATCHED, STATE
from models.robot_model import RobotModel
from models.types import ControlResult, RobotState, SolveStatus
from models.types import JointTrajectory as Trajectory
from tests.ros.delivery import deliver
from tests.support import standing

pytestmark = pytest.mark.ros


def test_a_sample_before_activation_is_passed_over(bench: Any, g1: RobotModel) -> None:
    states: list[RobotState] = []

    def make(**kwargs: Any) -> StateEstimatorNode:
        return StateEstimatorNode(lambda state, stamp: states.append(state), **kwargs)

    node = bench.add(make, active=False, lockstep=True)
    publisher = bench.world.create_publisher(JointState, topics.JOINT_STATES, STATE)
    bench.wait(lambda: publisher.get_subscription_count() == 1)
    codec, zero = JointStateCodec(g1), np.zeros(g1.nj)
    publisher.publish(codec.encode(1_000_000, g1.posture("stand"), zero, zero))
    bench.spin(0.3)
    node.trigger_activate()
    for size in (0, 6, 11):  # shorter than a stamp: refused, and the process lives
        deliver(node, topics.JOINT_STATES, codec.encode(0, zero, zero, zero)[:size])
    assert node.counters[f"refused {topics.JOINT_STATES}"] == 3
    assert states == []


class Controlled:
    """A controller that stands, and what it says about motions."""

    def __init__(self, bench: Any, g1: RobotModel, **parameters: object) -> None:
        self.bench, self.model, self.stamp = bench, g1, 0
        self.said: list[str] = []
        world = bench.world
        self.mode = world.create_publisher(String, topics.MODE, LATCHED)
        self.request = world.create_publisher(String, topics.MOTION_REQUEST, EVENT)
        self.plan = world.create_publisher(JointTrajectory, topics.MOTION_TRAJECTORY, EVENT)
        world.create_subscription(String, topics.MOTION_STATE, lambda m: self.said.append(m.data), EVENT)
        self.node = bench.add(lambda **kwargs: BalanceControllerNode(ControlStack(), **kwargs), **parameters)
        for publisher in (self.mode, self.request, self.plan):
            bench.wait(lambda publisher=publisher: publisher.get_subscription_count() == 1)
        self.set_mode("stand")
        self.state = standing(g1)
        self.tick()

    def tick(self) -> None:
        self.stamp += 1_000_000
        self.node.on_state(self.state, self.stamp)

    def set_mode(self, mode: str) -> None:
        self.mode.publish(String(data=mode))
        self.bench.wait(lambda: self.node._mode.value == mode)

    def ask(self, request: str) -> None:
        self.request.publish(String(data=request))
        self.bench.wait(lambda: self.node._motions.requested == request)

    def answer(self, request: str) -> str:
        """Publish a plan from the present posture to itself as the answer to a request; what is said about it."""
        start = self.node._stack.law.reference.posture
        plan = trajectory_to_message(Trajectory(self.model.joint_names, np.array([0.0, 1.0]), np.array([start, start])))
        plan.header.frame_id = request
        self.said.clear()
        self.plan.publish(plan)
        self.bench.wait(lambda: self.said)
        return self.said[0]


@pytest.mark.parametrize(("mode", "end"), [("damp", "ended: mode 'damp'"), ("walk", "ended: mode 'walk'")])
def test_a_mode_that_ends_a_motion_is_its_reason(bench: Any, g1: RobotModel, mode: str, end: str) -> None:
    robot = Controlled(bench, g1)
    assert robot.answer("") == "running"
    robot.set_mode(mode)
    robot.tick()
    bench.wait(lambda: robot.said == ["running", end])


def test_ticks_over_their_budget_are_counted_and_reported_at_once(bench: Any, g1: RobotModel) -> None:
    statuses: list[tuple[float, dict[str, str]]] = []

    def receive(array: DiagnosticArray) -> None:
        statuses.extend((time.monotonic(), {item.key: item.value for item in status.values}) for status in array.status)

    bench.world.create_subscription(DiagnosticArray, "/diagnostics", receive, EVENT)
    robot = Controlled(bench, g1, diagnostics_period=10.0)
    bench.spin(0.3)
    robot.node._budget = 1e-5
    statuses.clear()
    for _ in range(19):
        robot.tick()
    bench.wait(lambda: statuses)
    assert statuses[0][1]["ticks over budget in a row"] in ("10", "20")
    assert int(statuses[0][1]["ticks over budget"]) >= 10
    robot.node._budget = 10.0
    robot.tick()
    assert robot.node._overruns == 0
    robot.set_mode("damp")
    robot.set_mode("stand")
    assert robot.node._result is None  # what was solved before says nothing about now


def test_a_status_that_flaps_does_not_flood_the_diagnostics(
    bench: Any, g1: RobotModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Alarms are rate-limited, and no garbage is collected within a tick."""
    robot = Controlled(bench, g1, diagnostics_period=10.0)
    node, published, collected = robot.node, [], []
    monkeypatch.setattr(node, "_diagnostics", SimpleNamespace(publish=published.append))
    monkeypatch.setattr(realtime, "collect", lambda: collected.append(True))
    step, count = node._stack.law.step, 0

    def flap(state: RobotState, dt: float) -> ControlResult:
        nonlocal count
        count += 1
        return replace(step(state, dt), status=SolveStatus.HELD if count % 2 else SolveStatus.OPTIMAL)

    monkeypatch.setattr(node._stack.law, "step", flap)
    begin = time.monotonic()
    for _ in range(200):
        robot.tick()
    assert node.counters["held"] == 100
    assert 1 <= len(published) <= 1 + (time.monotonic() - begin) / ALARM_PERIOD
    assert collected == []
    node._on_diagnostics_due()
    assert collected == [True]


def test_without_a_usable_state_the_drivers_are_left_to_damp(
    bench: Any, g1: RobotModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, sent = Controlled(bench, g1), []
    monkeypatch.setattr(robot.node, "_command", SimpleNamespace(publish=sent.append))
    robot.tick()
    robot.state = replace(robot.state, v=np.full(g1.nv, np.nan))
    while robot.node._result is None or robot.node._result.status is not SolveStatus.DAMPED:
        sent.clear()
        robot.tick()
    robot.tick()
    assert sent == []
    robot.state = standing(g1)
    robot.tick()
    assert len(sent) == 1


def test_a_trajectory_that_takes_too_long_to_read_is_refused_unread(
    bench: Any, g1: RobotModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = Controlled(bench, g1)
    robot.set_mode("stand")

    def read(*_: object) -> None:
        raise AssertionError("was read")

    with monkeypatch.context() as patch:
        patch.setattr(motion_topics, "decode", read)
        deliver(robot.node, topics.MOTION_TRAJECTORY, bytes(motion_topics.TRAJECTORY_BYTES_MAX + 1))
    assert "bytes, at most" in robot.node.values["last refusal"]
    deliver(robot.node, topics.MOTION_TRAJECTORY, bytes(motion_topics.TRAJECTORY_BYTES_MAX))
    assert "bytes, at most" not in robot.node.values["last refusal"]


def test_a_plan_that_comes_too_late_is_dropped(bench: Any, g1: RobotModel) -> None:
    """Stopped while it was planned, given up, or overtaken by another request."""
    robot = Controlled(bench, g1)
    robot.set_mode("motion")
    robot.ask("wave 1")
    robot.ask(topics.STOP_MOTION)
    robot.set_mode("stand")
    assert "arrived too late" in robot.answer("wave 1")
    robot.set_mode("motion")
    robot.ask("wave 2")
    robot.set_mode("stand")  # the supervisor waited no longer
    assert "arrived too late" in robot.answer("wave 2")
    robot.set_mode("motion")
    robot.ask("squat 3")
    assert "arrived too late" in robot.answer("wave 2")
    assert not robot.node._stack.law.motion_active
    assert robot.answer("squat 3") == "running"
    assert robot.node._stack.law.motion_active


def test_the_schedule_of_the_reference_goes_back_to_the_estimator(bench: Any, g1: RobotModel) -> None:
    robot = Controlled(bench, g1)
    assert robot.node._stack.scheduled == (True, True)
    robot.set_mode("damp")
    robot.tick()
    assert robot.node._stack.scheduled is None


def test_no_motion_is_followed_while_walking(bench: Any, g1: RobotModel) -> None:
    robot = Controlled(bench, g1)
    robot.set_mode("walk")  # without a gait planner the robot goes on standing
    robot.tick()
    assert "no trajectory in mode 'walk'" in robot.answer("")
    assert not robot.node._stack.law.motion_active


def test_a_controller_that_holds_the_robot_is_deactivated_by_force_only(bench: Any, g1: RobotModel) -> None:
    robot = Controlled(bench, g1)
    robot.node.trigger_deactivate()
    assert robot.node.active
    assert "the robot would fall in mode 'stand'" in robot.node.values["last refusal"]
    assert "force_deactivate true" in robot.node.values["last refusal"]
    robot.node.set_parameters([Parameter("force_deactivate", value=True)])
    robot.node.trigger_deactivate()
    assert not robot.node.active
