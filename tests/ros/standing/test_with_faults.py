"""The real graph when a process is killed, the robot falls, or somebody pulls the brake."""

import os

import pytest
from geometry_msgs.msg import WrenchStamped
from std_msgs.msg import String

from bridge.launch.graph import Graph
from models.nodes import topics
from models.nodes.qos import LATCHED
from tests.ros.conftest import Eyes

pytestmark = [pytest.mark.ros, pytest.mark.graph]


def test_a_killed_planner_is_restarted_alone(eyes: Eyes, undisturbed: None) -> None:
    before = dict(eyes.graph.pids)
    os.kill(before["planners.nodes.motion_planner"], 9)
    eyes.graph.wait_for(lambda: eyes.graph.pids != before, 60.0, "restarted")
    changed = [name for name, pid in eyes.graph.pids.items() if pid != before[name]]
    assert changed == ["planners.nodes.motion_planner"]


def _restart_supervisor(graph: Graph) -> None:
    before = graph.pids["controllers.nodes.supervisor"]
    os.kill(before, 9)
    graph.wait_for(lambda: graph.pids["controllers.nodes.supervisor"] != before, 60.0, "restarted")


def test_a_killed_supervisor_leaves_the_robot_standing(eyes: Eyes, undisturbed: None) -> None:
    modes: list[str] = []
    subscription = eyes.graph.node.create_subscription(
        String, topics.MODE, lambda message: modes.append(message.data), LATCHED
    )
    _restart_supervisor(eyes.graph)
    eyes.graph.wait_for(lambda: bool(modes), 20.0, "saying its mode")
    eyes.graph.spin(0.5)
    eyes.graph.node.destroy_subscription(subscription)
    assert set(modes) == {"stand"}


def test_a_supervisor_killed_while_damped_comes_back_with_a_fault(eyes: Eyes) -> None:
    assert eyes.ask("estop")[0]
    eyes.graph.wait_for(lambda: eyes.graph.driver_state == "damped", 1.0, "damped")
    _restart_supervisor(eyes.graph)
    fault = "the drivers were damped when the supervisor started"
    eyes.graph.wait_for(lambda: fault in eyes.reports["/supervisor"]["message"], 20.0, f"reporting '{fault}'")
    accepted, reason = eyes.ask("mode/stand")
    assert not accepted and fault in reason
    assert eyes.ask("reset_faults")[0]
    assert eyes.ask("reset")[0]
    eyes.graph.wait_standing(90.0)


def test_a_fallen_robot_is_not_armed_again(eyes: Eyes) -> None:
    push = eyes.publisher(WrenchStamped, topics.PUSH)
    message = WrenchStamped()
    message.header.frame_id = "torso_link"
    message.wrench.force.x = 800.0
    push.publish(message)
    eyes.graph.wait_for(lambda: eyes.graph.driver_state == "damped", 10.0, "damped")
    eyes.graph.wait_for(lambda: eyes.truth[-1][2] < 0.4, 10.0, "lying")  # [m]
    assert eyes.ask("reset_faults")[0]
    eyes.graph.spin(1.0)  # whatever the checks find, they have found it
    accepted, reason = eyes.ask("mode/stand")
    assert not accepted, reason
    assert "base tilted by" in reason
    assert eyes.graph.driver_state == "damped"
    assert eyes.ask("reset")[0]
    eyes.graph.wait_standing(90.0)


def test_a_killed_controller_damps_and_the_robot_can_be_brought_back(eyes: Eyes) -> None:
    graph, module = eyes.graph, "bridge.nodes.control"
    before = graph.pids[module]
    os.kill(before, 9)
    graph.wait_for(lambda: graph.driver_state == "damped", 20.0, "damped")
    graph.wait_for(lambda: graph.pids[module] != before, 60.0, "restarted")
    accepted, reason = eyes.ask("mode/stand")
    assert not accepted, reason
    assert "fell back to damping" in reason
    assert eyes.ask("reset_faults")[0]
    assert eyes.ask("reset")[0]
    graph.wait_standing(90.0)


def test_estop_damps_at_once_and_latches(eyes: Eyes) -> None:
    accepted, _ = eyes.ask("estop")
    assert accepted
    eyes.graph.wait_for(lambda: eyes.graph.driver_state == "damped", 1.0, "damped")
    accepted, reason = eyes.ask("mode/stand")
    assert not accepted, reason
    assert "emergency stop" in reason
    assert eyes.ask("reset_faults")[0]
    assert eyes.ask("reset")[0]  # back to the start: held, checked, and standing again
    eyes.graph.wait_standing(90.0)
