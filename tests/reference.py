"""Writes ``docs/reference.md``: every topic, service and parameter, as the nodes declare them.

Run as ``python -m tests.reference [FILE]``, or ``make reference``.
"""

import os
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import rclpy
from rcl_interfaces.msg import ParameterDescriptor, ParameterType
from rclpy.context import Context
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from bridge.nodes.action_server import ActionServerNode
from bridge.nodes.camera_node import CameraNode
from bridge.nodes.range_sensor_node import RangeSensorNode
from bridge.nodes.robot_driver import RobotDriver
from bridge.ros.environment import free_domain, join_graph
from controllers.nodes.balance_controller import BalanceControllerNode
from controllers.nodes.foot_sensor_node import FootSensorNode
from controllers.nodes.imu_node import ImuNode
from controllers.nodes.motor_controller import MotorControllerNode
from controllers.nodes.state_estimator import StateEstimatorNode
from controllers.nodes.supervisor import SupervisorNode
from controllers.nodes.vision_node import VisionNode
from controllers.stack import ControlStack
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from planners.nodes.gait_planner import GaitPlannerNode
from planners.nodes.ground_planner import GroundPlannerNode
from planners.nodes.motion_planner import MotionPlannerNode
from planners.nodes.terrain_mapper import TerrainMapperNode

#: Class of each node by its default name
NODES: Mapping[str, type[Any]] = {
    "robot_driver": RobotDriver,
    "state_estimator": StateEstimatorNode,
    "balance_controller": BalanceControllerNode,
    "gait_planner": GaitPlannerNode,
    "motion_planner": MotionPlannerNode,
    "supervisor": SupervisorNode,
    "action_server": ActionServerNode,
    "imu_node": ImuNode,
    "foot_sensor_node": FootSensorNode,
    "motor_controller": MotorControllerNode,
    "camera_node": CameraNode,
    "range_sensor_node": RangeSensorNode,
    "terrain_mapper": TerrainMapperNode,
    "ground_planner": GroundPlannerNode,
    "vision_node": VisionNode,
}


def make_node(name: str, **kwargs: Any) -> Any:
    """A node by its default name; the gait planner gets a new control stack."""
    arguments = (ControlStack(),) if name == "gait_planner" else ()
    return NODES[name](*arguments, **kwargs)


#: Parameters that rclpy declares in every node
OF_RCLPY = frozenset({"use_sim_time", "start_type_description_service"})


def parameters(node: PoiseNode) -> dict[str, Any]:
    """Descriptor of each parameter that a node has declared, without those of rclpy, by name."""
    names = [name for name in node.get_parameters_by_prefix("") if name not in OF_RCLPY]
    return dict(zip(names, node.describe_parameters(names), strict=True))


FILE = Path("docs/reference.md")  #: Path of the reference in the repository
HEAD = """# Reference

Every topic, service and parameter, as the nodes declare them with the G1, topics of a head with TALOS. Made by
`make reference`; a test holds it to the code. What the topics mean: [graph.md](graph.md), [nodes.md](nodes.md). Names
are relative: a namespace goes before them. Parameters marked `live` may be changed while the node runs; all others are
read-only. `-` is no bound.
"""

OF_EVERY_NODE = "Of every node"  #: Heading of the parameters that all nodes share
TYPES = {
    ParameterType.PARAMETER_BOOL: "bool",
    ParameterType.PARAMETER_INTEGER: "int",
    ParameterType.PARAMETER_DOUBLE: "double",
    ParameterType.PARAMETER_STRING: "string",
    ParameterType.PARAMETER_INTEGER_ARRAY: "int[]",
    ParameterType.PARAMETER_DOUBLE_ARRAY: "double[]",
    ParameterType.PARAMETER_STRING_ARRAY: "string[]",
}

REAL_DRIVER = "robot_driver of a real robot"  #: Has further topics and services, which a simulated one lacks
HUGE = 1e300  #: Bounds beyond this count as unbounded


def reference() -> str:
    """The text of ``docs/reference.md``; ``PoiseError`` when a node cannot be configured."""
    join_graph(domain_id=free_domain())
    context = Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    nodes: list[PoiseNode] = []
    given: list[tuple[str, Sequence[str]]] = [(name, ()) for name in NODES]
    given += [(name, WITH_HEAD) for name in HEADED]
    try:
        for name, arguments in given:
            line = ["--ros-args", "--log-level", "error", *arguments]
            nodes.append(make_node(name, context=context, cli_args=line, enable_rosout=False))
            nodes[-1].trigger_configure()
            if nodes[-1].message != "configured":
                raise PoiseError(f"{name}: {nodes[-1].message}")
        return "\n".join(_lines(nodes[: len(NODES)], nodes)) + "\n"
    finally:
        for node in nodes:
            node.destroy_node()
        context.try_shutdown()


