"""Walks on the map: level ground, what is not, what cannot be stepped on; and the node that plans."""

import math
import operator
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, Twist
from msgspec import msgpack
from rclpy.parameter import Parameter
from std_msgs.msg import Empty, Header, String, UInt8MultiArray

from models.errors import MessageError
from models.nodes import topics
from models.nodes.grid_map import grid_map_message, grid_map_type
from models.nodes.messages import stamp_ns, to_ns
from models.nodes.odometry import velocity_to_twist
from models.nodes.progress import IDLE
from models.nodes.qos import COMMAND, EVENT, LATCHED, STATE
from models.nodes.status import subscribe_status
from models.robot_model import RobotModel
from models.status import GaitStatus, RouteState, RouteStatus
from models.types import Velocity
from planners.gait.footsteps import LEFT, RIGHT, Foothold, middle, side_of
from planners.gait.route import Footstep, soles_at
from planners.gait.tread import Tread
from planners.nodes.footstep_messages import pose_message
from planners.nodes.gait_link import decode, encode
from planners.nodes.ground_planner import GroundPlannerNode, ground_from_message
from planners.terrain.footholds import GroundQuery
from planners.terrain.ground_route import Answer, Request
from tests.ros.gait.standing_gait import MS, StandingGait
from tests.support import standing

pytestmark = pytest.mark.ros

WALL = "the ground ahead is 0.30 m higher, at most 0.20 m"


class Guided(StandingGait):
    """A gait planner whose robot stands on the spot, and a ground planner that answers as the test says."""

    def __init__(self, bench: Any, g1: RobotModel, *, planner: bool = True) -> None:
        world = bench.world
        self.requests: list[Request] = []
        self.routes: list[RouteStatus] = []
        self.limits: list[str] = []
        self.repeated: Velocity | None = None
        super().__init__(bench, g1)
        self.mode = world.create_publisher(String, topics.MODE, LATCHED)
        self.goal = world.create_publisher(PoseStamped, topics.GOAL_POSE, EVENT)
        self.velocity = world.create_publisher(Twist, topics.GAIT_VELOCITY, COMMAND)
        self.halt = world.create_publisher(Empty, topics.GAIT_STOP, EVENT)
        self.plans = world.create_publisher(UInt8MultiArray, topics.GROUND_PLAN, EVENT)
        subscribe_status(world, RouteStatus, topics.ROUTE_STATUS, self.routes.append)
        subscribe_status(
            world, GaitStatus, topics.GAIT_STATUS, lambda status: self.limits.append(status.remarks), LATCHED
        )
        if planner:
            world.create_subscription(
                UInt8MultiArray, topics.GROUND_REQUEST, lambda m: self.requests.append(decode(Request, m)), EVENT
            )
        for publisher in (self.mode, self.goal, self.velocity, self.halt, self.plans):
            bench.wait(lambda publisher=publisher: publisher.get_subscription_count() >= 1)
        if planner:
            bench.wait(lambda: self.node._ground._requests.get_subscription_count())
        self.node.publish(self.stamp)
        self.mode.publish(String(data="walk"))
        bench.wait(lambda: self.node._mode == "walk")
        self.stack.gait.reset(self.state)
        self.stack.walking = True
        self.tick(1)

    @property
    def left(self) -> int:
        """Footsteps that the gait has been given."""
        count: int = self.stack.gait.route.left
        return count

    def until(self, condition: Callable[[], object]) -> None:
        """Tick until something happens, while the velocity is repeated."""
        for _ in range(400):
            if condition():
                return
            if self.repeated is not None:  # as the supervisor does
                self.velocity.publish(velocity_to_twist(self.repeated))
            self.tick(10)
            self.bench.spin(0.002)
        raise AssertionError("it did not happen in time")

    def ask(self) -> Request:
        """The next request."""
        self.until(lambda: self.requests)
        return self.requests.pop(0)

    def send(self, answer: Answer) -> None:
        """Answer, and wait until the answer has been read."""
        self.plans.publish(encode(answer))
        self.bench.spin(0.2)

    def go(self, x: float, y: float = 0.0) -> None:
        self.goal.publish(pose_message(Foothold(x, y, 0.0), topics.ODOM_FRAME))
        self.bench.wait(lambda: self.routes)

    def drive(self, forward: float, left: float = 0.0, turn: float = 0.0) -> None:
        self.repeated = forward, left, turn
        self.velocity.publish(velocity_to_twist(self.repeated))
        self.bench.wait(lambda: self.node._command.velocity == self.repeated)


