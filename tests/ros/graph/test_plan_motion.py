"""Plans on request on the real graph in lockstep: hands, footsteps, calibrations, and a publisher of one's own."""

import math
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from sensor_msgs.msg import JointState

from bridge.launch.graph import Graph
from bridge.ros.client import Client
from bridge.ros.environment import free_domain
from bridge.ros.walk import reach
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.interfaces import interface
from models.nodes.messages import JointStateCodec
from models.nodes.qos import SENSOR
from models.robot_model import RobotModel
from models.types import Vector
from tests.ros.conftest import Eyes

try:
    Calibrate, PlanMotion, PlanFootsteps = (
        interface("poise_interfaces", "srv", name) for name in ("Calibrate", "PlanMotion", "PlanFootsteps")
    )
except PoiseError as _error:
    pytest.skip(str(_error), allow_module_level=True)

pytestmark = [pytest.mark.ros, pytest.mark.slow]

JOINT = "left_shoulder_pitch_joint"


class Standing:
    """A graph that stands in lockstep, with what is true of it."""

    def __init__(self, graph: Graph, model: RobotModel) -> None:
        self.graph, self.model, self.eyes = graph, model, Eyes(graph)
        self.samples: list[np.ndarray] = []
        self._codec, self._data = JointStateCodec(model), model.data()
        graph.node.create_subscription(JointState, topics.JOINT_STATES, self._on_joints, SENSOR, raw=True)

    def _on_joints(self, data: bytes) -> None:
        stamp, q, _, tau = self._codec.decode(data)
        self.samples.append(np.array([np.full(self.model.nj, 1e-9 * stamp), q, tau]))

    def call(self, kind: Any, name: str, request: Any) -> Any:
        """Response of a service."""
        return self.graph.ask(kind, name, request, 60.0)

    def hand(self, frame: str) -> Vector:
        """Where a frame truly is in odom, as far as the encoders tell (3,) [m]."""
        self.eyes.truth.clear()
        self.samples.clear()
        self.graph.wait_for(lambda: bool(self.eyes.truth and self.samples), 10.0, "publishing where it is")
        pin.framesForwardKinematics(
            self.model.pin, self._data, np.concatenate([self.eyes.truth[-1], self.samples[-1][1]])
        )
        return np.array(self._data.oMf[self.model.frame_id(frame)].translation)

    def pass_time(self, seconds: float) -> None:
        """Let simulated time pass [s]; the truth comes at 100 Hz."""
        self.eyes.truth.clear()
        self.graph.wait_for(lambda: len(self.eyes.truth) >= 100.0 * seconds, 120.0, "going on")


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Standing]:
    log = tmp_path_factory.mktemp("plans") / "log"
    with Graph("g1", domain_id=free_domain(), lockstep=True, log=log, say=lambda text: None) as graph:
        graph.wait_standing(120.0)
        yield Standing(graph, RobotModel.load("g1"))
    assert graph.exit_codes == dict.fromkeys(graph.pids, 0)


def target(place: Any, frame_id: str = "odom", frame: str = "left_hand", **more: Any) -> Any:
    """Request for a place (3,) [m]."""
    request = PlanMotion.Request(frame=frame, **more)
    request.target.header.frame_id = frame_id
    position = request.target.pose.position
    position.x, position.y, position.z = map(float, place)
    return request


def test_a_calibration_reports_its_numbers_with_units_and_keeps_nothing_unless_requested(robot: Standing) -> None:
    answer = robot.call(Calibrate, "calibrate", Calibrate.Request(what="imu", save=False))
    assert answer.success and answer.message.endswith("not stored, as requested"), answer.message
    values = {value.name: (value.value, value.unit) for value in answer.values}
    assert values["accel_norm"] == (pytest.approx(9.81, abs=0.3), "m/s^2")
    assert abs(values["gyro_bias_x"][0]) < 0.05 and values["gyro_bias_x"][1] == "rad/s"
    answer = robot.call(Calibrate, "calibrate", Calibrate.Request(what="show"))
    assert answer.success and "never calibrated" in answer.message
    answer = robot.call(Calibrate, "calibrate", Calibrate.Request(what="soul"))
    assert not answer.success and "imu, joints, feet" in answer.message


def test_the_plan_that_is_answered_brings_the_hand_there_when_it_is_published(robot: Standing) -> None:
    goal = robot.hand("l_wrist") + np.array([0.1, 0.05, 0.15])
    answer = robot.call(PlanMotion, "plan_motion", target(goal, duration=2.0))
    assert answer.success and "left_hand reaches the target in 2.00 s" in answer.message, answer.message
    robot.eyes.motion.clear()
    robot.eyes.motions.publish(answer.trajectory)
    robot.graph.wait_for(lambda: robot.eyes.motion == ["running", "done"], 120.0, "there")
    robot.pass_time(2.0)
    assert np.linalg.norm(robot.hand("l_wrist") - goal) < 0.020
    assert robot.graph.mode == "stand"


