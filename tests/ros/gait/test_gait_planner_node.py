"""The gait planner's node beside a world of a few topics: for how long a velocity counts, goals, and its phase."""

import math
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Path
from nav_msgs.srv import GetPlan
from std_msgs.msg import Empty, String

from models.errors import PoiseError
from models.nodes import topics
from models.nodes.interfaces import interface
from models.nodes.odometry import velocity_to_twist
from models.nodes.qos import COMMAND, EVENT, LATCHED
from models.nodes.status import subscribe_status
from models.robot_model import RobotModel
from models.status import GaitStatus
from planners.gait.footsteps import Foothold, middle
from planners.nodes.footstep_messages import pose_message
from tests.ros.gait.standing_gait import StandingGait
from tests.support import standing

pytestmark = pytest.mark.ros


class Commanded(StandingGait):
    """A gait planner whose robot stands on the spot, whatever it plans."""

    def __init__(self, bench: Any, g1: RobotModel) -> None:
        self.phases: list[str] = []
        world = bench.world
        world.create_subscription(String, topics.GAIT_PHASE, lambda m: self.phases.append(m.data), LATCHED)
        self.mode = world.create_publisher(String, topics.MODE, LATCHED)
        self.velocity = world.create_publisher(Twist, topics.GAIT_VELOCITY, COMMAND)
        self.halt = world.create_publisher(Empty, topics.GAIT_STOP, EVENT)
        super().__init__(bench, g1)
        self.goal = world.create_publisher(PoseStamped, topics.GOAL_POSE, EVENT)
        self.footsteps = world.create_publisher(Path, topics.FOOTSTEPS_COMMAND, EVENT)
        self.routes: list[str] = []
        world.create_subscription(String, topics.GAIT_ROUTE, lambda m: self.routes.append(m.data), EVENT)
        for publisher in (self.mode, self.velocity, self.halt, self.goal, self.footsteps):
            bench.wait(lambda publisher=publisher: publisher.get_subscription_count() >= 1)
        bench.wait(lambda: self.phases)
        self.node.publish(self.stamp)

    def enter(self, mode: str) -> None:
        """Change the mode; a walk begins as the controller begins it."""
        self.mode.publish(String(data=mode))
        self.bench.wait(lambda: self.node._mode == mode)
        if mode == "walk":
            self.stack.gait.reset(self.state)
            self.stack.walking = True
            self.node.publish(self.stamp)

    @property
    def desired(self) -> tuple[float, float, float]:
        """Velocity that the law is commanded."""
        target: tuple[float, float, float] = self.node._law.state.command.target
        return target

    def ask(self, publisher: Any, message: Any) -> str:
        """Publish a goal or footsteps, and wait for the answer."""
        self.routes.clear()
        publisher.publish(message)
        self.bench.wait(lambda: self.routes)
        return self.routes[-1]

    def publish(self, publisher: Any, message: Any) -> None:
        """Publish, and wait until it has been taken or refused."""

        def seen() -> tuple[object, ...]:
            command = self.node._command
            return sum(self.node.counters.values()), command.velocity, command._until

        before = seen()
        publisher.publish(message)
        self.bench.wait(lambda: seen() != before)

    def send(self, publisher: Any, message: Any) -> None:
        """Publish, and one tick."""
        self.publish(publisher, message)
        self.tick(1)


@pytest.fixture
def robot(bench: Any, g1: RobotModel) -> Commanded:
    return Commanded(bench, g1)


def test_a_walk_that_begins_again_is_reported_where_the_mode_between_was_lost(robot: Commanded) -> None:
    """The supervisor counts the gait as moving from the begin of a walk until its report."""
    robot.enter("walk")
    robot.bench.spin(0.3)
    robot.phases.clear()
    robot.mode.publish(String(data="walk"))
    robot.bench.wait(lambda: not robot.node._begun)
    robot.node.publish(robot.stamp)
    robot.bench.wait(lambda: robot.phases)


