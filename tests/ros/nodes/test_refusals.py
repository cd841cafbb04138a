"""Refusals of a node are reported on ``/rosout``, ``/refusals`` and ``/diagnostics``, once per cause."""

from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import Log

from models.nodes import base, topics
from models.nodes.base import PoiseNode
from models.nodes.qos import EVENT, LATCHED_EVENT

pytestmark = pytest.mark.ros


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
    bench.world.create_subscription(DiagnosticStatus, topics.REFUSALS, reported.append, LATCHED_EVENT)  # late
    bench.wait(lambda: len(reported) == 3)
    assert (reported[-1].name, reported[-1].message) == ("/refuser", "cmd_vel refused: another cause")
    bench.spin(0.6)
    node.refuse("cmd_vel", "another cause")  # after a silence it is news
    bench.wait(lambda: len(reported) == 4)
    values = {item.key: item.value for item in reported[-1].values}
    assert values["count"] == "1"
    assert timedelta() <= datetime.now(UTC) - datetime.fromisoformat(values["time"]) < timedelta(minutes=5)
    assert node.counters["refused cmd_vel"] == 27


def test_causes_at_the_same_time_are_all_reported(bench: Any) -> None:
    reported: list[str] = []
    bench.world.create_subscription(
        DiagnosticStatus, topics.REFUSALS, lambda m: reported.append(m.message), LATCHED_EVENT
    )
    node = bench.add(Refuser)
    joints = ("foo", "bar", "baz")
    for joint in joints:
        node.refuse("joint_trajectory", f"unknown joint '{joint}'")
    bench.wait(lambda: len(reported) == len(joints))
    assert reported == [f"joint_trajectory refused: unknown joint '{joint}'" for joint in joints]


def test_a_reason_that_says_refused_gets_no_second_prefix(bench: Any) -> None:
    reported: list[str] = []
    bench.world.create_subscription(
        DiagnosticStatus, topics.REFUSALS, lambda m: reported.append(m.message), LATCHED_EVENT
    )
    node = bench.add(Refuser)
    node.refuse("mode/stand", "mode 'stand' refused from 'damp': the robot has fallen")
    bench.wait(lambda: reported)
    assert reported == ["mode/stand: mode 'stand' refused from 'damp': the robot has fallen"]


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