def test_the_planner_has_it_executed_and_says_what_stands_in_the_way(robot: Standing) -> None:
    goal = robot.hand("r_wrist") + np.array([0.1, 0.0, 0.1])
    robot.eyes.motion.clear()
    answer = robot.call(PlanMotion, "plan_motion", target(goal, frame="right_hand", execute=True))
    assert answer.success, answer.message
    robot.graph.wait_for(lambda: robot.eyes.motion == ["running", "done"], 120.0, "there")
    robot.pass_time(2.0)
    assert np.linalg.norm(robot.hand("r_wrist") - goal) < 0.020
    answer = robot.call(PlanMotion, "plan_motion", target((1.5, 0.2, 0.3), "base_link"))
    assert not answer.success and not answer.trajectory.points
    missed = re.search(r"position of l_wrist missed by (\d\.\d+) m", answer.message)
    assert missed and 0.5 < float(missed[1]) < 1.5, answer.message
    answer = robot.call(PlanMotion, "plan_motion", target((0.3, 0.2, 0.2), "map"))
    assert not answer.success and "unknown frame 'map'" in answer.message


def test_the_command_line_has_a_hand_brought_to_a_place(robot: Standing) -> None:
    with Client() as client:
        reply = reach(client, "left_hand", (0.25, 0.25, 0.15), frame_id="base_link")
        assert reply.accepted and reply.reason.endswith("; done"), reply.reason
        reply = reach(client, "left_hand", (0.2, 0.25, 0.1), frame_id="base_link", execute=False)
        assert reply.accepted and "done" not in reply.reason
        reply = reach(client, "tail", (0.2, 0.25, 0.1), frame_id="base_link")
        assert not reply.accepted and "'tail' cannot be moved" in reply.reason


def test_footsteps_are_planned_from_where_the_robot_stands(robot: Standing) -> None:
    request = PlanFootsteps.Request()
    request.goal.header.frame_id = "odom"
    request.goal.pose.position.x = 1.0
    answer = robot.call(PlanFootsteps, "gait/plan_footsteps", request)
    assert answer.success and answer.message == f"{len(answer.footsteps)} footsteps"
    sides = [step.side for step in answer.footsteps]
    assert len(sides) > 4 and set(sides[::2]) | set(sides[1::2]) == {"left", "right"} and sides[0] != sides[1]
    times = [step.time_from_start.sec + 1e-9 * step.time_from_start.nanosec for step in answer.footsteps]
    assert 0.3 < times[0] < 2.0 and np.ptp(np.diff(times)) < 1e-6 and np.diff(times)[0] > 0.3
    ends = [step.pose.pose.position.x for step in answer.footsteps[-2:]]
    assert ends == pytest.approx([1.0, 1.0], abs=0.01)


def test_a_plain_publisher_moves_an_arm(robot: Standing, root: Path, tmp_path: Path) -> None:
    code = re.findall(r"```python\n(.*?)```", (root / "docs/motions.md").read_text(), re.DOTALL)
    (tmp_path / "arm_sine.py").write_text(next(block for block in code if "arm_sine" in block))
    index = robot.model.joint_index(JOINT)
    robot.pass_time(1.0)
    robot.samples.clear()
    robot.eyes.motion.clear()
    command = [sys.executable, str(tmp_path / "arm_sine.py"), "--ros-args", "-p", "use_sim_time:=true"]
    process = subprocess.Popen(command, env=dict(os.environ))
    try:
        robot.graph.wait_for(lambda: "running" in robot.eyes.motion, 30.0, "following")
        robot.pass_time(6.0)
    finally:
        process.kill()
        process.wait()
    assert robot.graph.mode == "stand"
    samples = np.array(robot.samples)  # (n, 3, nj): stamp, position, torque
    assert 0.4 < np.ptp(samples[:, 1, index]) < 0.7
    steps = np.abs(np.diff(samples[:, 2], axis=0))[np.diff(samples[:, 0, 0]) < 0.0015] / robot.model.tau_max
    assert len(steps) > 1000 and steps.max() < 0.10
    t, joint = samples[-3000:, 0, 0], samples[-3000:, 1, index]
    curve = np.stack([np.ones_like(t), np.cos(math.pi * t), np.sin(math.pi * t)], axis=1)
    rest = joint - curve @ np.linalg.lstsq(curve, joint, rcond=None)[0]
    assert np.degrees(np.abs(rest).max()) < 5.0  # a sine, whatever its phase
