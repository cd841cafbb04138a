"""Estimator and controller as nodes, beside a world of a few topics: what comes too early, too late, or twice."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from controllers.nodes.balance_controller import BalanceControllerNode
from controllers.nodes.state_estimator import StateEstimatorNode
from models.nodes import topics
from models.nodes.messages import JointStateCodec, trajectory_to_message
from models.nodes.qos import EVENT, LATCHED, SENSOR_RELIABLE
from models.robot_model import RobotModel
from models.types import ContactState, RobotState
from models.types import JointTrajectory as Trajectory

pytestmark = pytest.mark.ros


def test_a_sample_before_activation_is_passed_over(bench: Any, g1: RobotModel) -> None:
    states: list[RobotState] = []

    def make(**kwargs: Any) -> StateEstimatorNode:
        return StateEstimatorNode(lambda state, stamp: states.append(state), **kwargs)

    node = bench.add(make, active=False, lockstep=True)
    publisher = bench.world.create_publisher(JointState, topics.JOINT_STATES, SENSOR_RELIABLE)
    bench.wait(lambda: publisher.get_subscription_count() == 1)
    codec, zero = JointStateCodec(g1), np.zeros(g1.nj)
    publisher.publish(codec.encode(1_000_000, g1.posture("stand"), zero, zero))
    bench.spin(0.3)
    node.trigger_activate()
    for size in (0, 6, 11):  # shorter than a stamp: refused, and the process lives
        node._on_joints(codec.encode(0, zero, zero, zero)[:size])
    assert node.counters[f"refused {topics.JOINT_STATES}"] == 3
    assert states == []


class Controlled:
    """A controller that stands, and what it says about motions."""

    def __init__(self, bench: Any, g1: RobotModel) -> None:
        self.bench, self.model, self.stamp = bench, g1, 0
        self.said: list[str] = []
        world = bench.world
        self.mode = world.create_publisher(String, topics.MODE, LATCHED)
        self.request = world.create_publisher(String, topics.MOTION_REQUEST, EVENT)
        self.plan = world.create_publisher(JointTrajectory, topics.MOTION_TRAJECTORY, EVENT)
        world.create_subscription(String, topics.MOTION_STATE, lambda m: self.said.append(m.data), EVENT)
        self.node = bench.add(lambda **kwargs: BalanceControllerNode(local=True, **kwargs))
        for publisher in (self.mode, self.request, self.plan):
            bench.wait(lambda publisher=publisher: publisher.get_subscription_count() == 1)
        self.set_mode("stand")
        foot = ContactState(True, np.array([0.0, 0.0, 0.5 * 9.81 * g1.mass, 0.0, 0.0, 0.0]))
        self.state = RobotState(0.0, g1.standing_configuration(), np.zeros(g1.nv), np.zeros(g1.nj), (foot, foot))
        self.tick()

    def tick(self) -> None:
        self.stamp += 1_000_000
        self.node.on_state(self.state, self.stamp)

    def set_mode(self, mode: str) -> None:
        self.mode.publish(String(data=mode))
        self.bench.wait(lambda: self.node._mode.value == mode)

    def ask(self, request: str) -> None:
        self.request.publish(String(data=request))
        self.bench.wait(lambda: self.node._requested == request)

    def answer(self, request: str) -> str:
        """Publish a plan from the present posture to itself as the answer to a request; what is said about it."""
        start = self.node._law.reference.posture
        plan = trajectory_to_message(Trajectory(self.model.joint_names, np.array([0.0, 1.0]), np.array([start, start])))
        plan.header.frame_id = request
        self.said.clear()
        self.plan.publish(plan)
        self.bench.wait(lambda: self.said)
        return self.said[0]


def test_a_plan_that_comes_too_late_is_dropped(bench: Any, g1: RobotModel) -> None:
    """Stopped while it was planned, given up, or overtaken by another request."""
    robot = Controlled(bench, g1)
    robot.set_mode("motion")
    robot.ask("wave 1")
    robot.ask(topics.STOP_MOTION)
    robot.set_mode("stand")
    assert "came too late" in robot.answer("wave 1")
    robot.set_mode("motion")
    robot.ask("wave 2")
    robot.set_mode("stand")  # the supervisor waited no longer
    assert "came too late" in robot.answer("wave 2")
    robot.set_mode("motion")
    robot.ask("squat 3")
    assert "came too late" in robot.answer("wave 2")
    assert not robot.node._law.motion_active
    assert robot.answer("squat 3") == topics.MOTION_RUNNING
    assert robot.node._law.motion_active
