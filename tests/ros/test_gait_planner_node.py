"""The gait planner's node beside a world of a few topics: who may command a velocity, and for how long."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Twist, TwistStamped
from std_msgs.msg import String

from models.nodes import topics
from models.nodes.messages import set_stamp
from models.nodes.qos import COMMAND, EVENT, LATCHED
from models.nodes.velocity import velocity_to_twist
from models.robot_model import RobotModel
from models.types import ContactState, RobotState
from planners.nodes.gait_planner import GaitPlannerNode

pytestmark = pytest.mark.ros

MS = 1_000_000


class Commanded:
    """A gait planner whose robot stands on the spot, whatever it plans."""

    def __init__(self, bench: Any, g1: RobotModel) -> None:
        self.bench, self.model, self.stamp = bench, g1, 10**9
        self.phases: list[str] = []
        world = bench.world
        world.create_subscription(String, topics.GAIT_PHASE, lambda m: self.phases.append(m.data), LATCHED)
        self.mode = world.create_publisher(String, topics.MODE, LATCHED)
        self.cmd_vel = world.create_publisher(Twist, topics.CMD_VEL, COMMAND)
        self.stamped = world.create_publisher(TwistStamped, topics.CMD_VEL_STAMPED, COMMAND)
        self.request = world.create_publisher(Twist, topics.GAIT_VELOCITY, EVENT)
        self.node = bench.add(GaitPlannerNode)
        for publisher in (self.mode, self.cmd_vel, self.stamped, self.request):
            bench.wait(lambda publisher=publisher: publisher.get_subscription_count() >= 1)
        bench.wait(lambda: self.phases)
        self.node.tell(self.stamp)

    def enter(self, mode: str) -> None:
        """Change the mode; a walk begins as the controller begins it."""
        self.mode.publish(String(data=mode))
        self.bench.wait(lambda: self.node._velocities.mode == mode)
        if mode == "walk":
            self.node.reset(self.state)

    @property
    def state(self) -> RobotState:
        foot = ContactState(True, np.array([0.0, 0.0, 0.5 * 9.81 * self.model.mass, 0.0, 0.0, 0.0]))
        q, v = self.model.standing_configuration(), np.zeros(self.model.nv)
        return RobotState(1e-9 * self.stamp, q, v, np.zeros(self.model.nj), (foot, foot))

    def tick(self, ms: int) -> None:
        """Let time pass, in one tick."""
        self.stamp += ms * MS
        self.node.step(self.state, 1e-3 * ms)
        self.node.tell(self.stamp)

    @property
    def wanted(self) -> tuple[float, float, float]:
        """What the law has been told."""
        wanted: tuple[float, float, float] = self.node._law._limiter.wanted
        return wanted

    def publish(self, publisher: Any, message: Any) -> None:
        """Publish, and wait until it has been taken or refused."""

        def seen() -> tuple[object, ...]:
            command = self.node._command
            return sum(self.node.counters.values()), command._velocity, command._until

        before = seen()
        publisher.publish(message)
        self.bench.wait(lambda: seen() != before)

    def send(self, publisher: Any, message: Any) -> None:
        """Publish, and one tick."""
        self.publish(publisher, message)
        self.tick(1)

    def stamped_twist(self, stamp: int, frame_id: str = "base_link") -> TwistStamped:
        message = TwistStamped(twist=velocity_to_twist((0.0, 0.1, 0.0)))
        set_stamp(message.header.stamp, stamp)
        message.header.frame_id = frame_id
        return message


@pytest.fixture
def robot(bench: Any, g1: RobotModel) -> Commanded:
    return Commanded(bench, g1)


def test_velocities_hold_while_they_are_repeated(robot: Commanded) -> None:
    ahead = velocity_to_twist((0.3, 0.0, 0.2))
    robot.send(robot.cmd_vel, ahead)
    assert robot.node.counters[f"refused {topics.CMD_VEL}"] == 1
    assert "request mode/walk first" in robot.node.values["last refusal"]
    robot.enter("walk")
    robot.tick(1)
    assert robot.wanted == (0.0, 0.0, 0.0)  # what came before the walk is forgotten
    robot.send(robot.cmd_vel, ahead)
    assert robot.wanted == (0.3, 0.0, 0.2)
    robot.tick(450)
    assert robot.wanted == (0.3, 0.0, 0.2)
    robot.tick(60)
    assert robot.wanted == (0.0, 0.0, 0.0)
    robot.send(robot.cmd_vel, ahead)
    robot.enter("stand")
    robot.enter("walk")
    robot.tick(1)
    assert robot.wanted == (0.0, 0.0, 0.0)  # a new walk begins without a velocity


def test_words_hold_and_may_come_before_the_mode(robot: Commanded) -> None:
    robot.publish(robot.request, velocity_to_twist((-0.3, 0.0, 0.0)))
    robot.enter("walk")
    robot.tick(5000)
    assert robot.wanted == (-0.3, 0.0, 0.0)
    robot.send(robot.request, velocity_to_twist((math.nan, 0.0, 0.0)))
    assert "linear.x is nan" in robot.node.values["last refusal"]
    assert robot.wanted == (-0.3, 0.0, 0.0)
    robot.send(robot.cmd_vel, velocity_to_twist((0.1, 0.0, 0.0)))
    assert robot.wanted == (0.1, 0.0, 0.0)  # the newest counts
    robot.tick(600)
    assert robot.wanted == (0.0, 0.0, 0.0)  # and silence does not bring the word back


@pytest.mark.parametrize(
    ("velocity", "culprit"),
    [((math.nan, 0.0, 0.0), "linear.x is nan"), ((0.0, 0.0, -math.inf), "angular.z is -inf")],
)
def test_what_is_no_number_is_refused_by_name(
    robot: Commanded, velocity: tuple[float, float, float], culprit: str
) -> None:
    robot.enter("walk")
    robot.send(robot.cmd_vel, velocity_to_twist(velocity))
    assert robot.wanted == (0.0, 0.0, 0.0)
    assert culprit in robot.node.values["last refusal"]


def test_stamped_velocities_are_of_now_and_of_the_base(robot: Commanded) -> None:
    robot.enter("walk")
    for stamp, frame_id, culprit in (
        (robot.stamp - 600 * MS, "base_link", "s old"),
        (10**18, "base_link", "s ahead"),
        (robot.stamp, "odom", "header.frame_id: 'odom'"),
    ):
        robot.send(robot.stamped, robot.stamped_twist(stamp, frame_id))
        assert culprit in robot.node.values["last refusal"]
        assert robot.wanted == (0.0, 0.0, 0.0)
    stamp = robot.stamp
    robot.send(robot.stamped, robot.stamped_twist(stamp))
    assert robot.wanted == (0.0, 0.1, 0.0)
    robot.send(robot.stamped, robot.stamped_twist(stamp))
    assert "is not after" in robot.node.values["last refusal"]
    robot.tick(600)
    assert robot.wanted == (0.0, 0.0, 0.0)
    robot.send(robot.stamped, robot.stamped_twist(0, ""))  # no stamp: now
    assert robot.wanted == (0.0, 0.1, 0.0)


def test_the_phase_tells_when_the_robot_has_settled_and_that_nobody_can_walk(robot: Commanded) -> None:
    assert robot.phases == [topics.GAIT_SETTLED]
    robot.enter("walk")
    robot.tick(1)
    robot.bench.wait(lambda: robot.phases[-1] == "stand")
    for _ in range(50):
        robot.tick(10)
    robot.bench.wait(lambda: robot.phases[-1] == topics.GAIT_SETTLED)
    robot.send(robot.request, velocity_to_twist((0.2, 0.0, 0.0)))
    robot.bench.wait(lambda: robot.phases[-1] == "start")
    robot.node.trigger_deactivate()
    robot.bench.wait(lambda: robot.phases[-1] == topics.GAIT_ABSENT)
    robot.tick(1)
    assert robot.wanted == (0.0, 0.0, 0.0)