def test_velocities_count_while_they_are_repeated(robot: Commanded) -> None:
    ahead = velocity_to_twist((0.3, 0.0, 0.2))
    robot.publish(robot.velocity, ahead)  # it may come before the mode that it belongs to
    robot.enter("walk")
    robot.tick(1)
    assert robot.desired == (0.3, 0.0, 0.2)
    robot.send(robot.velocity, ahead)
    robot.tick(450)
    assert robot.desired == (0.3, 0.0, 0.2)
    robot.send(robot.velocity, ahead)
    robot.tick(450)
    assert robot.desired == (0.3, 0.0, 0.2)
    robot.tick(60)
    assert robot.desired == (0.0, 0.0, 0.0)
    robot.send(robot.velocity, ahead)
    robot.enter("stand")
    robot.enter("walk")
    robot.tick(1)
    assert robot.desired == (0.0, 0.0, 0.0)  # a new walk begins without a velocity


def test_silence_of_the_supervisor_ends_a_walk_to_a_goal_too(robot: Commanded) -> None:
    robot.enter("walk")
    robot.send(robot.velocity, velocity_to_twist((0.0, 0.0, 0.0)))
    assert robot.ask(robot.goal, goal(1.0, 0.0, 0.0)).startswith("running")
    robot.tick(400)
    assert robot.node._law.route.left
    robot.tick(200)
    robot.bench.wait(lambda: robot.routes[-1].startswith("ended"))


def test_a_velocity_from_before_a_goal_does_not_end_it(robot: Commanded) -> None:
    robot.enter("walk")
    ahead = velocity_to_twist((0.3, 0.0, 0.0))
    robot.send(robot.velocity, ahead)
    assert robot.ask(robot.goal, goal(1.0, 0.0, 0.0)).startswith("running")
    robot.send(robot.velocity, ahead)
    assert robot.node._law.route.left
    robot.send(robot.velocity, velocity_to_twist((0.2, 0.0, 0.0)))
    robot.bench.wait(lambda: robot.routes[-1].startswith("ended"))


@pytest.mark.parametrize(
    ("velocity", "culprit"),
    [((math.nan, 0.0, 0.0), "linear.x is nan"), ((0.0, 0.0, -math.inf), "angular.z is -inf")],
)
def test_what_is_no_number_is_refused_by_name(
    robot: Commanded, velocity: tuple[float, float, float], culprit: str
) -> None:
    robot.enter("walk")
    robot.send(robot.velocity, velocity_to_twist(velocity))
    assert robot.desired == (0.0, 0.0, 0.0)
    assert culprit in robot.node.values["last refusal"]


def test_the_phase_reports_when_the_robot_has_settled_and_that_it_cannot_walk(robot: Commanded) -> None:
    assert robot.phases == [topics.GAIT_SETTLED]
    robot.enter("walk")
    robot.tick(1)
    robot.bench.wait(lambda: robot.phases[-1] == "stand")
    for _ in range(50):
        robot.tick(10)
    robot.bench.wait(lambda: robot.phases[-1] == topics.GAIT_SETTLED)
    robot.send(robot.velocity, velocity_to_twist((0.2, 0.0, 0.0)))
    robot.bench.wait(lambda: robot.phases[-1] == "start")
    robot.node.trigger_deactivate()
    robot.bench.wait(lambda: robot.phases[-1] == topics.GAIT_ABSENT)
    robot.tick(1)
    assert robot.desired == (0.0, 0.0, 0.0)


def goal(x: float, y: float, yaw: float, frame_id: str = "odom") -> PoseStamped:
    return pose_message(Foothold(x, y, yaw), frame_id)


def path(*poses: tuple[str, float, float], frame_id: str = "odom", z: float = 0.0, slope: float = 0.0) -> Path:
    message = Path(poses=[pose_message(Foothold(x, y, 0.0, z), name, 0, (slope, 0.0)) for name, x, y in poses])
    message.header.frame_id = frame_id
    return message


