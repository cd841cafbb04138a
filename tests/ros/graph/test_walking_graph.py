"""The graph walks: on cmd_vel, on the supervisor's words, and not before it stands. In lockstep."""

import math
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Twist
from nav_msgs.msg import Path as Footsteps
from std_msgs.msg import Float64, String

from bridge.launch.graph import Graph
from bridge.ros.environment import free_domain
from models.heading import heading
from models.nodes import topics
from models.nodes.odometry import velocity_to_twist
from models.nodes.qos import COMMAND, EVENT, LATCHED, SENSOR
from tests.ros.conftest import Eyes

pytestmark = [pytest.mark.ros, pytest.mark.graph]


class WalkingGraph(Eyes):
    """What the tests see of a walk."""

    def __init__(self, graph: Graph) -> None:
        super().__init__(graph)
        self.phases: list[str] = []
        self.margins: list[float] = []
        self.planned: list[Footsteps] = []
        self.taken: list[Footsteps] = []
        node = graph.node
        node.create_subscription(String, topics.GAIT_PHASE, lambda m: self.phases.append(m.data), LATCHED)
        node.create_subscription(Float64, topics.GAIT_CAPTURE_MARGIN, lambda m: self.margins.append(m.data), SENSOR)
        node.create_subscription(Footsteps, topics.FOOTSTEPS, self.planned.append, EVENT)
        node.create_subscription(Footsteps, topics.FOOTSTEPS_TAKEN, self.taken.append, EVENT)
        self.cmd_vel = node.create_publisher(Twist, topics.CMD_VEL, COMMAND)

    @property
    def place(self) -> np.ndarray:
        """True position of the base (2,)."""
        return self.truth[-1][:2]

    def until(self, condition: Callable[[], bool], what: str, meanwhile: Callable[[], object] = lambda: None) -> None:
        """Wait for something, doing something every 20 ms."""

        def look() -> bool:
            meanwhile()
            return condition()

        self.graph.wait_for(look, 60.0, what)

    def stand(self) -> None:
        """Stand up where no test before has asked for it."""
        if not self.graph.standing:
            self.until(lambda: self.ask("mode/stand")[0], "allowed to stand")
            self.graph.wait_standing()

    def stop(self) -> None:
        """Back to mode stand."""
        assert self.ask("mode/stand")[0]
        self.until(lambda: self.graph.mode == "stand", "standing")


@pytest.fixture(scope="module")
def walking(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WalkingGraph]:
    log = tmp_path_factory.mktemp("walking") / "log"
    os.environ["ROS_LOG_DIR"] = str(log.parent)
    parameters = {"supervisor": {"auto_stand": False}}
    with Graph(
        "g1", lockstep=True, domain_id=free_domain(), log=log, say=lambda text: None, parameters=parameters
    ) as graph:
        seen = WalkingGraph(graph)
        seen.until(lambda: bool(seen.phases) and bool(graph.mode), "publishing the gait's phase")
        yield seen
    assert graph.exit_codes == dict.fromkeys(graph.pids, 0)


def test_walking_before_standing_is_refused(walking: WalkingGraph) -> None:
    accepted, reason = walking.ask("mode/walk")
    assert not accepted
    assert "request 'stand' first" in reason
    send = lambda: walking.cmd_vel.publish(velocity_to_twist((0.3, 0.0, 0.0)))  # noqa: E731
    walking.refusal("supervisor", topics.CMD_VEL, send, "request 'stand' first")
    walking.stand()


def test_a_velocity_while_standing_walks_and_zero_ends_in_a_stand(walking: WalkingGraph) -> None:
    walking.stand()
    start = walking.place.copy()
    ahead, still = (velocity_to_twist((speed, 0.0, 0.0)) for speed in (0.3, 0.0))
    walking.until(lambda: walking.place[0] - start[0] > 0.2, "ahead", lambda: walking.cmd_vel.publish(ahead))
    assert walking.graph.mode == "walk"
    walking.until(lambda: walking.graph.mode == "stand", "standing", lambda: walking.cmd_vel.publish(still))
    assert walking.truth[-1][2] > 0.6


