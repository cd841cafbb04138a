"""Gait planner and balance controller by message: commands one way, the executed gait the other way."""

import math
from array import array
from contextlib import suppress
from typing import Any

import pytest
from geometry_msgs.msg import PoseStamped, Twist
from std_msgs.msg import Empty, String, UInt8MultiArray

from controllers.nodes.balance_controller import BalanceControllerNode
from models.errors import MessageError
from models.nodes import topics
from models.nodes.odometry import velocity_to_twist
from models.nodes.qos import COMMAND, EVENT, LATCHED, STATE
from models.nodes.status import subscribe_status
from models.robot_model import RobotModel
from models.status import ControlStatus, GaitStatus
from models.types import STILL
from planners.gait.footsteps import Foothold
from planners.gait.route import Footstep
from planners.nodes.footstep_messages import pose_message
from planners.nodes.gait_link import GaitCommand, GaitReport, TakeSteps, WalkTo, decode, encode
from planners.nodes.gait_planner import GaitPlannerNode
from planners.terrain.ground_route import Answer
from tests.support import standing

pytestmark = pytest.mark.ros

TICK = 20_000_000
"""Time between two reports [ns]."""


class Linked:
    """Both nodes, and a robot that stands on the spot, whatever it is commanded."""

    def __init__(self, bench: Any, g1: RobotModel, **planned: object) -> None:
        self.bench, self.model, self.stamp = bench, g1, 10**9
        self.answers: list[GaitCommand] = []
        self.reports: list[GaitReport] = []
        self.phases: list[str] = []
        self.routes: list[str] = []
        self.statuses: list[ControlStatus] = []
        self.gaits: list[GaitStatus] = []
        world = bench.world
        listen = world.create_subscription
        listen(String, topics.GAIT_PHASE, lambda m: self.phases.append(m.data), LATCHED)
        listen(String, topics.GAIT_ROUTE, lambda m: self.routes.append(m.data), EVENT)
        listen(UInt8MultiArray, topics.GAIT_COMMAND, self._on_answer, EVENT)
        listen(UInt8MultiArray, topics.GAIT_STATE, lambda m: self.reports.append(decode(GaitReport, m)), STATE)
        subscribe_status(world, ControlStatus, topics.CONTROL_STATUS, self.statuses.append)
        subscribe_status(world, GaitStatus, topics.GAIT_STATUS, self.gaits.append, LATCHED)
        self.mode = world.create_publisher(String, topics.MODE, LATCHED)
        self.velocity = world.create_publisher(Twist, topics.GAIT_VELOCITY, COMMAND)
        self.halt = world.create_publisher(Empty, topics.GAIT_STOP, EVENT)
        self.goal = world.create_publisher(PoseStamped, topics.GOAL_POSE, EVENT)
        self.raw = world.create_publisher(UInt8MultiArray, topics.GAIT_COMMAND, EVENT)
        self.controller = bench.add(BalanceControllerNode)
        self.planner = bench.add(GaitPlannerNode, **planned)
        for publisher, count in ((self.mode, 2), (self.velocity, 1), (self.halt, 1), (self.goal, 1), (self.raw, 2)):
            bench.wait(lambda p=publisher, n=count: p.get_subscription_count() >= n)
        bench.wait(lambda: world.count_publishers(topics.GAIT_COMMAND) == 2)
        self.enter("stand")

    def _on_answer(self, message: Any) -> None:
        with suppress(MessageError):  # malformed on purpose
            self.answers.append(decode(GaitCommand, message))

    def enter(self, mode: str) -> None:
        """Change the mode of both nodes."""
        self.mode.publish(String(data=mode))
        self.bench.spin(0.1)

    def tick(self, count: int = 1, *, answered: bool = True) -> None:
        """Let the controller report, and the planner answer."""
        for _ in range(count):
            self.stamp += TICK
            before = len(self.answers)
            self.controller.on_state(standing(self.model, 1e-9 * self.stamp), self.stamp)
            self.bench.wait(lambda: self.reports and self.reports[-1].stamp == self.stamp)
            if answered:
                self.bench.wait(lambda before=before: len(self.answers) > before)
            self.bench.spin(0.02)

    def walk(self) -> None:
        """Begin mode walk, both nodes linked."""
        self.tick(2)
        self.enter("walk")
        self.tick(2)

    @property
    def executed(self) -> Any:
        """Command of the gait that the controller executes."""
        return self.reports[-1].state.command


@pytest.fixture
def linked(bench: Any, g1: RobotModel) -> Linked:
    return Linked(bench, g1)


def test_the_controller_walks_at_the_planners_velocity_and_the_phases_come_back(linked: Linked) -> None:
    linked.walk()
    linked.velocity.publish(velocity_to_twist((0.3, 0.0, 0.1)))
    linked.tick(3)
    assert linked.executed.target == (0.3, 0.0, 0.1)
    linked.bench.wait(lambda: linked.phases[-1] == "start")
    linked.tick(25)  # silent for 0.5 s
    assert linked.executed.target == STILL


def test_goals_are_carried_out_once_and_stopped(linked: Linked) -> None:
    linked.walk()
    linked.velocity.publish(velocity_to_twist((0.2, 0.0, 0.0)))
    linked.tick(2)
    linked.goal.publish(pose_message(Foothold(1.0, 0.0, 0.0), "odom"))
    linked.bench.wait(lambda: linked.routes)
    assert linked.routes[-1].startswith("running: ")
    linked.tick(3)
    assert linked.executed.route.left > 5 and linked.executed.target == STILL  # the velocity from before is over
    linked.halt.publish(Empty())
    linked.tick(3)
    linked.bench.wait(lambda: linked.routes[-1] == "ended: stopped")
    assert not linked.executed.route.left  # the goal is in the answers no more, and not begun again
    number = linked.answers[-1].number
    linked.goal.publish(pose_message(Foothold(50.0, 0.0, 0.0), "odom"))
    linked.bench.wait(lambda: "50.0 m away" in linked.routes[-1])
    linked.tick()
    assert linked.answers[-1].number == number  # a refused goal does not reach the controller