def test_goals_are_walked_to_in_mode_walk_only_and_refused_with_the_reason(robot: Commanded) -> None:
    assert "refused: no walking in mode '': request mode/walk first" in robot.ask(robot.goal, goal(1.0, 0.0, 0.0))
    robot.enter("walk")
    robot.tick(1)
    bent = goal(1.0, 0.0, 0.0)
    bent.pose.orientation.w = 0.5
    for message, culprit in (
        (goal(1.0, math.nan, 0.0), "position.y is nan"),
        (goal(1.0, 0.0, 0.0, "map"), "header.frame_id: 'map' instead of 'odom'"),
        (goal(50.0, 0.0, 0.0), "50.0 m away, at most 20 m"),
        (bent, "quaternion of norm 0.5"),
    ):
        refused = robot.node.counters[f"refused {topics.GOAL_POSE}"]
        assert culprit in robot.ask(robot.goal, message)
        assert robot.node.counters[f"refused {topics.GOAL_POSE}"] == refused + 1
        assert culprit in robot.node.values["last refusal"]
    robot.send(robot.velocity, velocity_to_twist((0.2, 0.0, 0.0)))
    assert robot.ask(robot.goal, goal(1.0, 0.0, 0.0)).startswith("running: ")
    robot.tick(1)
    assert robot.desired == (0.0, 0.0, 0.0) and robot.node._law.route.left  # the velocity from before is over
    robot.halt.publish(Empty())
    robot.bench.wait(lambda: not robot.node._law.route.left)
    robot.tick(1)
    robot.bench.wait(lambda: robot.routes[-1] == "ended: stopped")
    here = middle(robot.node._law.footholds)
    assert robot.ask(robot.goal, goal(here.x, here.y, here.yaw)) == "running: 0 footsteps"
    robot.tick(1)
    robot.bench.wait(lambda: robot.routes[-1] == "done")
    assert robot.ask(robot.goal, goal(1.0, 0.0, 0.0)).startswith("running: ")
    robot.enter("stand")
    robot.bench.wait(lambda: robot.routes[-1] == "ended: mode walk was left")
    assert "request mode/walk first" in robot.ask(robot.goal, goal(1.0, 0.0, 0.0))


def test_listed_footsteps_name_their_soles_or_alternate(robot: Commanded) -> None:
    robot.enter("walk")
    robot.tick(1)
    left, right = robot.node._law.footholds
    for message, culprit in (
        (path(), "0 footsteps refused"),
        (path(("l_sole", 0.1, left.y), frame_id="base_link"), "'base_link' instead of 'odom'"),
        (path(("l_foot", 0.1, left.y)), "footstep 1: header.frame_id: 'l_foot' names no sole: l_sole, r_sole"),
        (path(("l_sole", 0.1, math.inf)), "footstep 1: position.y is inf"),
        (path(("l_sole", 0.1, right.y)), "footstep 1 (left) refused: legs would cross"),
        (
            path(("l_sole", 0.1, left.y), z=0.3),
            "footstep 1 (left) refused: 0.300 m above the right sole, at most 0.204 m",
        ),
        (
            path(("l_sole", 0.1, left.y), slope=-0.4),
            "footstep 1 (left) refused: tilted by 0.381 rad, at most 0.245 rad",
        ),
        (path(("", 0.1, right.y), ("", 0.2, right.y)), "footstep 2 (left) refused: legs would cross"),
        (path(("r_sole", 0.1, right.y), ("r_sole", 0.2, right.y)), "footstep 2 (right) refused: the same foot"),
        (path(("l_sole", 0.9, left.y)), "ahead of the right sole"),
    ):
        assert culprit in robot.ask(robot.footsteps, message)
        assert not robot.node._law.route.left
    assert robot.node.counters[f"refused {topics.FOOTSTEPS_COMMAND}"] == 10
    assert robot.ask(robot.footsteps, path(("", 0.1, right.y), ("", 0.1, left.y))) == "running: 2 footsteps"
    assert robot.node._law.route.foot == 1
    robot.send(robot.velocity, velocity_to_twist((0.1, 0.0, 0.0)))
    robot.bench.wait(lambda: robot.routes[-1] == "ended: a velocity was commanded")


