"""Refusals of the real graph reach the sender on ``/refusals`` and in the terminal."""

from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from trajectory_msgs.msg import JointTrajectory

from models.nodes import topics
from models.nodes.qos import LATCHED
from models.robot_model import RobotModel
from tests.ros.conftest import Eyes
from tests.ros.trajectories import arm, point

pytestmark = [pytest.mark.ros, pytest.mark.graph]


def test_a_wrong_joint_is_answered_with_the_nearest_one_in_the_terminal_and_on_refusals(
    eyes: Eyes, g1: RobotModel, tmp_path: Path
) -> None:
    node = eyes.graph.node
    publisher = eyes.publisher(JointTrajectory, topics.JOINT_TRAJECTORY)
    for _ in range(9):
        publisher.publish(point(["right_sholder_roll_joint"], [0.0], 1.0))
        eyes.graph.spin(0.02)
    reported: list[str] = []
    node.create_subscription(DiagnosticStatus, topics.REFUSALS, lambda m: reported.append(m.message), LATCHED)
    expected = (
        f"{topics.JOINT_TRAJECTORY} refused: g1: unknown joint 'right_sholder_roll_joint': "
        "did you mean 'right_shoulder_roll_joint'? `poise joints` lists all"
    )
    eyes.graph.wait_for(lambda: expected in reported, 10.0, "reported")
    terminal = Path(str(eyes.graph._log)).read_text(encoding="utf-8")
    assert len([line for line in terminal.splitlines() if expected in line]) == 1


def test_what_a_service_refuses_is_reported_too(eyes: Eyes) -> None:
    accepted, reason = eyes.ask(topics.FAULTS_INJECT)
    reported: list[str] = []
    eyes.graph.node.create_subscription(
        DiagnosticStatus, topics.REFUSALS, lambda m: reported.append(m.message), LATCHED
    )
    assert not accepted
    eyes.graph.wait_for(lambda: f"{topics.FAULTS_INJECT} refused: {reason}" in reported, 10.0, "reported")


def test_textbook_names_move_the_joints(eyes: Eyes, g1: RobotModel) -> None:
    publisher = eyes.publisher(JointTrajectory, topics.JOINT_TRAJECTORY)
    start = arm(eyes, g1, "right_elbow_joint"), arm(eyes, g1, "left_shoulder_pitch_joint")
    for elbow, shoulder in ((start[0] - 0.3, start[1] - 0.2), start):  # there and back, for the tests that follow
        publisher.publish(point(["right_elbow", "l_shoulder"], [elbow, shoulder], 1.0))
        eyes.graph.wait_for(lambda end=elbow: abs(arm(eyes, g1, "right_elbow_joint") - end) < 1e-3, 30.0, "moved")
        assert arm(eyes, g1, "left_shoulder_pitch_joint") == pytest.approx(shoulder, abs=1e-3)
    assert eyes.graph.mode == "stand"
