"""The graph at 500 Hz: sensors, laws and drivers with a period of 2 ms."""

import os

import pytest
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry

from bridge.launch.graph import Graph
from models.nodes import topics
from models.nodes.qos import COMMAND, SENSOR
from tests.ros.conftest import free_domain

pytestmark = [pytest.mark.ros, pytest.mark.graph]


def test_the_robot_stands_waves_and_walks_with_a_driver_of_500_hz(tmp_path_factory: pytest.TempPathFactory) -> None:
    log = tmp_path_factory.mktemp("rate") / "log"
    os.environ["ROS_LOG_DIR"] = str(log.parent)
    parameters = {"robot_driver": {"rate": 500.0}}
    places: list[float] = []
    with Graph(
        "g1", lockstep=True, domain_id=free_domain(), log=log, say=lambda text: None, parameters=parameters
    ) as graph:
        node = graph.node
        node.create_subscription(Odometry, topics.GROUND_TRUTH, lambda m: places.append(m.pose.pose.position.x), SENSOR)
        velocity = node.create_publisher(Twist, topics.CMD_VEL, COMMAND)
        graph.wait_standing(120.0)
        graph.send("wave")
        graph.wait_for(lambda: graph.mode == "motion", 60.0, "waving")
        graph.wait_for(lambda: graph.mode == "stand", 120.0, "done waving")
        graph.send("walk")
        graph.wait_for(lambda: graph.mode == "walk", 60.0, "walking")
        start, message = places[-1], Twist()
        message.linear.x = 0.3

        def walked() -> bool:
            velocity.publish(message)
            return places[-1] > start + 0.4

        graph.wait_for(walked, 120.0, "forward")
        assert graph.call("mode/stand")[0]
        graph.wait_for(lambda: graph.standing, 60.0, "standing again")