def steps(x: float) -> tuple[Footstep, ...]:
    """Onto a tread of 15 cm."""
    return tuple(Footstep(foot, Foothold(x, side_of(foot) * 0.1, 0.0, 0.15), Tread()) for foot in (LEFT, RIGHT))


def test_without_a_ground_planner_a_goal_is_walked_to_at_once(bench: Any, g1: RobotModel) -> None:
    robot = Guided(bench, g1, planner=False)
    robot.go(1.0)
    assert robot.left > 5 and robot.routes[-1].state is RouteState.RUNNING


def test_simulated_time_waits_from_a_request_to_its_answer(bench: Any, g1: RobotModel) -> None:
    robot, times = Guided(bench, g1), list[tuple[str, int]]()
    listen = bench.world.create_subscription
    listen(Header, topics.PERCEPTION_TIME, lambda m: times.append((m.frame_id, stamp_ns(m.stamp))), EVENT)
    bench.wait(robot.node._ground._progress._publisher.get_subscription_count)
    robot.go(1.0)
    request = robot.ask()
    bench.wait(lambda: times == [("ground_planner", to_ns(request.stamp))])
    robot.send(Answer(request.number + 1, level=True))  # to another request
    assert len(times) == 1
    robot.send(Answer(request.number, level=True))
    bench.wait(lambda: times[1:2] == [("ground_planner", IDLE)])
    unanswered, _ = robot.ask(), robot.ask()  # at touchdowns
    bench.wait(lambda: times[2:] == [("ground_planner", to_ns(unanswered.stamp))])  # for one request only


@pytest.mark.parametrize("answer", [{"level": True}, {"blind": True}, None])
def test_on_level_ground_and_where_no_map_is_known_it_walks_as_without_one(
    bench: Any, g1: RobotModel, answer: dict[str, bool] | None
) -> None:
    robot = Guided(bench, g1)
    robot.go(1.0)
    request = robot.ask()
    assert request.watch and request.query.distance == pytest.approx(0.6, abs=0.05) and not robot.left
    if answer is None:  # the ground planner is silent
        robot.until(lambda: robot.left)
    else:
        robot.send(Answer(request.number, **answer))
    assert robot.left > 5


@pytest.mark.parametrize("answered", [True, False])
def test_a_goal_that_has_come_out_of_reach_ends_with_the_reason(
    bench: Any, g1: RobotModel, monkeypatch: pytest.MonkeyPatch, answered: bool
) -> None:
    robot, drifted = Guided(bench, g1), g1.standing_configuration()
    robot.go(-19.8)
    request = robot.ask()
    drifted[0] += 0.3  # [m]
    monkeypatch.setattr(Guided, "state", property(lambda robot: standing(g1, 1e-9 * robot.stamp, q=drifted)))
    robot.stack.gait.reset(robot.state)
    if answered:
        robot.send(Answer(request.number, level=True))
    robot.until(lambda: robot.routes[-1].state is RouteState.ENDED)
    assert robot.routes[-1].reason == "the goal is 20.1 m away, at most 20 m"


