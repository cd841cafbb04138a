"""Refusals reach the sender on ``/rosout``, ``/refusals`` and in the terminal, once per cause."""

from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import Log
from trajectory_msgs.msg import JointTrajectory

from models.nodes import base, topics
from models.nodes.base import PoiseNode
from models.nodes.qos import EVENT, LATCHED
from models.robot_model import RobotModel
from tests.ros.conftest import Eyes
from tests.ros.test_user_trajectory import arm, point

pytestmark = [pytest.mark.ros, pytest.mark.graph]


class Refuser(PoiseNode):
    """Refuses what the test asks for."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("refuser", **kwargs)


def test_a_cause_is_reported_once_then_at_its_tenth_time(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(base, "LOG_PERIOD", 0.0)
    monkeypatch.setattr(base, "QUIET", 0.5)
    logged: list[str] = []
    reported: list[DiagnosticStatus] = []
    bench.world.create_subscription(Log, "/rosout", lambda m: logged.append(m.msg), EVENT)
    node = bench.add(Refuser)
    bench.wait(lambda: bench.world.count_publishers("/rosout") > 1)
    bench.spin(0.3)
    for k in range(25):
        node.refuse("cmd_vel", f"header.stamp: {k} ns is not after {10.5 * k} ns")
    node.refuse("cmd_vel", "another cause")
    bench.wait(lambda: len([line for line in logged if "refused" in line]) >= 3)
    assert [line for line in logged if "refused" in line] == [
        "cmd_vel refused: header.stamp: 0 ns is not after 0.0 ns",
        "cmd_vel refused: header.stamp: 9 ns is not after 94.5 ns (10 times)",
        "cmd_vel refused: another cause",
    ]
    bench.world.create_subscription(DiagnosticStatus, topics.REFUSALS, reported.append, LATCHED)  # late
    bench.wait(lambda: reported)
    assert (reported[-1].name, reported[-1].message) == ("/refuser", "cmd_vel refused: another cause")
    bench.spin(0.6)
    node.refuse("cmd_vel", "another cause")  # after a silence it is news
    bench.wait(lambda: len(reported) == 2)
    assert {item.key: item.value for item in reported[-1].values}["count"] == "1"
    assert node.counters["refused cmd_vel"] == 27


def test_a_warning_in_the_diagnostics_names_its_reason(bench: Any) -> None:
    messages: list[str] = []

    def on_diagnostics(array: DiagnosticArray) -> None:
        messages.extend(status.message for status in array.status if status.level == DiagnosticStatus.WARN)

    bench.world.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, EVENT)
    node = bench.add(Refuser)
    bench.wait(lambda: bench.world.count_publishers("/diagnostics") > 0)
    bench.spin(0.3)
    node.refuse("cmd_vel", "stamp")
    node.refuse("cmd_vel", "stamp")
    bench.wait(lambda: messages)
    bench.spin(0.5)
    assert messages == ["active; refused cmd_vel: 2 more"]


def test_many_causes_are_not_remembered_for_ever(bench: Any) -> None:
    node = bench.add(Refuser)
    for k in range(3 * base.CAUSES_MAX):
        node.refuse("cmd_vel", "x" * k)
    assert len(node._causes) == base.CAUSES_MAX


def test_a_wrong_joint_is_answered_with_the_nearest_one_in_the_terminal_and_on_refusals(
    eyes: Eyes, g1: RobotModel, tmp_path: Path
) -> None:
    node = eyes.graph.node
    publisher = node.create_publisher(JointTrajectory, topics.JOINT_TRAJECTORY, EVENT)
    eyes.graph.wait_for(lambda: publisher.get_subscription_count() == 1, 10.0, "matched")
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
    publisher = eyes.graph.node.create_publisher(JointTrajectory, topics.JOINT_TRAJECTORY, EVENT)
    eyes.graph.wait_for(lambda: publisher.get_subscription_count() == 1, 10.0, "matched")
    start = arm(eyes, g1, "right_elbow_joint"), arm(eyes, g1, "left_shoulder_pitch_joint")
    publisher.publish(point(["right_elbow", "l_shoulder"], [start[0] - 0.3, start[1] - 0.2], 1.0))
    eyes.graph.wait_for(lambda: abs(arm(eyes, g1, "right_elbow_joint") - start[0] + 0.3) < 1e-3, 10.0, "moved")
    assert arm(eyes, g1, "left_shoulder_pitch_joint") == pytest.approx(start[1] - 0.2, abs=1e-3)
    assert eyes.graph.mode == "stand"