def test_plan_footsteps_answers_with_alternating_soles_or_with_nothing(robot: Commanded) -> None:
    client = robot.bench.world.create_client(GetPlan, topics.PLAN_FOOTSTEPS)
    robot.bench.wait(client.service_is_ready)

    def plan(start: PoseStamped, end: PoseStamped, tolerance: float = 0.0) -> Path:
        future = client.call_async(GetPlan.Request(start=start, goal=end, tolerance=tolerance))
        robot.bench.wait(future.done)
        return future.result().plan

    def refusal() -> str:
        return str(robot.node.values["last refusal"])

    planned = plan(goal(1.0, 2.0, 0.0), goal(2.0, 2.0, 0.0))
    names = [pose.header.frame_id for pose in planned.poses]
    assert planned.header.frame_id == "odom" and len(names) >= 6
    assert names == (["l_sole", "r_sole"] * len(names))[: len(names)]
    ends = [(pose.pose.position.x, pose.pose.position.y) for pose in planned.poses[-2:]]
    assert np.mean(ends, axis=0) == pytest.approx((2.0, 2.0), abs=0.01)
    assert not plan(PoseStamped(), goal(1.0, 0.0, 0.0)).poses and "the poses of the soles are unknown" in refusal()
    assert not plan(goal(0.0, 0.0, 0.0), goal(math.nan, 0.0, 0.0)).poses and "position.x is nan" in refusal()
    assert not plan(goal(0.0, 0.0, 0.0), goal(30.0, 0.0, 0.0)).poses and "30.0 m away" in refusal()
    assert not plan(goal(0.0, 0.0, 0.0), goal(1.0, 0.0, 0.0), math.nan).poses and "tolerance is nan" in refusal()
    assert robot.node.counters[f"refused {topics.PLAN_FOOTSTEPS}"] == 4
    robot.enter("walk")
    robot.tick(1)
    planned = plan(PoseStamped(), goal(0.5, 0.0, 0.0))
    assert robot.ask(robot.footsteps, planned) == f"running: {len(planned.poses)} footsteps"  # it can be executed


def test_timed_footsteps_start_where_the_soles_are_and_refusals_have_reasons(robot: Commanded) -> None:
    try:
        kind = interface("poise_interfaces", "srv", "PlanFootsteps")
    except PoiseError as error:
        pytest.skip(str(error))
    client = robot.bench.world.create_client(kind, topics.PLAN_TIMED_FOOTSTEPS)
    robot.bench.wait(client.service_is_ready)

    def plan(end: PoseStamped) -> Any:
        future = client.call_async(kind.Request(goal=end))
        robot.bench.wait(future.done)
        return future.result()

    answer = plan(goal(1.0, 0.0, 0.0))
    assert not answer.success and "the poses of the soles are unknown" in answer.message
    lifted = standing(robot.model, 1.0, shares=(1.0, 0.0))
    robot.enter("stand")
    robot.stack.gait.step(lifted, 1e-3)
    assert "does not stand on both soles" in plan(goal(1.0, 0.0, 0.0)).message
    robot.stack.gait.step(robot.state, 1e-3)
    answer = plan(goal(0.0, 0.5, 0.0))
    config = robot.node._config
    single = config.pace.between(config.route.pace, "single")
    times = [step.time_from_start.sec + 1e-9 * step.time_from_start.nanosec for step in answer.footsteps]
    assert answer.success and times[0] == pytest.approx(config.timing.start + single)
    assert np.diff(times) == pytest.approx(config.period)
    assert [step.side for step in answer.footsteps[:2]] == ["left", "right"]
    assert {step.pose.header.frame_id for step in answer.footsteps} == {"odom"}
    assert "30.0 m away" in plan(goal(30.0, 0.0, 0.0)).message


def test_a_velocity_beyond_the_limits_is_reported_once(bench: Any, robot: Commanded) -> None:
    limits: list[str] = []
    subscribe_status(bench.world, GaitStatus, topics.GAIT_STATUS, lambda s: limits.append(s.limited), LATCHED)
    robot.enter("walk")
    most = robot.node._law.config.velocity.forward
    for _ in range(5):
        robot.send(robot.velocity, velocity_to_twist((9.0, 0.0, 0.1)))
    bench.wait(lambda: limits[-1:] == [f"forward 9 limited to {most:.3g} m/s"])
    assert limits.count(limits[-1]) <= 2  # again with a change of the phase
    robot.send(robot.velocity, velocity_to_twist((0.2, 0.0, 0.1)))
    bench.wait(lambda: limits[-1] == "")