def _lines(nodes: list[PoiseNode], and_headed: list[PoiseNode]) -> Iterator[str]:
    shared = _shared(nodes)
    yield HEAD
    yield "## Topics\n"
    yield from _table(("topic", "type", "QoS", "from", "to"), _topics(and_headed))
    yield "\n## Services\n"
    yield "Beside those of every lifecycle node (`change_state`, `get_state`, ...) and of its parameters.\n"
    services = sorted((_short(s.srv_name), _type(s.srv_type), n.get_name()) for n in nodes for s in n.services)
    services = [row for row in services if not row[0].startswith(f"{row[2]}/")]  # those of lifecycle and parameters
    services = sorted([*services, *((name, "std_srvs/Trigger", REAL_DRIVER) for name in topics.START_SERVICES)])
    yield from _table(("service", "type", "node"), services)
    yield f"\n## Parameters\n\n### {OF_EVERY_NODE}\n"
    yield from _parameters(nodes[0], shared)
    for node in nodes:
        yield f"\n### {node.get_name()}\n"
        yield from _parameters(node, set(parameters(node)) - shared)


def _shared(nodes: list[PoiseNode]) -> set[str]:
    """Parameters that every node has with the same default."""
    names = set.intersection(*(set(parameters(node)) for node in nodes))
    return {name for name in names if len({_value(node.get_parameter(name).value) for node in nodes}) == 1}


def _topics(nodes: list[PoiseNode]) -> Iterator[tuple[str, ...]]:
    found: dict[str, tuple[str, str, list[str], list[str]]] = {}
    ends: list[tuple[PoiseNode, Any, bool]] = [(node, end, True) for node in nodes for end in node.publishers]
    ends += [(node, end, False) for node in nodes for end in node.subscriptions]
    for node, end, source in ends:  # publishers first: the QoS is what they offer
        row = found.setdefault(_short(end.topic_name), (_type(end.msg_type), _qos(end.qos_profile), [], []))
        names = row[2] if source else row[3]
        if node.get_name() not in names:
            names.append(node.get_name())
    found[topics.START_STATUS][2].append(REAL_DRIVER)
    for name in ("parameter_events", "rosout"):
        found.pop(f"/{name}", None)
    for topic, (kind, qos, sources, sinks) in sorted(found.items(), key=lambda item: item[0].lstrip("/")):
        publishers = "every node" if len(sources) == len(NODES) else ", ".join(sources)
        yield topic, kind, qos, publishers or "you", ", ".join(sinks) or "any"


def _parameters(node: PoiseNode, names: set[str]) -> Iterator[str]:
    descriptors = parameters(node)
    rows = [
        (
            name,
            TYPES[each.type],
            _value(node.get_parameter(name).value),
            _range(each),
            "" if each.read_only else "live",
            each.description,
        )
        for name, each in descriptors.items()
        if name in names
    ]
    yield from _table(("parameter", "type", "default", "range", "", "what"), rows)


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> Iterator[str]:
    yield f"| {' | '.join(head)} |"
    yield f"|{'---|' * len(head)}"
    for row in rows:
        cells = [cell.replace("|", "\\|") for cell in row]
        yield f"| {' | '.join([f'`{cells[0]}`', *cells[1:]])} |".replace("  ", " ")


def _short(name: str) -> str:
    """Name relative to the root namespace for a node in it; absolute names keep their slash."""
    return name if name in ABSOLUTE else name.removeprefix("/")


#: Nodes with further topics for a robot with a head, unlike the G1, and parameters that show these
HEADED, WITH_HEAD = ("balance_controller", "vision_node"), ("-p", "robot:=talos", "-p", "follow:=true")
#: Topics that a namespace does not move
ABSOLUTE = frozenset({"/clock", "/diagnostics", "/tf", "/tf_static", "/parameter_events", "/rosout"})


def _type(kind: Any) -> str:
    if kind.__name__ == "TFMessage":
        return "tf2_msgs/TFMessage"
    return f"{kind.__module__.split('.')[0]}/{kind.__name__}"


def _qos(profile: QoSProfile) -> str:
    words = ["best effort" if profile.reliability == ReliabilityPolicy.BEST_EFFORT else "reliable"]
    if profile.durability == DurabilityPolicy.TRANSIENT_LOCAL:
        words.append("latched")
    return f"{' '.join(words)}, {profile.depth}"


def _range(descriptor: ParameterDescriptor) -> str:
    ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
    if not ranges:
        return ""
    ends = (ranges[0].from_value, ranges[0].to_value)
    low, high = ("-" if abs(end) >= (HUGE if isinstance(end, float) else 2**62) else f"{end:g}" for end in ends)
    return f"{low} to {high}"


def _value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, bool | int):
        return str(value).lower()
    return f"[{', '.join(_value(item) for item in value)}]"


def main() -> None:
    """Write the reference, or report why it cannot be written."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ.setdefault("ROS_LOG_DIR", folder)
        text = reference()
    Path(sys.argv[1] if len(sys.argv) > 1 else FILE).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
