"""Gains as parameters of the real graph."""

from typing import Any

import pytest
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParameters
from rclpy.parameter import Parameter

from controllers.balance.tuning import RAMP_TIME, TUNABLE
from tests.ros.conftest import Eyes

pytestmark = [pytest.mark.ros, pytest.mark.graph]

GAIN = "balance.dcm_gain"


def test_tuning_a_robot_that_stands(eyes: Eyes, undisturbed: None) -> None:
    """Over DDS, by the services that ``ros2 param`` calls."""
    graph = eyes.graph

    def ask(kind: Any, service: str, request: Any) -> Any:
        return graph.ask(kind, f"balance_controller/{service}", request)

    (descriptor,) = ask(DescribeParameters, "describe_parameters", DescribeParameters.Request(names=[GAIN])).descriptors
    assert (descriptor.type, descriptor.read_only) == (ParameterType.PARAMETER_DOUBLE, False)
    before = ask(GetParameters, "get_parameters", GetParameters.Request(names=list(TUNABLE))).values
    for factor in (1.5, 1.0):
        parameters = [Parameter(n, value=factor * v.double_value) for n, v in zip(TUNABLE, before, strict=True)]
        request = SetParameters.Request(parameters=[parameter.to_parameter_msg() for parameter in parameters])
        assert all(result.successful for result in ask(SetParameters, "set_parameters", request).results)
        graph.spin(2.0 * RAMP_TIME)
    request = SetParameters.Request(parameters=[Parameter(GAIN, value=100.0).to_parameter_msg()])
    (result,) = ask(SetParameters, "set_parameters", request).results
    assert not result.successful and "out of range" in result.reason