def test_what_the_controller_refuses_ends_the_route_with_its_reason(linked: Linked) -> None:
    linked.walk()
    linked.goal.publish(pose_message(Foothold(1.0, 0.0, 0.0), "odom"))
    linked.bench.wait(lambda: linked.routes)
    linked.bench.wait(lambda: linked.answers[-1].number)
    number = linked.answers[-1].number
    linked.raw.publish(encode(GaitCommand(0)))  # as another planner that has just started
    linked.raw.publish(encode(GaitCommand(number, WalkTo(Foothold(40.0, 0.0, 0.0)))))
    linked.bench.wait(lambda: linked.controller.counters[f"refused {topics.GAIT_COMMAND}"])
    assert "40.0 m away" in linked.controller.values["last refusal"]
    linked.tick(2)
    linked.bench.wait(lambda: "40.0 m away" in linked.routes[-1])


def test_footsteps_that_come_too_late_leave_the_walk_as_it_is(linked: Linked) -> None:
    linked.walk()
    linked.goal.publish(pose_message(Foothold(1.0, 0.0, 0.0), "odom"))
    linked.bench.wait(lambda: linked.routes)
    linked.bench.wait(lambda: linked.answers[-1].number)
    linked.tick(3)
    number, left = linked.answers[-1].number, linked.executed.route.left
    linked.raw.publish(encode(GaitCommand(number + 1, TakeSteps((Footstep(1, Foothold(0.1, -0.1, 0.0)),), 0))))
    linked.bench.wait(lambda: linked.controller.counters[f"refused {topics.GAIT_COMMAND}"])
    assert "begin after touchdown 0" in linked.controller.values["last refusal"]
    linked.tick(2)
    assert linked.executed.route.left == left > 5 and linked.routes[-1].startswith("running: ")


@pytest.mark.parametrize(
    ("record", "culprit"),
    [
        (GaitCommand(5, TakeSteps((Footstep(1, Foothold(0.1, 0.0, 0.0)),))), b"\x07"),
        (GaitCommand(5, None, (0.125, 0.0, 0.0)), None),
    ],
)
def test_malformed_commands_are_refused(linked: Linked, record: GaitCommand, culprit: bytes | None) -> None:
    linked.walk()
    data = bytes(encode(record).data)
    ahead = b"\xcb\x3f\xc0" + bytes(6)  # 0.125 in MessagePack
    bad = data.replace(b"foot\x01", b"foot" + culprit) if culprit else data.replace(ahead, b"\xcb\x7f\xf8" + bytes(6))
    for sent in (bad, data[:-3], b""):
        before = linked.controller.counters[f"refused {topics.GAIT_COMMAND}"]
        linked.raw.publish(UInt8MultiArray(data=array("B", sent)))
        linked.bench.wait(lambda n=before: linked.controller.counters[f"refused {topics.GAIT_COMMAND}"] > n)
    linked.tick(2)
    assert linked.executed.target == STILL and not linked.executed.route.left


def test_a_record_keeps_every_bit_of_the_gait(linked: Linked) -> None:
    linked.walk()
    linked.velocity.publish(velocity_to_twist((0.1, 0.2, -0.3)))
    linked.tick(12)
    report = linked.reports[-1]
    assert encode(decode(GaitReport, encode(report))) == encode(report)
    with pytest.raises(MessageError, match="GaitReport"):
        decode(GaitReport, encode(GaitCommand()))


@pytest.mark.parametrize("data", [b"\x82\xa6reason\xa1\xff\xa6number\x01", b"\x81\xa1x" + 100_000 * b"\x91" + b"\xc0"])
def test_invalid_text_and_deep_nesting_are_refused_like_any_malformed_record(data: bytes) -> None:
    with pytest.raises(MessageError, match="Answer"):
        decode(Answer, UInt8MultiArray(data=array("B", data)))


def test_without_a_planner_the_gait_stops_and_a_new_planner_begins_anew(linked: Linked, bench: Any) -> None:
    linked.walk()
    linked.velocity.publish(velocity_to_twist((0.3, 0.0, 0.0)))
    linked.tick(3)
    assert linked.executed.moving
    bench.remove(linked.planner)
    linked.tick(27, answered=False)
    assert not linked.executed.moving
    bench.wait(lambda: linked.statuses[-1].gait_silent)
    assert linked.statuses[-1].stepping
    linked.planner = bench.add(GaitPlannerNode)
    bench.wait(lambda: linked.raw.get_subscription_count() >= 2)
    bench.spin(0.3)
    linked.tick(3)
    bench.wait(lambda: not linked.statuses[-1].gait_silent)
    assert not linked.executed.moving  # the velocity from before the restart is not repeated
    linked.velocity.publish(velocity_to_twist((0.2, 0.0, 0.0)))
    linked.tick(3)
    assert linked.executed.target == (0.2, 0.0, 0.0)


def test_a_gait_that_is_configured_otherwise_is_refused(bench: Any, g1: RobotModel) -> None:
    linked = Linked(bench, g1, **{"velocity.forward": 0.15})
    linked.tick(3, answered=False)
    assert "gait.*" in linked.planner.values["last refusal"]
    bench.wait(lambda: linked.statuses and linked.statuses[-1].gait_silent)
    assert math.isclose(linked.planner._config.velocity.forward, 0.15)