@pytest.mark.long
def test_to_a_goal_beyond_stairs_it_follows_plans_and_says_what_ends_them(bench: Any, g1: RobotModel) -> None:
    robot = Guided(bench, g1)
    robot.go(2.0)
    robot.send(Answer(robot.ask().number))
    request = robot.ask()
    assert not request.watch and request.after is None and not robot.left
    assert request.query.distance == pytest.approx(2.0, abs=0.1)
    robot.send(Answer(request.number, steps(0.3), WALL))
    assert robot.left == 2 and robot.routes[-1].state is RouteState.RUNNING
    robot.stack.gait.end_route("done")  # both were taken
    robot.send(Answer(robot.ask().number, (), WALL))
    robot.until(lambda: robot.routes[-1].state is RouteState.ENDED)
    assert robot.routes[-1].reason == WALL


def test_a_turn_to_the_goal_is_commanded_once(bench: Any, g1: RobotModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also if the state of the gait, from another process, does not follow at once."""
    robot, goals = Guided(bench, g1), list[Foothold]()
    walk_to = robot.stack.walk_to
    monkeypatch.setattr(robot.stack, "walk_to", lambda goal: [goals.append(goal), walk_to(goal)])
    robot.go(0.0, 2.0)
    robot.send(Answer(robot.ask().number))
    robot.until(lambda: goals)
    assert robot.left and robot.stack.gait.settled
    for _ in range(3):
        robot.node.publish(robot.stamp)
    assert len(goals) == 1


def test_at_the_place_of_its_goal_it_turns_to_the_heading_of_the_goal_only(bench: Any, g1: RobotModel) -> None:
    """The direction to the goal is arbitrary there, also where the ground is not level."""
    robot = Guided(bench, g1)
    robot.goal.publish(pose_message(Foothold(-0.01, 0.0, 0.5), topics.ODOM_FRAME))
    request = robot.ask()
    assert request.query.line.yaw == 0.0
    robot.send(Answer(request.number))
    robot.until(lambda: robot.left)
    assert middle(robot.stack.gait.soles_after(robot.left)).yaw == pytest.approx(0.5, abs=0.01)
    robot.stack.gait.end_route("done")
    robot.until(lambda: robot.routes[-1].state is RouteState.DONE)


@pytest.mark.long
def test_told_so_it_walks_to_a_goal_around_what_is_in_the_way(bench: Any, g1: RobotModel) -> None:
    robot = Guided(bench, g1)
    robot.node.set_parameters([Parameter("around", value=True)])
    robot.go(2.0)
    robot.send(Answer(robot.ask().number))
    request = robot.ask()
    assert request.around and not robot.left and request.query.distance == pytest.approx(2.0, abs=0.1)
    beside = Foothold(0.3, 0.6, 0.0)
    robot.send(Answer(request.number, poses=(beside, Foothold(1.4, 0.6, 0.0))))
    watch = robot.ask()
    assert watch.watch and watch.query.line.yaw == pytest.approx(math.atan2(beside.y, beside.x), abs=0.1)
    assert robot.left and middle(robot.stack.gait.soles_after(robot.left)).y == pytest.approx(0.6, abs=0.01)
    robot.stack.gait.end_route("done")
    robot.stack.gait.reset(robot.state)  # it stands
    robot.until(lambda: middle(robot.stack.gait.soles_after(robot.left)).x == pytest.approx(1.4, abs=0.01))
    robot.send(Answer(robot.requests[-1].number))  # the map has grown: not level
    robot.stack.gait.reset(robot.state)
    robot.requests.clear()
    request = robot.ask()
    assert request.around and not robot.left
    robot.send(Answer(request.number, (), "no way around"))
    robot.until(lambda: robot.routes[-1].state is RouteState.ENDED)
    assert robot.routes[-1].reason == "no way around"


@pytest.mark.parametrize(
    ("answer", "end"),
    [({"level": True}, ""), ({}, "not level"), ({"blind": True}, "not known"), (None, "not known")],
)
def test_from_beside_its_goal_it_walks_there_over_ground_that_is_known_to_be_level(
    bench: Any, g1: RobotModel, answer: dict[str, bool] | None, end: str
) -> None:
    robot = Guided(bench, g1)
    robot.go(0.04, 0.3)  # no plan has a way left to go, so that the route ends at once
    robot.send(Answer(robot.ask().number))
    robot.stack.gait.reset(robot.state)
    robot.node._ground._beside = 0.0
    robot.node._ground._stage = robot.node._ground._stage.ROUTE
    robot.node._ground._route.end("done")
    request = robot.ask()
    assert request.watch and request.query.distance == pytest.approx(0.3, abs=0.02)
    if answer is not None:
        robot.send(Answer(request.number, **answer))
    if not end:
        assert robot.left and robot.routes[-1].state is RouteState.RUNNING
        return
    robot.until(lambda: robot.routes[-1].state is RouteState.ENDED)
    assert robot.routes[-1].reason == f"the robot stands 0.30 m beside the goal, and the ground between is {end}"


@pytest.mark.long
def test_where_nothing_is_to_be_passed_it_follows_plans(bench: Any, g1: RobotModel) -> None:
    robot = Guided(bench, g1)
    robot.node.set_parameters([Parameter("around", value=True)])
    robot.go(2.0)
    robot.send(Answer(robot.ask().number))
    robot.send(Answer(robot.ask().number))
    request = robot.ask()
    assert not request.around and not request.watch


def test_a_ground_planner_that_falls_silent_is_reported(bench: Any, g1: RobotModel) -> None:
    robot = Guided(bench, g1)
    robot.drive(0.3)
    robot.send(Answer(robot.ask().number, level=True))
    robot.tick(1500)
    assert not any(robot.limits)
    subscription = next(each for each in bench.world.subscriptions if each.topic_name.endswith(topics.GROUND_REQUEST))
    bench.world.destroy_subscription(subscription)  # its process has ended
    bench.wait(lambda: not robot.node._ground._requests.get_subscription_count())
    robot.stack.gait.state.steps += 1
    robot.until(lambda: robot.limits[-1:] != [""])
    assert "no answer from the ground planner for 1 s: the robot walks without a map" in robot.limits[-1]
    assert robot.stack.gait.state.command.moves


def test_a_map_without_the_ground_on_the_way_is_reported_until_it_has_it(bench: Any, g1: RobotModel) -> None:
    robot = Guided(bench, g1)
    for known in (False, True):
        robot.stack.gait.state.steps += 1
        robot.drive(0.3)
        robot.send(Answer(robot.ask().number, level=known, blind=not known))
        bench.wait(lambda known=known: ("walks without a map" in robot.limits[-1]) is not known)


def test_the_report_of_a_walk_without_a_map_ends_with_its_goal(bench: Any, g1: RobotModel) -> None:
    robot = Guided(bench, g1)
    robot.go(1.0)
    robot.send(Answer(robot.ask().number, blind=True))
    bench.wait(lambda: "walks without a map" in robot.limits[-1])
    robot.stack.gait.end_route("done")
    robot.until(lambda: robot.routes[-1].state is RouteState.DONE and robot.limits[-1] == "")


def test_an_answer_counts_although_the_velocity_changes_meanwhile(bench: Any, g1: RobotModel) -> None:
    """A stick that moves commands a new velocity in every message."""
    robot = Guided(bench, g1)
    robot.drive(0.3)
    request = robot.ask()
    robot.drive(0.31, 0.02)
    robot.drive(0.3, -0.02)
    robot.send(Answer(request.number))
    robot.tick(1)
    assert not robot.stack.gait.state.command.moves
    assert not robot.requests or robot.requests[-1].number > 0  # the changes requested nothing


def test_a_gait_planner_that_is_deactivated_ends_its_goal(bench: Any, g1: RobotModel) -> None:
    robot = Guided(bench, g1)
    robot.go(1.0)
    robot.send(Answer(robot.ask().number, level=True))
    robot.node.trigger_deactivate()
    bench.wait(lambda: robot.routes[-1].state is RouteState.ENDED)


def test_a_velocity_towards_a_wall_stops_with_the_reason_until_it_ends(bench: Any, g1: RobotModel) -> None:
    robot = Guided(bench, g1)
    robot.drive(0.3)
    request = robot.ask()
    assert request.watch and request.query.distance == pytest.approx(0.9, abs=0.05)
    assert robot.stack.gait.state.command.moves
    robot.send(Answer(request.number))
    robot.tick(1)
    assert not robot.stack.gait.state.command.moves
    robot.stack.gait.reset(robot.state)  # it has stopped
    robot.until(lambda: [request for request in robot.requests if not request.watch])
    assert robot.limits[-1] == "stopped: the ground ahead is not level; searching for footsteps"
    robot.send(Answer(robot.requests[-1].number, (), WALL))
    robot.until(lambda: robot.limits and robot.limits[-1] == f"stopped: {WALL}")
    robot.drive(0.25, 0.1)  # as a stick that is held does
    robot.tick(1)
    assert not robot.stack.gait.state.command.moves
    robot.drive(0.25, 0.1, 0.5)  # it may turn
    robot.tick(1)
    assert robot.stack.gait.state.command.target == (0.0, 0.0, 0.5)
    robot.drive(0.0)
    robot.until(lambda: robot.limits[-1] == "")
    robot.drive(0.2)
    robot.tick(1)
    assert robot.stack.gait.state.command.moves


@pytest.mark.long
@pytest.mark.parametrize("turn", [0.0, 0.5])
def test_a_robot_that_was_stopped_asks_again(bench: Any, g1: RobotModel, turn: float) -> None:
    """It goes on where the way has become free; else it plans again, but while it turns."""
    robot = Guided(bench, g1)
    robot.drive(0.3)
    robot.send(Answer(robot.ask().number))
    robot.stack.gait.reset(robot.state)
    robot.until(lambda: [request for request in robot.requests if not request.watch])
    robot.send(Answer(robot.requests[-1].number, (), WALL))
    robot.until(lambda: robot.limits and robot.limits[-1] == f"stopped: {WALL}")
    robot.drive(0.3, turn=turn)
    robot.requests.clear()
    request = robot.ask()
    assert request.watch
    robot.send(Answer(request.number))
    robot.until(lambda: robot.requests)
    assert robot.requests[-1].watch == bool(turn) and robot.limits[-1] == f"stopped: {WALL}"
    if turn:
        robot.send(Answer(robot.requests[-1].number, blind=True))  # a map that is lost frees no way
        robot.requests.clear()
        robot.until(lambda: robot.requests)
        assert robot.limits[-1] == f"stopped: {WALL}"
        robot.send(Answer(robot.requests[-1].number, level=True))
        robot.until(lambda: robot.limits[-1] == "")
        robot.tick(1)
        assert robot.stack.gait.state.command.target == (0.3, 0.0, turn)


def test_the_ground_is_watched_along_an_oblique_velocity(bench: Any, g1: RobotModel) -> None:
    robot = Guided(bench, g1)
    robot.drive(0.2, 0.15)
    query = robot.ask().query
    assert query.line.yaw == pytest.approx(math.atan2(0.15, 0.2)) and query.distance == pytest.approx(0.85, abs=0.01)
    robot.send(Answer(robot.node._ground._number))
    robot.drive(0.15, 0.17)  # a little more to the left
    robot.tick(5)
    assert not robot.stack.gait.state.command.moves


@pytest.mark.parametrize("speed", [1e6, 1.5e308])
def test_the_ground_is_watched_no_farther_than_a_plan_at_any_velocity(bench: Any, g1: RobotModel, speed: float) -> None:
    robot = Guided(bench, g1)
    robot.drive(speed, speed)
    assert robot.ask().query.distance == 20.0


@pytest.mark.parametrize(
    ("velocity", "bearing", "where"),
    [((0.0, 0.2), 90.0, "to the left"), ((0.0, -0.2), -90.0, "to the right"), ((-0.2, 0.0), 180.0, "behind")],
)
def test_beside_and_behind_the_robot_stays_on_level_ground(
    bench: Any, g1: RobotModel, velocity: tuple[float, float], bearing: float, where: str
) -> None:
    robot = Guided(bench, g1)
    robot.drive(*velocity)
    request = robot.ask()
    assert request.watch and request.query.distance == pytest.approx(0.6, abs=0.01)
    assert request.query.line.yaw == pytest.approx(math.radians(bearing))
    assert robot.stack.gait.state.command.moves
    robot.send(Answer(request.number))
    robot.stack.gait.reset(robot.state)  # it has stopped
    robot.until(lambda: robot.limits and robot.limits[-1].startswith(f"stopped: the ground {where} is not level"))
    robot.tick(1)
    assert not robot.stack.gait.state.command.moves
    assert not [request for request in robot.requests if not request.watch]
    robot.drive(0.2)
    robot.until(lambda: robot.limits[-1] == "" and robot.stack.gait.state.command.moves)


@pytest.mark.parametrize("present", [True, False])
def test_a_late_answer_counts_for_the_command_that_it_was_asked_for(bench: Any, g1: RobotModel, present: bool) -> None:
    robot = Guided(bench, g1)
    robot.drive(0.3)
    late = robot.ask()
    if not present:
        robot.drive(-0.2)
        robot.ask()
    robot.stack.gait.state.steps += 1  # a touchdown, and the next watch
    assert robot.ask().number < late.number
    robot.send(Answer(late.number))
    robot.tick(1)
    assert robot.stack.gait.state.command.moves != present


def test_a_velocity_ends_a_goal_that_awaits_an_answer_with_its_reason(bench: Any, g1: RobotModel) -> None:
    robot = Guided(bench, g1)
    robot.go(1.0)
    robot.send(Answer(robot.ask().number, level=True))
    robot.stack.gait.end_route("done")
    robot.until(lambda: robot.routes[-1].state is RouteState.DONE)
    robot.go(1.0)
    robot.ask()
    robot.drive(0.3)
    robot.until(lambda: robot.routes[-1].state is RouteState.ENDED)
    assert robot.routes[-1].reason == "a velocity was commanded"


def test_stop_ends_a_plan(bench: Any, g1: RobotModel) -> None:
    robot = Guided(bench, g1)
    robot.go(2.0)
    robot.send(Answer(robot.ask().number))
    robot.send(Answer(robot.ask().number, steps(0.3), WALL))
    robot.halt.publish(Empty())
    robot.until(lambda: robot.routes[-1].state is RouteState.ENDED)
    assert robot.routes[-1].reason == "stopped" and not robot.left


def grid_map() -> Any:
    """Type of the map; skips the test where it is not built."""
    try:
        return grid_map_type()
    except MessageError as error:
        pytest.skip(str(error))


def test_the_ground_planner_answers_from_the_newest_map(
    bench: Any, g1: RobotModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    kind = grid_map()
    node, world = bench.add(GroundPlannerNode), bench.world
    answers: list[Answer] = []
    world.create_subscription(UInt8MultiArray, topics.GROUND_PLAN, lambda m: answers.append(decode(Answer, m)), EVENT)
    requests = world.create_publisher(UInt8MultiArray, topics.GROUND_REQUEST, EVENT)
    maps = world.create_publisher(kind, topics.TERRAIN_MAP, STATE)
    bench.wait(lambda: requests.get_subscription_count() and maps.get_subscription_count())
    query = GroundQuery(Foothold(0.0, 0.0, 0.0), 1.2, soles_at(Foothold(0.0, 0.0, 0.0), 0.2))

    def ask(number: int, stamp: float, *, watch: bool = False, around: bool = False) -> Answer:
        requests.publish(encode(Request(number, query, None, stamp, watch, around)))
        bench.wait(lambda: answers and answers[-1].number == number)
        return answers[-1]

    assert ask(1, 5.0).blind
    x = 0.02 * np.arange(-75, 75) + 0.01
    riser = np.where(x > 0.7, 0.15, 0.0)
    heights = np.repeat(riser[:, None], 150, axis=1)
    maps.publish(grid_map_message(5000 * MS, np.zeros(2), 0.02, {"elevation": heights}, "elevation"))
    bench.wait(lambda: node._map is not None)
    plan = ask(2, 5.1)
    assert not plan.level and not plan.blind and plan.reason == ""
    assert plan.steps[-1].hold.z == pytest.approx(0.15, abs=1e-3) and plan.steps[-1].hold.x > 0.75
    watched = ask(3, 5.1, watch=True)
    assert not watched.level and watched.steps == ()
    assert ask(5, 5.1, around=True).reason.startswith("no way around")  # the riser is as wide as the map
    assert ask(4, 7.0).blind  # the mapper is gone
    assert ask(6, 1.0).blind  # so is the clock of the map
    requests.publish(UInt8MultiArray(data=[1, 2, 3]))
    bench.wait(lambda: node.counters[f"refused {topics.GROUND_REQUEST}"] == 1)
    for refused, stamp in enumerate((math.nan, 1e30), start=2):
        record = msgpack.decode(bytes(encode(Request(7, query)).data)) | {"stamp": stamp}
        requests.publish(encode(record))
        bench.wait(lambda refused=refused: node.counters[f"refused {topics.GROUND_REQUEST}"] == refused)
        assert f"the stamp is {stamp} s, not between 0 and" in node.values["last refusal"]
    assert math.isfinite(node._took)

    def fails(*_: Any) -> Any:
        raise MessageError("no plan")

    monkeypatch.setattr(node._law, "plan", fails)
    assert ask(8, 5.2) == Answer(8, reason="no plan", blind=True) and "no plan" in node.values["last refusal"]
    monkeypatch.undo()
    node._map = node._map[:50]
    assert ask(7, 5.1).blind and node.counters[f"refused {topics.TERRAIN_MAP}"] == 1


@pytest.mark.parametrize(
    ("change", "culprit"),
    [
        ({"header.frame_id": "map"}, "'map' instead of 'odom'"),
        ({"info.resolution": 0.0}, "info.resolution is 0.0"),
        ({"info.resolution": math.inf}, "info.resolution is inf"),
        ({"info.pose.position.y": math.nan}, "the centre"),
        ({"size": 0}, "the size"),
    ],
)
def test_a_malformed_map_is_refused(change: dict[str, Any], culprit: str) -> None:
    grid_map()
    size = change.pop("size", 5)
    message = grid_map_message(0, np.zeros(2), 0.02, {"elevation": np.zeros((size, size))}, "elevation")
    for path, value in change.items():
        part, _, name = path.rpartition(".")
        setattr(operator.attrgetter(part)(message), name, value)
    with pytest.raises(MessageError, match=culprit):
        ground_from_message(message)


def test_a_map_may_contain_the_variance_of_its_heights() -> None:
    grid_map()
    layers = {"elevation": np.zeros((5, 5)), "variance": np.array([[4e-4, -1.0, np.nan, 0.0, 1e-4]] * 5)}
    ground = ground_from_message(grid_map_message(0, np.zeros(2), 0.02, layers, "elevation"))
    places = np.array([[0.0, 0.02 * k] for k in range(-2, 3)])
    np.testing.assert_allclose(ground.deviations_at(places), [0.02, 0.0, 0.0, 0.0, 0.01], atol=1e-6)
    bare = ground_from_message(grid_map_message(0, np.zeros(2), 0.02, {"elevation": np.zeros((5, 5))}, "elevation"))
    assert bare.deviations is None
    other = grid_map_message(
        0, np.zeros(2), 0.02, {"elevation": np.zeros((5, 5)), "variance": np.zeros((4, 4))}, "variance"
    )
    other.data[0] = grid_map_message(0, np.zeros(2), 0.02, {"elevation": np.zeros((5, 5))}, "elevation").data[0]
    with pytest.raises(MessageError, match=r"variance has the size \(4, 4\), elevation \(5, 5\)"):
        ground_from_message(other)
