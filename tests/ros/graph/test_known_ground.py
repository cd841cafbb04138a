"""Over ROS 2 up a flight that the robot knows: by footsteps with heights, then to a goal on a given map."""

from collections.abc import Iterator
from itertools import takewhile

import pytest
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path as Footsteps

from bridge.launch.layout import process_specs
from models.nodes import topics
from models.nodes.qos import EVENT, LATCHED_EVENT
from models.nodes.status import subscribe_status
from models.robot_model import RobotModel
from models.status import RouteState, RouteStatus
from models.terrain import Terrain, terrain_named
from planners.gait.footsteps import Foothold, middle
from planners.gait.measurement import GaitMeasurement
from planners.gait.scaling import load_gait_config
from planners.nodes.footstep_messages import path_from_steps, pose_message
from planners.terrain.given_map import save_given_map, terrain_heights
from planners.terrain.stairs import Stairs, stair_footsteps
from tests.ros.conftest import Eyes, standing_graph
from tests.support import standing

pytestmark = [pytest.mark.ros, pytest.mark.graph]

FLIGHT = terrain_named("flight")
PATIENCE = 120.0  # [s], on a slow machine


@pytest.fixture(scope="module")
def eyes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Eyes]:
    folder = tmp_path_factory.mktemp("graph")
    save_given_map(folder / "flight.yaml", terrain_heights(FLIGHT))
    parameters = {
        "robot_driver": {"terrain": "flight"},
        "terrain_mapper": {"given_map": str(folder / "flight.yaml")},
    }
    with standing_graph(folder, specs=process_specs(given_map=True), parameters=parameters) as seen:
        yield seen


def climbed(eyes: Eyes) -> float:
    """True height of the base above its height at the start [m]."""
    return float(eyes.truth[-1][2] - eyes.truth[0][2])


def footsteps_up(terrain: Terrain, rises: int) -> Footsteps:
    """Footsteps from the start until both feet stand this many steps up."""
    robot = RobotModel.load("g1")
    here = middle(GaitMeasurement(robot).measure(standing(robot)).soles)
    stairs = Stairs(terrain.patch - here.x, terrain.height, terrain.size, terrain.count, terrain.landing, 6.0)
    steps = stair_footsteps(stairs, here, robot, load_gait_config(robot), stride=0.25, together=True)
    top = here.z + rises * terrain.height
    return path_from_steps(0, list(takewhile(lambda step: step.hold.z < top + 0.5 * terrain.height, steps)))


def test_listed_footsteps_with_heights_climb_two_steps(eyes: Eyes) -> None:
    steps = footsteps_up(FLIGHT, 2)
    routes: list[RouteStatus] = []
    subscribe_status(eyes.graph.node, RouteStatus, topics.ROUTE_STATUS, routes.append, LATCHED_EVENT)
    publisher = eyes.graph.node.create_publisher(Footsteps, topics.FOOTSTEPS_COMMAND, EVENT)
    assert eyes.ask("mode/walk")[0]
    eyes.graph.wait_for(lambda: eyes.graph.mode == "walk", PATIENCE, "in mode walk")
    eyes.graph.wait_for(lambda: publisher.get_subscription_count() > 0, PATIENCE, "discovered")
    publisher.publish(steps)
    eyes.graph.wait_for(lambda: climbed(eyes) > 1.9 * FLIGHT.height, PATIENCE, "two steps up")
    eyes.graph.wait_for(lambda: routes[-1].state is RouteState.DONE, PATIENCE, "standing at the last footstep")
    assert climbed(eyes) == pytest.approx(2.0 * FLIGHT.height, abs=0.03)


def test_a_goal_on_the_given_map_is_reached_up_the_remaining_steps(eyes: Eyes) -> None:
    publisher = eyes.graph.node.create_publisher(PoseStamped, topics.GOAL_POSE, EVENT)
    eyes.graph.wait_for(lambda: publisher.get_subscription_count() > 0, PATIENCE, "discovered")
    landing = FLIGHT.patch + (FLIGHT.count - 1) * FLIGHT.size + 0.5 * FLIGHT.landing
    publisher.publish(pose_message(Foothold(landing, 0.0, 0.0), topics.ODOM_FRAME))
    eyes.graph.wait_for(lambda: climbed(eyes) > (FLIGHT.count - 0.1) * FLIGHT.height, PATIENCE, "on the landing")
    eyes.graph.wait_for(lambda: abs(eyes.truth[-1][0] - landing) < 0.1, PATIENCE, "at the goal")
    assert climbed(eyes) == pytest.approx(FLIGHT.count * FLIGHT.height, abs=0.05)
