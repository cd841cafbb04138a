"""Changes parameters of a running graph as a user does."""

from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter

from bridge.launch.graph import Graph


def set_parameter(graph: Graph, node: str, name: str, value: float) -> None:
    """Have a node take a parameter."""
    change = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
    answer = graph.ask(SetParameters, f"{node}/set_parameters", change, 10.0)
    assert answer.results[0].successful, answer
