"""Gains as parameters: taken without a jump, refused out of range."""

from typing import Any

import pytest
from rclpy.parameter import Parameter

from controllers.balance.tuning import RAMP_TIME
from controllers.nodes.balance_controller import BalanceControllerNode
from models.robot_model import RobotModel
from tests.ros.nodes.test_control_nodes import Controlled

pytestmark = pytest.mark.ros

GAIN, POSTURE = "balance.dcm_gain", "whole_body.posture.kp"


def test_gains_are_taken_at_the_next_ticks(bench: Any, g1: RobotModel) -> None:
    robot = Controlled(bench, g1)
    law = robot.node._stack.law
    results = robot.node.set_parameters([Parameter(GAIN, value=6.0), Parameter(POSTURE, value=20.0)])
    assert all(result.successful for result in results)
    assert law.gains[0] == 5.0  # nothing has jumped
    for _ in range(round(1000 * RAMP_TIME) // 2):
        robot.tick()
    assert law.gains[0] == pytest.approx(5.5)
    for _ in range(round(1000 * RAMP_TIME)):
        robot.tick()
    assert law.gains[0] == 6.0
    assert (law.whole_body.tasks["posture"].kp == 20.0).all()


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        (GAIN, 11.0, "balance.dcm_gain out of range Min: 2.5, Max: 10.0, value: 11.0"),
        (GAIN, float("nan"), "out of range"),
        (GAIN, "fast", "Wrong parameter type"),
        ("whole_body.solver.residual_max", 1.0, "read-only"),
        ("whole_body.stepping.base_weight", 30.0, "read-only"),
    ],
)
def test_what_is_refused_names_the_reason(bench: Any, g1: RobotModel, name: str, value: object, reason: str) -> None:
    robot = Controlled(bench, g1)
    (result,) = robot.node.set_parameters([Parameter(name, value=value)])
    assert not result.successful
    assert reason in result.reason
    robot.tick()
    assert robot.node._stack.law.gains[0] == 5.0


def test_a_value_at_the_very_edge_is_taken(bench: Any, g1: RobotModel) -> None:
    robot = Controlled(bench, g1)
    assert robot.node.set_parameters([Parameter(GAIN, value=10.0 * (1.0 + 1e-7))])[0].successful
    assert robot.node._stack.tuning.ranges[GAIN] == (2.5, 10.0)


def test_gains_set_before_the_law_is_built_count(bench: Any) -> None:
    """The ranges are about what the node was started with."""
    node = bench.add(BalanceControllerNode, active=False, **{GAIN: 4.0})
    descriptor = node.describe_parameter(GAIN)
    span = descriptor.floating_point_range[0]
    assert (descriptor.read_only, span.from_value, span.to_value) == (False, 2.0, 8.0)
    assert "DCM error" in descriptor.description
    node.set_parameters([Parameter(GAIN, value=7.0)])
    node.trigger_cleanup()
    node.trigger_configure()
    assert node._stack.law.gains[0] == 7.0
