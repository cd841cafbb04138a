"""Over ROS 2 up a flight that the robot knows: by footsteps with heights, then to a goal on a given map."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from geometry_msgs.msg import PoseStamped

from bridge.launch.layout import process_specs
from models.nodes import topics
from models.nodes.qos import EVENT
from models.terrain import terrain_named
from planners.gait.footsteps import Foothold
from planners.nodes.footstep_messages import pose_message
from planners.terrain.given_map import save_given_map, terrain_heights
from tests.ros.conftest import Eyes, standing_graph

pytestmark = [pytest.mark.ros, pytest.mark.graph]

EXAMPLE = Path(__file__).parents[3] / "examples" / "footsteps_up_stairs.py"
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


def test_listed_footsteps_with_heights_climb_two_steps(eyes: Eyes) -> None:
    """As the example lists them."""
    program = subprocess.Popen([sys.executable, str(EXAMPLE), "2"])
    try:
        eyes.graph.wait_for(lambda: program.poll() is not None, PATIENCE, "at the last footstep")
    finally:
        program.kill()
        program.wait()
    assert program.returncode == 0
    eyes.graph.wait_for(lambda: climbed(eyes) > 1.9 * FLIGHT.height, PATIENCE, "upright, two steps up")
    assert climbed(eyes) == pytest.approx(2.0 * FLIGHT.height, abs=0.03)


def test_a_goal_on_the_given_map_is_reached_up_the_remaining_steps(eyes: Eyes) -> None:
    publisher = eyes.graph.node.create_publisher(PoseStamped, topics.GOAL_POSE, EVENT)
    eyes.graph.wait_for(lambda: publisher.get_subscription_count() > 0, PATIENCE, "discovered")
    landing = FLIGHT.patch + (FLIGHT.count - 1) * FLIGHT.size + 0.5 * FLIGHT.landing
    publisher.publish(pose_message(Foothold(landing, 0.0, 0.0), topics.ODOM_FRAME))
    eyes.graph.wait_for(lambda: climbed(eyes) > (FLIGHT.count - 0.1) * FLIGHT.height, PATIENCE, "on the landing")
    eyes.graph.wait_for(lambda: abs(eyes.truth[-1][0] - landing) < 0.1, PATIENCE, "at the goal")
    assert climbed(eyes) == pytest.approx(FLIGHT.count * FLIGHT.height, abs=0.05)