def test_it_walks_on_cmd_vel_and_stops_when_that_falls_silent(walking: WalkingGraph) -> None:
    walking.stand()
    assert walking.ask("mode/walk")[0]
    walking.until(lambda: walking.graph.mode == "walk" and walking.phases[-1] == topics.GAIT_SETTLED, "in mode walk")
    walking.margins.clear()
    walking.taken.clear()
    start = walking.place.copy()
    message = velocity_to_twist((0.3, 0.0, 0.0))
    walking.until(
        lambda: walking.place[0] - start[0] > 0.5, "half a metre ahead", lambda: walking.cmd_vel.publish(message)
    )
    assert abs(walking.place[1] - start[1]) < 0.1
    assert {"start", "single left", "single right", "double"} <= set(walking.phases)
    margins = np.array(walking.margins)
    assert np.isfinite(margins).all() and margins.min() > 0.0
    steps = len(walking.taken)
    walking.until(lambda: walking.phases[-1] == topics.GAIT_SETTLED, "standing still")
    assert len(walking.taken) - steps <= 4  # silence ends the walk after 0.5 s, then two steps
    still = walking.place.copy()
    walking.graph.spin(1.0)
    assert np.linalg.norm(walking.place - still) < 0.01
    assert walking.graph.mode == "walk"

    ahead = [pose.pose.position.x for pose in walking.planned[len(walking.planned) // 2].poses]
    assert len(ahead) >= 2 and ahead == sorted(ahead)
    feet = np.array([[pose.pose.position.x, pose.pose.position.y] for pose in walking.taken[-1].poses])
    feet = feet[-len(walking.taken) :]  # of this walk
    assert feet[-3, 0] - feet[0, 0] > 0.3  # they are where it walked
    assert np.abs(np.diff(feet[:, 1])).min() > 0.1  # and alternate
    walking.stop()


def test_velocities_that_are_no_numbers_are_refused_by_name(walking: WalkingGraph) -> None:
    walking.stand()
    assert walking.ask("mode/walk")[0]
    walking.until(lambda: walking.graph.mode == "walk", "in mode walk")
    place = walking.place.copy()
    for field, velocity in (("linear.y", (0.3, math.nan, 0.0)), ("angular.z", (0.3, 0.0, math.inf))):
        bad = velocity_to_twist(velocity)
        send = lambda bad=bad: walking.cmd_vel.publish(bad)  # noqa: E731
        walking.refusal("supervisor", topics.CMD_VEL, send, field)
    assert np.linalg.norm(walking.place - place) < 0.02
    walking.stop()


def _poise(*arguments: str) -> tuple[int, str]:
    """Exit code and output of the command line, in a process of its own."""
    command = [str(Path(sys.executable).parent / "poise"), *arguments]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    return result.returncode, result.stdout + result.stderr


def test_the_command_line_walks_and_stands_again(walking: WalkingGraph) -> None:
    walking.stand()
    received: list[float] = []
    subscription = walking.graph.node.create_subscription(
        Twist, topics.CMD_VEL, lambda m: received.append(m.linear.x), EVENT
    )
    walking.taken.clear()
    code, output = _poise("walk", "--seconds", "1.5", "-0.2", "9", "0")
    assert code == 0, output
    output = " ".join(output.split())
    assert "mode 'stand'" in output and "left 9 limited to" in output
    walking.until(
        lambda: walking.graph.mode == "stand" and bool(received and walking.taken), "standing after some steps"
    )
    assert set(received) == {-0.2}
    code, output = _poise("walk", "nan")
    assert code == 2
    assert "must be finite" in output
    assert walking.graph.mode == "stand"
    walking.graph.node.destroy_subscription(subscription)


@pytest.mark.slow
def test_the_command_line_walks_to_a_pose(walking: WalkingGraph) -> None:
    walking.stand()
    here = walking.place.copy()
    code, output = _poise("walk", "--to", f"{here[0] - 0.15:.3f}", f"{here[1]:.3f}", "-0.2")
    assert code == 0, output
    ended = r": done; base at x [-\d.]+ m, y [-\d.]+ m, heading [-\d.]+ rad; mode 'stand'"
    assert re.search(rf"goal x {here[0] - 0.15:.2f} m, y {here[1]:.2f} m{ended}", output)
    walking.until(lambda: walking.graph.mode == "stand", "standing")
    walking.graph.spin(0.2)
    assert np.linalg.norm(walking.place - here - (-0.15, 0.0)) < 0.05  # truth and estimate start together


def test_words_set_the_velocity_a_wave_goes_with_it_and_stop_ends_in_stand(walking: WalkingGraph) -> None:
    walking.stand()
    start = walking.place.copy()
    walking.graph.send("walk")
    walking.until(lambda: walking.graph.mode == "walk", "in mode walk")
    walking.graph.send("backward")
    walking.until(lambda: walking.place[0] - start[0] < -0.1, "walking backward")
    walking.motion.clear()
    walking.graph.send("wave")
    for word, velocity in (
        ("left", "(0.000 m/s, 0.150 m/s, 0.000 rad/s)"),
        ("right", "(0.000 m/s, -0.150 m/s, 0.000 rad/s)"),
        ("forward", "(0.300 m/s, 0.000 m/s, 0.000 rad/s)"),
        ("spin", "(0.000 m/s, 0.000 m/s, 0.600 rad/s)"),
        ("turn", "(0.000 m/s, 0.000 m/s, 0.400 rad/s)"),
    ):
        walking.graph.send(word)
        report = walking.reports["/gait_planner"]
        walking.until(lambda velocity=velocity: walking.reports["/gait_planner"]["velocity"] == velocity, word)
        assert report["message"] != topics.GAIT_SETTLED
    before = heading(*walking.truth[-1][3:])
    walking.until(lambda: heading(*walking.truth[-1][3:]) - before > 0.15, "turning to the left")
    assert walking.motion[0] == "running"  # it waves meanwhile
    walking.refusal("supervisor", topics.HUMANOID_COMMANDS, lambda: walking.graph.send("squat"), "only: wave")
    assert walking.graph.mode == "walk"
    walking.graph.send("stop")
    walking.phases.clear()
    seen: list[Any] = []
    walking.until(lambda: walking.graph.mode == "stand", "standing", lambda: seen.extend(walking.phases[-1:]))
    assert "finish" in seen  # it took its last steps first
    assert walking.motion[-1] in ("done", "ended: stopped")
    walking.graph.spin(0.5)
    assert walking.truth[-1][2] > 0.6  # [m] and stands
