"""Changes parameters of a running graph as a user does."""

from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter

from bridge.launch.graph import Graph


def set_parameter(graph: Graph, node: str, name: str, value: float) -> None:
    """Have a node take a parameter."""
    change = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
    client = graph.node.create_client(SetParameters, f"{node}/set_parameters")
    graph.wait_for(client.service_is_ready, 10.0, "taking parameters")
    answer = client.call_async(change)
    graph.wait_for(answer.done, 10.0, "answering")
    assert answer.result().results[0].successful, answer.result()
