"""Every node in its own process, each killed and restarted alone: the robot stands, walks, or is damped."""

import os
from collections.abc import Iterator

import pytest
from geometry_msgs.msg import Twist
from nav_msgs.msg import Path
from std_msgs.msg import String

from models.nodes import topics
from models.nodes.odometry import velocity_to_twist
from models.nodes.qos import COMMAND, EVENT, LATCHED
from tests.ros.conftest import Eyes

pytestmark = [pytest.mark.ros, pytest.mark.graph]

PROCESSES = "separate"
#: Time goes on before a killed process is there again, as on a real robot
PARAMETERS = {"robot_driver": {"yield_max": 1.0}}
GAIT = "planners.nodes.gait_planner"
UPRIGHT = 0.65  #: Least height of the base of a standing G1 [m]


def restart(eyes: Eyes, module: str) -> None:
    """Kill a process and wait until it, and no other one, has been restarted."""
    before = dict(eyes.graph.pids)
    os.kill(before[module], 9)
    eyes.graph.wait_for(lambda: eyes.graph.pids[module] != before[module], 120.0, "restarted")
    assert [name for name, pid in eyes.graph.pids.items() if pid != before[name]] == [module]


class Walker:
    """A user who drives, and what is received of the gait."""

    def __init__(self, eyes: Eyes) -> None:
        self.graph = eyes.graph
        self.steps = 0
        self.phase = ""
        self._speaks = False
        self._velocity = eyes.graph.node.create_publisher(Twist, topics.CMD_VEL, COMMAND)
        eyes.graph.node.create_subscription(Path, topics.FOOTSTEPS_TAKEN, self._on_step, EVENT)
        eyes.graph.node.create_subscription(String, topics.GAIT_PHASE, self._on_phase, LATCHED)
        eyes.graph.node.create_timer(0.05, self._speak)

    def walk(self, steps: int) -> None:
        """Drive until so many steps have been taken."""
        self.steps, self._speaks = 0, True
        self.graph.wait_for(lambda: self.steps >= steps and self.graph.mode == "walk", 120.0, "walking")

    def silence(self) -> None:
        """Command zero, and wait until the robot stands still."""
        self._speaks = False
        self._velocity.publish(Twist())
        self.graph.spin(0.5)  # of two velocities that come together only the newer one is read
        self.graph.wait_for(lambda: (self.graph.mode, self.phase) == ("stand", "settled"), 60.0, "standing still")

    def _on_step(self, message: Path) -> None:
        self.steps += 1

    def _on_phase(self, message: String) -> None:
        self.phase = message.data

    def _speak(self) -> None:
        if self._speaks:
            self._velocity.publish(velocity_to_twist((0.2, 0.0, 0.0)))


@pytest.fixture(scope="module")
def walker(eyes: Eyes) -> Iterator[Walker]:
    return Walker(eyes)


def test_control_nodes_do_not_subscribe_to_the_true_state(eyes: Eyes) -> None:
    eyes.check_truth()


def test_a_killed_gait_planner_ends_a_walk_in_a_stand(eyes: Eyes, walker: Walker) -> None:
    walker.walk(steps=3)
    modes: list[str] = []
    subscription = eyes.graph.node.create_subscription(
        String, topics.MODE, lambda message: modes.append(message.data), LATCHED
    )
    restart(eyes, GAIT)  # the user drives on
    eyes.graph.wait_for(lambda: eyes.graph.mode == "stand", 30.0, "standing")
    eyes.truth.clear()
    eyes.graph.spin(1.0)
    eyes.graph.node.destroy_subscription(subscription)
    assert set(modes) == {"walk", "stand"} and modes[-1] == "stand"
    assert eyes.graph.driver_state == topics.ACTIVE
    assert min(base[2] for base in eyes.truth) > UPRIGHT
    walker.silence()
    walker.walk(steps=2)
    walker.silence()
    assert eyes.truth[-1][2] > UPRIGHT


def test_the_robot_stands_on_without_a_gait_planner(eyes: Eyes, undisturbed: None) -> None:
    """The processes of the other planner and of the supervisor are those of ``standing/test_with_faults.py``."""
    restart(eyes, GAIT)


@pytest.mark.parametrize("module", ["controllers.nodes.state_estimator", "controllers.nodes.balance_controller"])
def test_the_robot_is_damped_without_and_walks_again_after_a_reset(eyes: Eyes, walker: Walker, module: str) -> None:
    graph = eyes.graph
    restart(eyes, module)
    graph.wait_for(lambda: graph.driver_state == topics.DAMPED, 20.0, "damped")
    accepted, reason = eyes.ask("mode/stand")
    assert not accepted, reason
    assert eyes.ask("reset_faults")[0]
    assert eyes.ask("reset")[0]
    graph.wait_standing(90.0)
    walker.walk(steps=2)
    walker.silence()
    assert eyes.truth[-1][2] > UPRIGHT
